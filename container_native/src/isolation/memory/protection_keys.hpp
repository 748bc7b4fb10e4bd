#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>

namespace play_launch::isolation {

/// What a thread may do with memory that has a protection key, as the register PKRU of x86 has it:
/// two bits a key, from the lowest on: no access, no writing. Each thread has its own; new threads
/// and processes begin with that of their creator. Signal handlers begin with the kernel's default,
/// which allows key 0 only, and the interrupted rights come back when they return.
using KeyRights = std::uint32_t;

inline constexpr int kProtectionKeys = 16;
/// Of the memory that has no other, and always allowed here.
inline constexpr int kCommonKey = 0;

/// Everything may be read, and written where the key is 0 or `own`.
constexpr KeyRights rights_of_owner(int own) noexcept {
  KeyRights rights = 0;
  for (int key = kCommonKey + 1; key < kProtectionKeys; ++key) {
    rights |= key == own ? KeyRights{0} : KeyRights{2} << (2 * key);
  }
  return rights;
}

/// Whether `rights` allow that.
constexpr bool is_allowed(KeyRights rights, int key, bool writing) noexcept {
  const KeyRights denied = rights >> (2 * key);
  return (denied & 1) == 0 && !(writing && (denied & 2) != 0);
}

/// Whether processor and kernel have protection keys, and nothing forbids them. Looks once.
bool has_protection_keys() noexcept;

/// The calling thread, and those that it starts from now on, may write everywhere. For the
/// container, before it has other threads: its threads, whose code is that of all nodes, work for
/// any of them. Remembers what handlers begin with.
void allow_all_keys() noexcept;

/// Of the calling thread. Only where has_protection_keys(). Async-signal-safe.
void assume_rights(KeyRights rights) noexcept;

/// A free key; -1: all are in use. Only the calling thread may use it then, unless
/// others allow all keys.
int new_protection_key() noexcept;

/// Makes the pages readable and writable for threads that may use the key. An error number, or 0.
int protect_pages(void* begin, std::size_t size, int key) noexcept;

/// In a handler of SIGSEGV: the fault came of the rights that signal handlers begin with, and
/// `rights`, those of the process, allow what was tried. Then the interrupted code has them when
/// the handler returns, and goes on. Async-signal-safe.
bool restore_rights(KeyRights rights, int key, void* context) noexcept;

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
