#include "base/elf_symbols.hpp"

#include <elf.h>
#include <fcntl.h>
#include <link.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include <cstring>

#include "base/unique_fd.hpp"

namespace play_launch::isolation {

ElfSymbols::ElfSymbols(const std::string& path) {
  const UniqueFd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  struct stat status{};
  if (!file || ::fstat(file.get(), &status) != 0 || status.st_size <= 0) {
    return;
  }
  size_ = static_cast<std::size_t>(status.st_size);
  void* const mapping = ::mmap(nullptr, size_, PROT_READ, MAP_PRIVATE, file.get(), 0);
  mapping_ = mapping == MAP_FAILED ? nullptr : mapping;
}

ElfSymbols::~ElfSymbols() {
  if (mapping_ != nullptr) {
    ::munmap(mapping_, size_);
  }
}

template <class T>
const T* ElfSymbols::at(std::uint64_t offset, std::uint64_t count) const {
  if (mapping_ == nullptr || offset > size_ || count > (size_ - offset) / sizeof(T) ||
      offset % alignof(T) != 0) {
    return nullptr;
  }
  return reinterpret_cast<const T*>(static_cast<const char*>(mapping_) + offset);
}

std::optional<ElfSymbols::Function> ElfSymbols::function_at(std::uintptr_t address) const {
  const auto* const header = at<ElfW(Ehdr)>(0);
  if (header == nullptr || std::memcmp(header->e_ident, ELFMAG, SELFMAG) != 0) {
    return std::nullopt;
  }
  const auto* const sections = at<ElfW(Shdr)>(header->e_shoff, header->e_shnum);
  for (std::size_t i = 0; sections != nullptr && i < header->e_shnum; ++i) {
    const ElfW(Shdr)& section = sections[i];
    if (section.sh_type != SHT_SYMTAB || section.sh_link >= header->e_shnum) {
      continue;
    }
    const std::size_t count = section.sh_size / sizeof(ElfW(Sym));
    const auto* const symbols = at<ElfW(Sym)>(section.sh_offset, count);
    const ElfW(Shdr)& names = sections[section.sh_link];
    const auto* const text = at<char>(names.sh_offset, names.sh_size);
    for (std::size_t n = 0; symbols != nullptr && text != nullptr && n < count; ++n) {
      const ElfW(Sym)& symbol = symbols[n];
      if (ELF64_ST_TYPE(symbol.st_info) == STT_FUNC && symbol.st_shndx != SHN_UNDEF &&
          symbol.st_value <= address && address - symbol.st_value < symbol.st_size &&
          symbol.st_name < names.sh_size) {
        const char* const name = text + symbol.st_name;
        return Function{std::string(name, ::strnlen(name, names.sh_size - symbol.st_name)),
                        address - symbol.st_value};
      }
    }
  }
  return std::nullopt;
}

}  // namespace play_launch::isolation
