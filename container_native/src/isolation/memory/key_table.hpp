#pragma once

#include <array>
#include <functional>

#include "isolation/memory/protection_keys.hpp"

namespace play_launch::isolation {

/// Which domain has which protection key. There are 15 at most, fewer where other code uses some:
/// when all are held, more than one holder has the same. Keys that were had once are kept. One
/// thread at a time.
class KeyTable {
 public:
  /// A free one, else one that `more` gives (-1: none), else, unless `alone`,
  /// one that fewest hold. -1: none.
  int take(const std::function<int()>& more, bool alone);
  void give_back(int key);

  int holders(int key) const { return keys_[static_cast<std::size_t>(key)].holders; }

 private:
  struct Key {
    bool is_ours = false;
    int holders = 0;
  };
  std::array<Key, kProtectionKeys> keys_{};
};

}  // namespace play_launch::isolation
