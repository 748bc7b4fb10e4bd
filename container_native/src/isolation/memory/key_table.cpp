#include "isolation/memory/key_table.hpp"

#include <cstddef>

namespace play_launch::isolation {

int KeyTable::take(const std::function<int()>& more, bool alone) {
  int best = -1;
  for (int key = kCommonKey + 1; key < kProtectionKeys; ++key) {
    const Key& one = keys_[static_cast<std::size_t>(key)];
    if (one.is_ours && (best < 0 || one.holders < holders(best))) {
      best = key;
    }
  }
  if (best < 0 || holders(best) > 0) {
    const int fresh = more();
    if (fresh > kCommonKey && fresh < kProtectionKeys) {
      keys_[static_cast<std::size_t>(fresh)].is_ours = true;
      best = fresh;
    }
  }
  if (best < 0 || (alone && holders(best) > 0)) {
    return -1;
  }
  ++keys_[static_cast<std::size_t>(best)].holders;
  return best;
}

void KeyTable::give_back(int key) { --keys_[static_cast<std::size_t>(key)].holders; }

}  // namespace play_launch::isolation
