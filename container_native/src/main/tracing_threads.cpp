#include "main/tracing_threads.hpp"

#include <dlfcn.h>

#include <initializer_list>

namespace play_launch::container {
namespace {

using Function = void (*)(sigset_t*);

/// By the name of LTTng 2.13, or the one before.
Function find(std::initializer_list<const char*> names) {
  for (const char* const name : names) {
    if (void* const found = ::dlsym(RTLD_DEFAULT, name)) {
      return reinterpret_cast<Function>(found);
    }
  }
  return nullptr;
}

}  // namespace

TracingThreads::TracingThreads()
    : before_(find({"lttng_ust_before_fork", "ust_before_fork"})),
      after_(find({"lttng_ust_after_fork_parent", "ust_after_fork_parent"})),
      in_child_(find({"lttng_ust_after_fork_child", "ust_after_fork_child"})) {}

bool TracingThreads::are_there() const {
  return before_ != nullptr && after_ != nullptr && in_child_ != nullptr;
}

void TracingThreads::before_fork() {
  if (are_there()) {
    before_(&mask_);
  }
}

void TracingThreads::after_fork() {
  if (are_there()) {
    after_(&mask_);
  }
}

void TracingThreads::in_child() {
  if (are_there()) {
    in_child_(&mask_);
  }
}

}  // namespace play_launch::container
