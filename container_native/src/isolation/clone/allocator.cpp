#include "isolation/clone/allocator.hpp"

#include <dlfcn.h>

namespace play_launch::isolation {

ThreadDone allocator_thread_done() {
  static const auto function =
      reinterpret_cast<ThreadDone>(::dlsym(RTLD_DEFAULT, "mi_thread_done"));
  return function;
}

}  // namespace play_launch::isolation
