#pragma once

#include <link.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace play_launch {

/// When to give up looking a symbol up: tables of large libraries take long where they have to be
/// read from a slow disk.
using LookUpEnd = std::chrono::steady_clock::time_point;
constexpr LookUpEnd kNoLookUpEnd = LookUpEnd::max();

/// The library, or the program, whose code or data is at the address; null if none is mapped there.
/// Neither allocates nor takes the dynamic loader's lock, unlike dladdr(): async-signal-safe, and
/// also answers while a library's initialiser runs or after it died.
const link_map* library_at(std::uintptr_t address) noexcept;

/// Path of a library of this process; of the program itself for the program.
std::string path_of(const link_map& library);

/// Identifies the build of a loaded library or program, in hexadecimal; empty when it was linked
/// without one. `code`: any address in its code. Takes no lock of the dynamic loader.
std::string build_id_of(const link_map& library, std::uintptr_t code);

/// What the dynamic section of a loaded library says about its symbols, read in the memory of this
/// process. Async-signal-safe. The library must stay loaded.
class DynamicSymbols {
 public:
  explicit DynamicSymbols(const link_map& library) noexcept;

  struct Function {
    std::string_view name;  // mangled; empty when none is exported there
    std::uintptr_t begin = 0;
  };
  /// The exported function at the address; none when the end came first.
  Function function_at(std::uintptr_t address, LookUpEnd end = kNoLookUpEnd) const noexcept;

  /// Address of an exported function; 0 if it is not exported.
  std::uintptr_t find(std::string_view name) const noexcept;

  /// Where the code between two exported functions begins, which is that of functions without an
  /// exported name: the end of the last exported one before the address.
  std::uintptr_t gap_before(std::uintptr_t address) const noexcept;
  /// Where the next exported function begins.
  std::uintptr_t gap_after(std::uintptr_t address) const noexcept;

  /// Calls `visit` with the mangled name of each symbol that the library takes from others, and
  /// cannot do without.
  template <class Visit>
  void for_each_undefined(Visit visit) const {
    for (std::size_t i = 1; symbols_ != nullptr && names_ != nullptr && i < count_; ++i) {
      if (symbols_[i].st_shndx == SHN_UNDEF && ELF64_ST_BIND(symbols_[i].st_info) != STB_WEAK) {
        visit(names_ + symbols_[i].st_name);
      }
    }
  }

 private:
  template <class Better>
      const ElfW(Sym) * best(Better better, LookUpEnd end = kNoLookUpEnd) const noexcept;

  std::uintptr_t base_;
  const ElfW(Sym) * symbols_ = nullptr;
  const char* names_ = nullptr;
  std::size_t count_ = 0;
};

/// The symbol table of a library or program on disk, unless it was stripped: it also has functions
/// that are not exported, as most callbacks are.
class FileSymbols {
 public:
  /// Opens the file; one that cannot be read, or is not ELF, has no symbols.
  explicit FileSymbols(const std::string& path);
  FileSymbols(const FileSymbols&) = delete;
  FileSymbols& operator=(const FileSymbols&) = delete;
  ~FileSymbols();

  struct Function {
    std::string name;           // mangled
    std::uintptr_t offset = 0;  // of the address, from the function's begin
  };
  /// The function at an address that is relative to where the file was loaded; none when the end
  /// came first.
  std::optional<Function> function_at(std::uintptr_t address, LookUpEnd end = kNoLookUpEnd) const;

 private:
  template <class T>
  const T* at(std::uint64_t offset, std::uint64_t count = 1) const;

  void* mapping_ = nullptr;
  std::size_t size_ = 0;
};

/// The name of a C++ function or type as people write it; what is no mangled name stays as it is.
/// Allocates.
std::string demangled(const char* name);

}  // namespace play_launch
