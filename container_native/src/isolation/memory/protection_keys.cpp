#include "isolation/memory/protection_keys.hpp"

#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>

#if defined(__x86_64__)
#include <cpuid.h>
#include <ucontext.h>

#include <cstring>
#endif

namespace play_launch::isolation {
namespace {

int allocate_key() noexcept { return static_cast<int>(::syscall(SYS_pkey_alloc, 0, 0)); }

#if defined(__x86_64__)

// Not by pkey_get() and pkey_set() of the C library, which change the rights of one key.

KeyRights current_rights() noexcept {
  KeyRights rights = 0;
  std::uint32_t high = 0;
  asm volatile("rdpkru" : "=a"(rights), "=d"(high) : "c"(0));
  return rights;
}

// For handlers; written by allow_all_keys(), before there are any.

/// What they begin with: the kernel's init_pkru, which can be set at its start.
KeyRights rights_of_handlers = 0x55555554;
/// Where the rights are in the area that XSAVE writes, in bytes; 0: nowhere.
std::size_t place_of_rights = 0;

bool is_enabled() noexcept {
  constexpr unsigned kLeaf = 7;
  constexpr unsigned kOspke = 1U << 4;  // the kernel has switched them on, too
  unsigned eax = 0;
  unsigned ebx = 0;
  unsigned ecx = 0;
  unsigned edx = 0;
  return __get_cpuid_count(kLeaf, 0, &eax, &ebx, &ecx, &edx) != 0 && (ecx & kOspke) != 0;
}

std::size_t find_place_of_rights() noexcept {
  constexpr unsigned kLeaf = 0xd;
  constexpr unsigned kPkru = 9;  // the number of this component
  unsigned size = 0;
  unsigned offset = 0;
  unsigned ecx = 0;
  unsigned edx = 0;
  const bool known = __get_cpuid_count(kLeaf, kPkru, &size, &offset, &ecx, &edx) != 0;
  return known && size >= sizeof(KeyRights) ? offset : 0;
}

/// How the kernel describes the area in a signal's frame: struct _fpx_sw_bytes in
/// arch/x86/include/uapi/asm/sigcontext.h.
struct StateDescription {
  static constexpr std::size_t kPlace = 464;
  static constexpr std::uint32_t kMagic = 0x46505853;

  std::uint32_t magic;
  std::uint32_t size_with_end;
  std::uint64_t features;
  std::uint32_t size;
};

/// The interrupted rights in the frame that the kernel wrote, and will read; null: they are not
/// there.
char* interrupted_rights(void* context) noexcept {
  constexpr std::size_t kPresent = 512;
  constexpr std::uint64_t kRightsBit = 1U << 9;
  auto* const state =
      reinterpret_cast<char*>(static_cast<ucontext_t*>(context)->uc_mcontext.fpregs);
  if (state == nullptr || place_of_rights == 0) {
    return nullptr;
  }
  StateDescription description{};
  std::memcpy(&description, state + StateDescription::kPlace, sizeof description);
  if (description.magic != StateDescription::kMagic ||
      place_of_rights + sizeof(KeyRights) > description.size) {
    return nullptr;
  }
  std::uint64_t present = 0;
  std::memcpy(&present, state + kPresent, sizeof present);
  return (present & kRightsBit) != 0 ? state + place_of_rights : nullptr;
}

/// From the error code of the page fault.
bool was_writing(void* context) noexcept {
  constexpr greg_t kWriting = 2;
  return (static_cast<ucontext_t*>(context)->uc_mcontext.gregs[REG_ERR] & kWriting) != 0;
}

#else

bool is_enabled() noexcept { return false; }
KeyRights current_rights() noexcept { return 0; }

#endif

}  // namespace

bool has_protection_keys() noexcept {
  static const bool works = [] {
    if (!is_enabled()) {
      return false;
    }
    const KeyRights before = current_rights();
    // Whether they are there is not in the error: kernels differ.
    const int key = allocate_key();
    assume_rights(before);  // without those that came with it
    return key > 0 && ::syscall(SYS_pkey_free, key) == 0;
  }();
  return works;
}

int new_protection_key() noexcept { return has_protection_keys() ? allocate_key() : -1; }

int protect_pages(void* begin, std::size_t size, int key) noexcept {
  constexpr int kAccess = PROT_READ | PROT_WRITE;
  const long result = key == kCommonKey && !has_protection_keys()
                          ? ::mprotect(begin, size, kAccess)
                          : ::syscall(SYS_pkey_mprotect, begin, size, kAccess, key);
  return result == 0 ? 0 : errno;
}

#if defined(__x86_64__)

void assume_rights(KeyRights rights) noexcept {
  asm volatile("wrpkru" : : "a"(rights), "c"(0), "d"(0) : "memory");
}

void allow_all_keys() noexcept {
  if (has_protection_keys()) {
    rights_of_handlers = current_rights();
    place_of_rights = find_place_of_rights();
    assume_rights(0);
  }
}

bool restore_rights(KeyRights rights, int key, void* context) noexcept {
  char* const place = interrupted_rights(context);
  if (place == nullptr || !is_allowed(rights, key, was_writing(context))) {
    return false;
  }
  KeyRights interrupted = 0;
  std::memcpy(&interrupted, place, sizeof interrupted);
  if (interrupted != rights_of_handlers) {
    return false;
  }
  std::memcpy(place, &rights, sizeof rights);
  return true;
}

#else

void assume_rights(KeyRights) noexcept {}
void allow_all_keys() noexcept {}
bool restore_rights(KeyRights, int, void*) noexcept { return false; }

#endif

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
