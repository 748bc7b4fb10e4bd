#include "base/elf.hpp"

#include <cxxabi.h>
#include <dlfcn.h>
#include <elf.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <memory>
#include <system_error>

#include "base/unique_fd.hpp"

namespace play_launch {
namespace {

/// Asked at each symbol of a table; the clock is read at every 1,024th.
bool is_late(std::size_t symbol, LookUpEnd end) noexcept {
  return symbol % 1024 == 0 && end != kNoLookUpEnd && std::chrono::steady_clock::now() >= end;
}

/// The table of symbols does not say its length: one more than the highest index in its hash table.
std::size_t symbol_count(const std::uint32_t* hash) noexcept {
  const std::uint32_t buckets = hash[0];
  const std::uint32_t first = hash[1];
  const std::uint32_t bloom_words = hash[2];
  const std::uint32_t* const bucket = hash + 4 + bloom_words * (sizeof(ElfW(Addr)) / 4);
  const std::uint32_t* const chain = bucket + buckets;
  const std::uint32_t last = buckets == 0 ? 0 : *std::max_element(bucket, bucket + buckets);
  if (last < first) {
    return first;
  }
  std::size_t index = last;
  while ((chain[index - first] & 1) == 0) {
    ++index;
  }
  return index + 1;
}

std::string hex_of(const std::byte* data, std::size_t size) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string text;
  for (std::size_t i = 0; i < size; ++i) {
    text += kDigits[std::to_integer<unsigned>(data[i]) >> 4U];
    text += kDigits[std::to_integer<unsigned>(data[i]) & 15U];
  }
  return text;
}

}  // namespace

const link_map* library_at(std::uintptr_t address) noexcept {
  dl_find_object object{};
  return ::_dl_find_object(reinterpret_cast<void*>(address), &object) == 0 ? object.dlfo_link_map
                                                                           : nullptr;
}

std::string path_of(const link_map& library) {
  if (library.l_name != nullptr && library.l_name[0] != '\0') {
    return library.l_name;
  }
  std::error_code error;
  return std::filesystem::read_symlink("/proc/self/exe", error);
}

std::string build_id_of(const link_map& library, std::uintptr_t code) {
  dl_find_object object{};
  // The file's header begins the mapping with the unwind data. With gaps between the mappings
  // (segments at 64 KiB, pages of 4: AArch64), that of the code is another one.
  if (::_dl_find_object(reinterpret_cast<void*>(code), &object) != 0 ||
      ::_dl_find_object(object.dlfo_eh_frame, &object) != 0) {
    return {};
  }
  const auto* const file = static_cast<const std::byte*>(object.dlfo_map_start);
  const auto* const header = reinterpret_cast<const ElfW(Ehdr)*>(file);
  if (std::memcmp(header->e_ident, ELFMAG, SELFMAG) != 0) {
    return {};
  }
  const auto* const parts = reinterpret_cast<const ElfW(Phdr)*>(file + header->e_phoff);
  for (std::size_t i = 0; i < header->e_phnum; ++i) {
    if (parts[i].p_type != PT_NOTE) {
      continue;
    }
    const auto* note = reinterpret_cast<const std::byte*>(library.l_addr + parts[i].p_vaddr);
    const std::byte* const end = note + parts[i].p_memsz;
    const std::size_t alignment = std::max<std::size_t>(parts[i].p_align, 4);
    const auto aligned = [alignment](std::size_t size) {
      return (size + alignment - 1) / alignment * alignment;
    };
    while (note + sizeof(ElfW(Nhdr)) <= end) {
      const auto& head = *reinterpret_cast<const ElfW(Nhdr)*>(note);
      const std::byte* const name = note + sizeof(ElfW(Nhdr));
      const std::byte* const id = note + aligned(sizeof(ElfW(Nhdr)) + head.n_namesz);
      if (head.n_type == NT_GNU_BUILD_ID && head.n_namesz == sizeof(ELF_NOTE_GNU) &&
          std::memcmp(name, ELF_NOTE_GNU, sizeof(ELF_NOTE_GNU)) == 0) {
        return hex_of(id, head.n_descsz);
      }
      note = id + aligned(head.n_descsz);
    }
  }
  return {};
}

