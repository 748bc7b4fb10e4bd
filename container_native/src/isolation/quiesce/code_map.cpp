#include "isolation/quiesce/code_map.hpp"

#include <dlfcn.h>
#include <link.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <iterator>
#include <string>
#include <string_view>
#include <vector>

#include "base/elf.hpp"

namespace play_launch::isolation {
namespace {

using namespace std::string_view_literals;

enum class Place {
  neutral,   // decided by its caller
  header,    // likewise: from the C++ library's headers
  unnamed,   // a function of a node or of this program that is not exported
  harmless,  // no lock of others is held here
  inside,    // maybe one is
};

struct Range {
  std::uintptr_t begin = 0;
  std::uintptr_t end = 0;

  bool contains(std::uintptr_t address) const { return begin <= address && address < end; }
};

/// By address.
std::array<Range, 1024> ranges;
std::atomic<std::size_t> count{0};

int add_object(dl_phdr_info* object, std::size_t, void* data) {
  const std::string_view path = object->dlpi_name == nullptr ? "" : object->dlpi_name;
  if (path.empty()) {
    return 0;  // the program
  }
  auto& used = *static_cast<std::size_t*>(data);
  for (int i = 0; i < object->dlpi_phnum && used < ranges.size(); ++i) {
    const ElfW(Phdr)& segment = object->dlpi_phdr[i];
    if (segment.p_type == PT_LOAD && (segment.p_flags & PF_X) != 0) {
      const std::uintptr_t begin = object->dlpi_addr + segment.p_vaddr;
      ranges[used++] = {begin, begin + segment.p_memsz};
    }
  }
  return 0;
}

void note_early_code() noexcept {
  count = 0;
  std::size_t used = 0;
  ::dl_iterate_phdr(add_object, &used);
  std::ranges::sort(ranges.begin(), ranges.begin() + static_cast<std::ptrdiff_t>(used), {},
                    &Range::begin);
  count = used;
}

/// Whether the address is code of a library that was there before the first node; the program does
/// not count.
bool is_early_code(std::uintptr_t address) noexcept {
  const auto end = ranges.begin() + static_cast<std::ptrdiff_t>(count.load());
  const auto after = std::ranges::upper_bound(ranges.begin(), end, address, {}, &Range::begin);
  return after != ranges.begin() && std::prev(after)->contains(address);
}

/// Message libraries, libstd_msgs__rosidl_typesupport_cpp.so, are loaded with the first node that
/// needs them, and belong to the middleware.
constexpr std::string_view kGeneratedCode = "__rosidl_";

constexpr std::array kCppRuntime{"libstdc++"sv, "libgcc_s"sv, "libm.so"sv, "libm-"sv,
                                 "linux-vdso"sv};
constexpr std::array kCLibrary{"libc.so"sv, "libc-"sv, "libpthread"sv};

/// Functions of this program that are called in place of other libraries' (fastdds/waits.cpp,
/// overrides/thread_guard.cpp, exit_guard.cpp), and what they call on the way there in a build
/// without optimisation: their caller decides.
constexpr std::array kOverrides{"_ZN11play_launch7fastdds"sv, "pthread_once"sv, "__cxa_guard_"sv,
                                "abort"sv, "_ZN11play_launch12NextFunction"sv};

/// Functions that templates of the middleware become in a user's library; while they run they may
/// hold the locks of delivery by pointer.
constexpr std::array kTemplates{"_ZN6rclcpp"sv, "_ZNK6rclcpp"sv, "_ZN11play_launch"sv,
                                "_ZNK11play_launch"sv};

/// Functions from the C++ library's headers that were not merged into their callers, such as
/// those of locks and containers: that one decides.
constexpr std::array kCppHeaders{"_ZSt"sv, "_ZNSt"sv, "_ZNKSt"sv, "_ZN9__gnu_cxx"sv,
                                 "_ZNK9__gnu_cxx"sv};
/// But these call what users wrote, which is often merged into them.
constexpr std::array kCallers{"_ZNSt17_Function_handler"sv, "_ZNSt6thread11_State_impl"sv,
                              "_ZNSt13__future_base"sv};

/// What a thread in the code of a landmark is.
enum class Meaning {
  inside,  // maybe in possession of a lock
  // Taking or giving back a lock: the one that called it may be out of the picture already, as the
  // last thing that a function does is often a jump.
  locking,
  // Saying why the process ends, when a check of the C library or of the compiler failed: without a
  // lock, so that the one that called it decides.
  last_words,
  waiting,  // for the end of another thread
};

/// Code of a library that is found by the exported functions in it.
struct Landmark {
  const char* name;
  const char* library;
  Meaning meaning;
  std::array<std::string_view, 11> functions;
  Range range{};
};

constexpr const char* kLibc = "libc.so.6";

constinit std::array landmarks{
    Landmark{"allocator",
             kLibc,
             Meaning::inside,
             {"malloc", "free", "calloc", "realloc", "memalign", "aligned_alloc", "posix_memalign",
              "malloc_trim", "malloc_usable_size", "mallopt", "malloc_info"}},
    Landmark{"stdio",
             kLibc,
             Meaning::inside,
             {"printf", "fprintf", "vfprintf", "fopen", "fclose", "fflush", "fputs", "puts",
              "fwrite", "_IO_file_write", "_IO_file_xsputn"}},
    Landmark{"starting of threads", kLibc, Meaning::inside, {"pthread_create"}},
    Landmark{"mutexes",
             kLibc,
             Meaning::locking,
             {"pthread_mutex_lock", "pthread_mutex_trylock", "pthread_mutex_timedlock",
              "pthread_mutex_clocklock", "pthread_mutex_unlock"}},
    Landmark{"read-write locks",
             kLibc,
             Meaning::locking,
             {"pthread_rwlock_rdlock", "pthread_rwlock_wrlock", "pthread_rwlock_tryrdlock",
              "pthread_rwlock_trywrlock", "pthread_rwlock_timedrdlock",
              "pthread_rwlock_timedwrlock", "pthread_rwlock_unlock"}},
    Landmark{"internal locks",
             kLibc,
             Meaning::locking,
             {"__lll_lock_wait_private", "__lll_lock_wake_private"}},
    Landmark{
        "conditions", kLibc, Meaning::locking, {"pthread_cond_signal", "pthread_cond_broadcast"}},
    Landmark{"last words", kLibc, Meaning::last_words, {"__libc_fatal"}},
    Landmark{"std::thread::join()", "libstdc++.so.6", Meaning::waiting, {"_ZNSt6thread4joinEv"}},
};

bool is_in(std::uintptr_t address, Meaning meaning) {
  return std::ranges::any_of(landmarks, [=](const Landmark& landmark) {
    return landmark.meaning == meaning && landmark.range.contains(address);
  });
}

template <std::size_t size>
bool begins_with_any(std::string_view text, const std::array<std::string_view, size>& prefixes) {
  return std::any_of(prefixes.begin(), prefixes.end(),
                     [text](std::string_view prefix) { return text.starts_with(prefix); });
}

std::string_view base_name(const char* path) {
  const std::string_view text = path == nullptr ? "" : path;
  return text.substr(text.rfind('/') + 1);
}

/// Looks up the code of the functions, which are linked next to each other, and of what was
/// compiled together with them. False when one of them is missing, or they are not next to each
/// other.
bool find(Landmark& landmark, const DynamicSymbols& library) {
  constexpr std::uintptr_t kImplausible = 1 << 20;
  bool is_whole = true;
  Range range{~std::uintptr_t{0}, 0};
  for (const std::string_view name : landmark.functions) {
    if (const std::uintptr_t address = name.empty() ? 0 : library.find(name)) {
      range.begin = std::min(range.begin, library.gap_before(address));
      range.end = std::max(range.end, library.gap_after(address));
    } else {
      is_whole = is_whole && name.empty();
    }
  }
  const bool is_plausible = range.begin < range.end && range.end - range.begin <= kImplausible;
  landmark.range = is_plausible ? range : Range{};
  return is_whole && is_plausible;
}

#if defined(__x86_64__)
constexpr std::array<unsigned char, 2> kSystemCall{0x0f, 0x05};
#else
constexpr std::array<unsigned char, 4> kSystemCall{0x01, 0x00, 0x00, 0xd4};
#endif

bool before_system_call(std::uintptr_t address) {
  return std::memcmp(reinterpret_cast<const void*>(address), kSystemCall.data(),
                     kSystemCall.size()) == 0;
}

/// A thread blocked in a system call is interrupted before it (to be made again) or behind it.
bool at_system_call(std::uintptr_t address) {
  return before_system_call(address) || before_system_call(address - kSystemCall.size());
}

/// A jump from a library to a function of another one, with which unlocking often begins.
bool in_call_stub(std::uintptr_t address) {
#if defined(__x86_64__)
  const auto begins_with = [address](std::initializer_list<unsigned char> bytes) {
    return std::memcmp(reinterpret_cast<const void*>(address), bytes.begin(), bytes.size()) == 0;
  };
  return begins_with({0xf3, 0x0f, 0x1e, 0xfa}) ||  // endbr64
         begins_with({0xff, 0x25}) ||              // jmp through a table
         begins_with({0xf2, 0xff, 0x25}) ||        // bnd jmp
         begins_with({0x68}) ||                    // push of an index, before the first call
         begins_with({0xff, 0x35});                // push of the table, likewise
#else
  std::uint32_t instruction = 0;
  std::memcpy(&instruction, reinterpret_cast<const void*>(address), sizeof instruction);
  return (instruction & 0x9f00001f) == 0x90000010 ||  // adrp x16
         (instruction & 0xffc003ff) == 0xf9400211 ||  // ldr x17, [x16, ...]
         (instruction & 0xffc003ff) == 0x91000210 ||  // add x16, x16, ...
         instruction == 0xd61f0220;                   // br x17
#endif
}

/// A return address may already be the next function's: a call can be the last of its caller.
std::uintptr_t address_in(const CallStack& stack, std::size_t frame) {
  return stack.frames[frame].address - (frame == 0 ? 0 : 1);
}

bool is_c_library(const link_map* library) {
  return library != nullptr && begins_with_any(base_name(library->l_name), kCLibrary);
}

/// The thread runs there, or in what that frame called there: on AArch64 the C library's locks call
/// functions for atomic operations.
bool runs_in_c_library(const CallStack& stack, std::size_t frame) {
  for (std::size_t i = 0; i < frame; ++i) {
    if (!is_c_library(library_at(address_in(stack, i)))) {
      return false;
    }
  }
  return !at_system_call(stack.frames[0].address);
}

Place in_c_library(const CallStack& stack, std::size_t frame, Caution caution) {
  const bool innermost = frame == 0;
  const std::uintptr_t address = address_in(stack, frame);
  if (is_in(address, Meaning::last_words)) {
    return Place::neutral;
  }
  if (is_in(address, Meaning::inside)) {
    return Place::inside;
  }
  if (innermost && stack.wakes_others && before_system_call(address)) {
    // The kernel never asks for a wake a second time, so this one is still to come. What the
    // thread held is free by now, but its waiter would never wake up.
    return Place::inside;
  }
  const bool counts = innermost && caution == Caution::careful;
  const bool may_lock = counts || is_in(address, Meaning::locking);
  return may_lock && runs_in_c_library(stack, frame) ? Place::inside : Place::neutral;
}

Place place_of(const CallStack& stack, std::size_t frame, Caution caution) {
  const bool innermost = frame == 0;
  const std::uintptr_t address = address_in(stack, frame);
  if (is_in(address, Meaning::waiting)) {
    return Place::harmless;
  }
  const link_map* const found = library_at(address);
  if (found == nullptr) {
    // Generated code, or a wild jump: whatever called it decides.
    return Place::neutral;
  }
  const link_map& library = *found;
  const std::string_view name = base_name(library.l_name);
  const bool is_program = name.empty();
  if (is_c_library(found)) {
    return in_c_library(stack, frame, caution);
  }
  if (begins_with_any(name, kCppRuntime)) {
    return Place::neutral;
  }
  if (is_early_code(address) || name.find(kGeneratedCode) != std::string_view::npos) {
    return Place::inside;
  }
  if (innermost && in_call_stub(address)) {
    return Place::inside;
  }
  const std::string_view function = DynamicSymbols(library).function_at(address).name;
  if (function.empty()) {
    return Place::unnamed;
  }
  if (begins_with_any(function, kCppHeaders)) {
    return begins_with_any(function, kCallers) ? Place::harmless : Place::header;
  }
  if (is_program && begins_with_any(function, kOverrides)) {
    return innermost ? Place::inside : Place::neutral;
  }
  // This program is no node's; children take none of its locks but those in docs/isolation.md.
  return !is_program && begins_with_any(function, kTemplates) ? Place::inside : Place::harmless;
}

}  // namespace

void prepare_code_map() {
  note_early_code();
  find_landmarks();
}

std::vector<std::string> find_landmarks() {
  std::vector<std::string> missing;
  for (Landmark& landmark : landmarks) {
    void* const library = ::dlopen(landmark.library, RTLD_NOW | RTLD_NOLOAD);
    if (library == nullptr ||
        !find(landmark, DynamicSymbols(*static_cast<const link_map*>(library)))) {
      missing.emplace_back(landmark.name);
    }
    if (library != nullptr) {
      ::dlclose(library);
    }
  }
  return missing;
}

Judgement judge(const CallStack& stack, Caution caution, std::size_t first) noexcept {
  Judgement judgement;
  constexpr std::size_t kNone = CallStack::kMaxFrames;
  std::size_t unnamed = kNone;  // the first of those in a row
  for (std::size_t i = first; i < stack.count; ++i) {
    const Place place = place_of(stack, i, caution);
    // Without optimisation, locking ends in some functions without a name, and is what called
    // them; all others are the node's.
    if (place == Place::unnamed) {
      unnamed = std::min(unnamed, i);
      continue;
    }
    if (unnamed != kNone && caution == Caution::lenient && place != Place::header) {
      judgement.way_out = unnamed;
      return judgement;
    }
    unnamed = kNone;
    if (place == Place::harmless) {
      judgement.way_out = i;
      return judgement;
    }
    if (place == Place::inside) {
      judgement.harmless = false;
    }
  }
  const bool is_the_nodes = unnamed != kNone && caution == Caution::lenient;
  judgement.way_out = is_the_nodes ? unnamed : stack.count;
  return judgement;
}

std::size_t thrower_in(const CallStack& stack) noexcept {
  constexpr std::array kThrow{"__cxa_throw"sv, "__cxa_rethrow"sv,
                              "_ZSt17rethrow_exceptionNSt15__exception_ptr13exception_ptrE"sv};
  std::size_t behind = 0;  // std::terminate(), and what in its library has no name
  const link_map* cpp_library = nullptr;
  bool set_apart = false;
  for (std::size_t i = 1; i + 1 < stack.count; ++i) {
    const std::uintptr_t address = stack.frames[i].address - 1;
    const link_map* const library = library_at(address);
    const std::string_view name =
        library == nullptr ? ""sv : DynamicSymbols(*library).function_at(address).name;
    if (std::ranges::find(kThrow, name) != kThrow.end()) {
      return i + 1;
    }
    if (name == "_ZSt9terminatev"sv) {
      cpp_library = library;
      behind = i + 1;
    } else if (i == behind && library == cpp_library && name.empty()) {
      set_apart = true;
      ++behind;
    }
  }
  // With GCC 14, the part of a throwing function that calls std::terminate() may be set apart from
  // it. The unwinder's functions call it, too, but have names.
  const bool is_outside = library_at(stack.frames[behind].address - 1) != cpp_library;
  return set_apart && is_outside ? behind : 0;
}

}  // namespace play_launch::isolation
