/* Only for ROS from PyPI's wheels.
 *
 * librcl of the wheels is linked against the Python halves of its interface packages
 * (lib*__rosidl_generator_py.so), which want these two data symbols from libpython. The dynamic
 * loader resolves data symbols at once, so a program that is not Python would not start. Nothing
 * ever touches them: the Python halves are only called from Python, and their function symbols are
 * resolved lazily. The program must export them (-rdynamic).
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

static void withdraw(const void* address) {
  Dl_info place;
  void* entry = NULL;
  if (dladdr1(address, &place, &entry, RTLD_DL_SYMENT) == 0 || entry == NULL) {
    return; /* not exported */
  }
  struct segment segment = {(uintptr_t)entry, PROT_NONE};
  dl_iterate_phdr(find_segment, &segment);
  if (segment.protection == PROT_NONE) {
    return;
  }
  const uintptr_t page_size = (uintptr_t)sysconf(_SC_PAGESIZE);
  const uintptr_t begin = (uintptr_t)entry & ~(page_size - 1);
  const size_t size = (uintptr_t)entry + sizeof(ElfW(Sym)) - begin;
  if (mprotect((void*)begin, size, segment.protection | PROT_WRITE) == 0) {
    ((ElfW(Sym)*)entry)->st_value = 0;
    mprotect((void*)begin, size, segment.protection);
  }
}

__attribute__((constructor)) static void withdraw_symbols(void) {
  withdraw(&PyExc_RuntimeError);
  withdraw(_Py_TrueStruct);
}