DynamicSymbols::DynamicSymbols(const link_map& library) noexcept : base_(library.l_addr) {
  // The loader turns these offsets into addresses, but not where the section is read-only, as in
  // the kernel's own library (vDSO).
  const auto table_at = [this](const ElfW(Dyn) & entry) {
    const std::uintptr_t place = entry.d_un.d_ptr;
    return place < base_ ? base_ + place : place;
  };
  for (const ElfW(Dyn)* entry = library.l_ld; entry != nullptr && entry->d_tag != DT_NULL;
       ++entry) {
    switch (entry->d_tag) {
      case DT_SYMTAB:
        symbols_ = reinterpret_cast<const ElfW(Sym)*>(table_at(*entry));
        break;
      case DT_STRTAB:
        names_ = reinterpret_cast<const char*>(table_at(*entry));
        break;
      case DT_GNU_HASH:
        count_ = symbol_count(reinterpret_cast<const std::uint32_t*>(table_at(*entry)));
        break;
      default:
        break;
    }
  }
}

/// The last exported function for which better(it, the one before it) held; null when the end came
/// first.
template <class Better>
    const ElfW(Sym) * DynamicSymbols::best(Better better, LookUpEnd end) const noexcept {
  const ElfW(Sym)* chosen = nullptr;
  for (std::size_t i = 0; symbols_ != nullptr && names_ != nullptr && i < count_; ++i) {
    if (is_late(i, end)) {
      return nullptr;
    }
    const ElfW(Sym)& symbol = symbols_[i];
    const auto type = ELF64_ST_TYPE(symbol.st_info);
    if (symbol.st_shndx != SHN_UNDEF && (type == STT_FUNC || type == STT_GNU_IFUNC) &&
        better(symbol, chosen)) {
      chosen = &symbol;
    }
  }
  return chosen;
}

DynamicSymbols::Function DynamicSymbols::function_at(std::uintptr_t address,
                                                     LookUpEnd end) const noexcept {
  const std::uintptr_t offset = address - base_;
  const auto contains = [offset](const ElfW(Sym) & candidate, const ElfW(Sym)*) {
    return candidate.st_value <= offset && offset < candidate.st_value + candidate.st_size;
  };
  const ElfW(Sym)* const symbol = best(contains, end);
  return symbol == nullptr ? Function{}
                           : Function{names_ + symbol->st_name, base_ + symbol->st_value};
}

std::uintptr_t DynamicSymbols::find(std::string_view name) const noexcept {
  const ElfW(Sym)* const symbol = best([name, this](const ElfW(Sym) & candidate, const ElfW(Sym)*) {
    return name == names_ + candidate.st_name;
  });
  return symbol == nullptr ? 0 : base_ + symbol->st_value;
}

std::uintptr_t DynamicSymbols::gap_before(std::uintptr_t address) const noexcept {
  const std::uintptr_t offset = address - base_;
  const ElfW(Sym)* const symbol =
      best([offset](const ElfW(Sym) & candidate, const ElfW(Sym) * before) {
        return candidate.st_value < offset &&
               (before == nullptr || candidate.st_value > before->st_value);
      });
  return symbol == nullptr ? address : base_ + symbol->st_value + symbol->st_size;
}

std::uintptr_t DynamicSymbols::gap_after(std::uintptr_t address) const noexcept {
  const std::uintptr_t offset = address - base_;
  const ElfW(Sym)* const symbol =
      best([offset](const ElfW(Sym) & candidate, const ElfW(Sym) * before) {
        return candidate.st_value > offset &&
               (before == nullptr || candidate.st_value < before->st_value);
      });
  return symbol == nullptr ? address : base_ + symbol->st_value;
}

FileSymbols::FileSymbols(const std::string& path) {
  const UniqueFd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  struct stat status{};
  if (!file || ::fstat(file.get(), &status) != 0 || status.st_size <= 0) {
    return;
  }
  size_ = static_cast<std::size_t>(status.st_size);
  void* const mapping = ::mmap(nullptr, size_, PROT_READ, MAP_PRIVATE, file.get(), 0);
  mapping_ = mapping == MAP_FAILED ? nullptr : mapping;
}

FileSymbols::~FileSymbols() {
  if (mapping_ != nullptr) {
    ::munmap(mapping_, size_);
  }
}

template <class T>
const T* FileSymbols::at(std::uint64_t offset, std::uint64_t count) const {
  if (mapping_ == nullptr || offset > size_ || count > (size_ - offset) / sizeof(T) ||
      offset % alignof(T) != 0) {
    return nullptr;
  }
  return reinterpret_cast<const T*>(static_cast<const char*>(mapping_) + offset);
}

std::optional<FileSymbols::Function> FileSymbols::function_at(std::uintptr_t address,
                                                              LookUpEnd end) const {
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
      if (is_late(n, end)) {
        return std::nullopt;
      }
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

std::string demangled(const char* name) {
  int status = 0;
  const std::unique_ptr<char, decltype(&std::free)> text(
      abi::__cxa_demangle(name, nullptr, nullptr, &status), &std::free);
  return status == 0 ? text.get() : name;
}

}  // namespace play_launch
