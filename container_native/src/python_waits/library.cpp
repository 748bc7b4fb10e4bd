// A library for Python processes with participants of Fast DDS: gives Fast DDS the functions of
// overrides/condition_deadline.cpp and overrides/owned_lock.cpp, which give the reasons. Our own
// programs define them before all libraries; in a Python that is running already the C library's
// come first, so the entries in the table through which Fast DDS calls them are replaced.

#include <link.h>
#include <pthread.h>
#include <sys/mman.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <string_view>

#include "base/elf.hpp"

namespace {

using play_launch::DynamicSymbols;
using play_launch::library_at;

struct Override {
  std::string_view name;
  std::uintptr_t function;
};

std::array<Override, 3> overrides() noexcept {
  return {{
      {"pthread_cond_timedwait", reinterpret_cast<std::uintptr_t>(&::pthread_cond_timedwait)},
      {"pthread_mutex_timedlock", reinterpret_cast<std::uintptr_t>(&::pthread_mutex_timedlock)},
      {"pthread_mutex_unlock", reinterpret_cast<std::uintptr_t>(&::pthread_mutex_unlock)},
  }};
}

bool is_in_read_only_part(const dl_phdr_info& object, std::uintptr_t address) noexcept {
  for (int i = 0; i < object.dlpi_phnum; ++i) {
    const ElfW(Phdr)& part = object.dlpi_phdr[i];
    if (part.p_type == PT_GNU_RELRO && address - (object.dlpi_addr + part.p_vaddr) < part.p_memsz) {
      return true;
    }
  }
  return false;
}

/// False when the kernel refuses to have it written.
bool replace(const dl_phdr_info& object, std::uintptr_t slot, std::uintptr_t function) noexcept {
  const auto page_size = static_cast<std::uintptr_t>(::sysconf(_SC_PAGESIZE));
  auto* const page = reinterpret_cast<void*>(slot & ~(page_size - 1));
  // Libraries whose calls were bound when they were loaded have their table protected since.
  const bool is_protected = is_in_read_only_part(object, slot);
  if (is_protected && ::mprotect(page, page_size, PROT_READ | PROT_WRITE) != 0) {
    return false;
  }
  // Other threads may be calling through it.
  std::atomic_ref(*reinterpret_cast<std::uintptr_t*>(slot)).store(function);
  if (is_protected) {
    ::mprotect(page, page_size, PROT_READ);
  }
  return true;
}

struct Search {
  std::string_view prefix;
  int replaced = 0;
};

int visit(dl_phdr_info* object, std::size_t, void* argument) noexcept {
  auto& search = *static_cast<Search*>(argument);
  const std::string_view path = object->dlpi_name;
  if (!path.substr(path.rfind('/') + 1).starts_with(search.prefix)) {
    return 0;
  }
  const ElfW(Phdr)& first = object->dlpi_phdr[0];
  if (const link_map* const library = library_at(object->dlpi_addr + first.p_vaddr)) {
    const DynamicSymbols symbols(*library);
    bool any = false;
    for (const Override& each : overrides()) {
      const std::uintptr_t slot = symbols.call_slot(each.name);
      any |= slot != 0 && replace(*object, slot, each.function);
    }
    search.replaced += any ? 1 : 0;
  }
  return 0;
}

}  // namespace

/// Replaces them in the loaded libraries whose file names begin so; returns in how many.
extern "C" int play_launch_replace_waits(const char* prefix) {
  Search search{prefix};
  ::dl_iterate_phdr(visit, &search);
  return search.replaced;
}
