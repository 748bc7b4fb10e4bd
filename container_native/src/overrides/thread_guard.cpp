// Defines pthread_create() for the whole program, as exit_guard.cpp does with exit(): threads that
// a child starts are listed in its record and get a stack for crash handlers. Without one, a thread
// whose stack overflows is killed by the kernel before any handler runs.

#include <pthread.h>

#include <cerrno>
#include <new>

#include "base/next_function.hpp"
#include "isolation/record/child_record.hpp"

namespace {

using play_launch::isolation::ChildRecord;
using play_launch::isolation::ChildThreads;
using play_launch::isolation::current_child;

using Routine = void* (*)(void*);
const play_launch::NextFunction<"pthread_create",
                                int(pthread_t*, const pthread_attr_t*, Routine, void*)>
    next_create;

struct Start {
  ChildRecord* child;
  Routine routine;
  void* argument;
};

void* run(void* argument) {
  const Start start = *static_cast<Start*>(argument);
  delete static_cast<Start*>(argument);
  const ChildThreads::Entry entry(start.child->threads);
  return start.routine(start.argument);
}

}  // namespace

extern "C" [[gnu::visibility("default")]] int pthread_create(pthread_t* thread,
                                                             const pthread_attr_t* attributes,
                                                             Routine routine,
                                                             void* argument) noexcept {
  ChildRecord* const child = current_child();
  if (child == nullptr) {
    return next_create.get()(thread, attributes, routine, argument);
  }
  auto* const start = new (std::nothrow) Start{child, routine, argument};
  if (start == nullptr) {
    return EAGAIN;
  }
  const int error = next_create.get()(thread, attributes, run, start);
  if (error != 0) {
    delete start;
  }
  return error;
}
