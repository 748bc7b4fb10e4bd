#include "components/rclcpp/missing_symbols.hpp"

#include <cxxabi.h>
#include <dlfcn.h>
#include <link.h>

#include <cstdlib>
#include <memory>
#include <string_view>

namespace play_launch::rclcpp_backend {
namespace {

struct CloseLibrary {
  void operator()(void* handle) const { ::dlclose(handle); }
};
using LibraryHandle = std::unique_ptr<void, CloseLibrary>;

/// The part of a library's dynamic section that tells which functions it calls.
struct CallTable {
  const ElfW(Sym) * symbols = nullptr;
  const char* names = nullptr;
  const ElfW(Rela) * relocations = nullptr;
  std::size_t count = 0;
};

CallTable call_table(const link_map& library) {
  CallTable table;
  for (const ElfW(Dyn)* entry = library.l_ld; entry != nullptr && entry->d_tag != DT_NULL;
       ++entry) {
    switch (entry->d_tag) {
      case DT_SYMTAB:
        table.symbols = reinterpret_cast<const ElfW(Sym)*>(entry->d_un.d_ptr);
        break;
      case DT_STRTAB:
        table.names = reinterpret_cast<const char*>(entry->d_un.d_ptr);
        break;
      case DT_JMPREL:
        table.relocations = reinterpret_cast<const ElfW(Rela)*>(entry->d_un.d_ptr);
        break;
      case DT_PLTRELSZ:
        table.count = entry->d_un.d_val / sizeof(ElfW(Rela));
        break;
      default:
        break;
    }
  }
  return table;
}

bool is_there(void* library, const char* name) {
  return ::dlsym(RTLD_DEFAULT, name) != nullptr || ::dlsym(library, name) != nullptr;
}

std::string readable(const char* name) {
  int status = 0;
  const std::unique_ptr<char, decltype(&std::free)> text(
      abi::__cxa_demangle(name, nullptr, nullptr, &status), &std::free);
  return status == 0 ? text.get() : name;
}

}  // namespace

std::vector<std::string> missing_functions(const std::string& library) {
  std::vector<std::string> missing;
  const LibraryHandle handle(::dlopen(library.c_str(), RTLD_LAZY | RTLD_NOLOAD));
  const link_map* map = nullptr;
  if (handle == nullptr || ::dlinfo(handle.get(), RTLD_DI_LINKMAP, &map) != 0) {
    return missing;
  }
  const CallTable table = call_table(*map);
  if (table.symbols == nullptr || table.names == nullptr || table.relocations == nullptr) {
    return missing;
  }
  for (std::size_t i = 0; i < table.count; ++i) {
    const ElfW(Sym)& symbol = table.symbols[ELF64_R_SYM(table.relocations[i].r_info)];
    const char* const name = table.names + symbol.st_name;
    if (symbol.st_shndx == SHN_UNDEF && ELF64_ST_BIND(symbol.st_info) != STB_WEAK &&
        *name != '\0' && !is_there(handle.get(), name)) {
      missing.push_back(readable(name));
    }
  }
  return missing;
}

}  // namespace play_launch::rclcpp_backend
