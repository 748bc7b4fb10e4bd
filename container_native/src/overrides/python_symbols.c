/* Only for ROS from PyPI's wheels.
 *
 * librcl of the wheels is linked against the Python halves of its interface packages
 * (lib*__rosidl_generator_py.so), which want these two data symbols from libpython. The dynamic
 * loader resolves data symbols at once, so a program that is not Python would not start. Nothing
 * ever touches them: the Python halves are only called from Python, and their function symbols are
 * resolved lazily. The program must export them (cmake/exports.list).
 *
 * A program comes first wherever the loader looks for a symbol. Left exported, these two would be
 * given to the libpython that a component brings along, too: its own `True` would not be true, and
 * its exceptions null. So they are withdrawn when all that the program was started with has been
 * resolved: the loader passes over symbols without a value. What keeps them is the wheels' Python
 * halves of librcl's own interfaces; a component that uses these from an interpreter of its own
 * would see wrong booleans there.
 */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <link.h>
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

void* PyExc_RuntimeError;
char _Py_TrueStruct[64];

/* What holds the program's table of symbols. */
struct segment {
  uintptr_t address;
  int protection;
};

/* The first object is the program. */
static int find_segment(struct dl_phdr_info* object, size_t size, void* argument) {
  struct segment* const wanted = argument;
  (void)size;
  for (int i = 0; i < object->dlpi_phnum; ++i) {
    const ElfW(Phdr)* const header = &object->dlpi_phdr[i];
    const uintptr_t begin = object->dlpi_addr + header->p_vaddr;
    if (header->p_type == PT_LOAD && wanted->address - begin < header->p_memsz) {
      wanted->protection = (header->p_flags & PF_R ? PROT_READ : 0) |
                           (header->p_flags & PF_W ? PROT_WRITE : 0) |
                           (header->p_flags & PF_X ? PROT_EXEC : 0);
    }
  }
  return 1;
}

/* One of the symbols: its entry in the program's table, and the value that it was linked with. */
struct stand_in {
  const void* const address;
  ElfW(Sym) * entry;
  ElfW(Addr) value;
};

static struct stand_in stand_ins[] = {{&PyExc_RuntimeError, NULL, 0}, {_Py_TrueStruct, NULL, 0}};

static void set_value(const struct stand_in* symbol, ElfW(Addr) value) {
  struct segment segment = {(uintptr_t)symbol->entry, PROT_NONE};
  dl_iterate_phdr(find_segment, &segment);
  if (segment.protection == PROT_NONE) {
    return;
  }
  const uintptr_t page_size = (uintptr_t)sysconf(_SC_PAGESIZE);
  const uintptr_t begin = (uintptr_t)symbol->entry & ~(page_size - 1);
  const size_t size = (uintptr_t)symbol->entry + sizeof(ElfW(Sym)) - begin;
  if (mprotect((void*)begin, size, segment.protection | PROT_WRITE) == 0) {
    symbol->entry->st_value = value;
    mprotect((void*)begin, size, segment.protection);
  }
}

/* Used by library_loader.cpp for a library that wants the symbols and brings no libpython. */
__attribute__((visibility("hidden"))) void play_launch_stand_in_for_python(int active) {
  for (size_t i = 0; i < sizeof stand_ins / sizeof stand_ins[0]; ++i) {
    if (stand_ins[i].entry != NULL) {
      set_value(&stand_ins[i], active ? stand_ins[i].value : 0);
    }
  }
}

__attribute__((constructor)) static void withdraw_symbols(void) {
  for (size_t i = 0; i < sizeof stand_ins / sizeof stand_ins[0]; ++i) {
    Dl_info place;
    void* entry = NULL;
    if (dladdr1(stand_ins[i].address, &place, &entry, RTLD_DL_SYMENT) != 0 && entry != NULL) {
      stand_ins[i].entry = entry;
      stand_ins[i].value = stand_ins[i].entry->st_value;
    }
  }
  play_launch_stand_in_for_python(0);
}
