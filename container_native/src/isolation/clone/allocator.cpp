#include "isolation/clone/allocator.hpp"

#include <dlfcn.h>

namespace play_launch::isolation {

namespace {

// Found when the program starts: later, that could wait for the initialisers of a node's library.
const auto function = reinterpret_cast<ThreadDone>(::dlsym(RTLD_DEFAULT, "mi_thread_done"));

}  // namespace

ThreadDone allocator_thread_done() { return function; }

}  // namespace play_launch::isolation
