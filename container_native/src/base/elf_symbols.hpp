#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

namespace play_launch::isolation {

/// The symbol table of a library or program on disk, unless it was stripped: it also has functions
/// that are not exported, as most callbacks are.
class ElfSymbols {
 public:
  /// Opens the file; one that cannot be read, or is none, has no symbols.
  explicit ElfSymbols(const std::string& path);
  ElfSymbols(const ElfSymbols&) = delete;
  ElfSymbols& operator=(const ElfSymbols&) = delete;
  ~ElfSymbols();

  struct Function {
    std::string name;           // mangled
    std::uintptr_t offset = 0;  // of the address, from the function's begin
  };
  /// The function at an address that is relative to where the file was loaded.
  std::optional<Function> function_at(std::uintptr_t address) const;

 private:
  template <class T>
  const T* at(std::uint64_t offset, std::uint64_t count = 1) const;

  void* mapping_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace play_launch::isolation
