// Defines pthread_create() for the whole program, as exit_guard.cpp does with exit(): threads that
// a child starts are listed in its record and get a stack for crash handlers. Without one, a thread
// whose stack overflows is killed by the kernel before any handler runs.
//
// And what initialises something once for all: pthread_once(), by which std::call_once() works, and
// the guards of function-local static variables. Whatever a child was initialising when it died is
// begun anew by the next to come, instead of being waited for without an end.
//
// And pthread_cond_destroy(): the C library's waits until every thread that sleeps in the variable
// has left it, which threads of a dead child never do. So a child that cleans up after a dead one
// does not destroy condition variables; they own nothing.

#include <cxxabi.h>
#include <pthread.h>

#include <cerrno>
#include <cstdint>
#include <new>

#include "base/next_function.hpp"
#include "isolation/record/child_record.hpp"

namespace {

using play_launch::isolation::ChildRecord;
using play_launch::isolation::ChildThreads;
using play_launch::isolation::current_child;
using play_launch::isolation::Initialisations;

using Routine = void* (*)(void*);
const play_launch::NextFunction<"pthread_create",
                                int(pthread_t*, const pthread_attr_t*, Routine, void*)>
    next_create;

const play_launch::NextFunction<"pthread_cond_destroy", int(pthread_cond_t*)> next_destroy;
const play_launch::NextFunction<"pthread_once", int(pthread_once_t*, void (*)())> next_once;
const play_launch::NextFunction<"__cxa_guard_acquire", int(abi::__guard*)> next_acquire;
const play_launch::NextFunction<"__cxa_guard_release", void(abi::__guard*)> next_release;
const play_launch::NextFunction<"__cxa_guard_abort", void(abi::__guard*)> next_abort;

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

/// A call of pthread_once() in a child.
struct Once {
  ChildRecord& child;
  pthread_once_t* const control;
  void (*const routine)();
};

/// The calling thread's innermost one.
thread_local constinit const Once* current_once = nullptr;

/// No thread waits for one on the stack of a thread that is dead, and the donor uses its stack
/// again.
bool is_on_own_stack(const void* address) noexcept {
  const auto place = reinterpret_cast<std::uintptr_t>(address);
  return reinterpret_cast<std::uintptr_t>(__builtin_frame_address(0)) <= place &&
         place < reinterpret_cast<std::uintptr_t>(__builtin_thread_pointer());
}

/// The C library's mark of what is done. Were it another one, each call would only take longer.
bool is_done(const pthread_once_t& control) noexcept {
  constexpr int kDone = 2;
  return (__atomic_load_n(&control, __ATOMIC_ACQUIRE) & kDone) != 0;
}

}  // namespace

// By its name, the judge of places (isolation/quiesce/code_map.cpp) knows it.
extern "C" [[gnu::visibility("default")]] void pthread_once_in_child() {
  const Once& once = *current_once;
  constexpr auto kKind = Initialisations::Kind::once;
  once.child.initialisations.begin(once.control, kKind);
  struct End {
    const Once& once;
    ~End() { once.child.initialisations.end(once.control, kKind); }
  } const end{once};
  once.routine();
}

extern "C" [[gnu::visibility("default")]] int pthread_once(pthread_once_t* control,
                                                           void (*routine)()) {
  if (is_done(*control)) {
    return 0;
  }
  ChildRecord* const child = current_child();
  if (child == nullptr || is_on_own_stack(control)) {
    return next_once.get()(control, routine);
  }
  const Once once{*child, control, routine};
  struct Nested {
    const Once* const outer = current_once;
    ~Nested() { current_once = outer; }
  } const nested;
  current_once = &once;
  return next_once.get()(control, pthread_once_in_child);
}

namespace __cxxabiv1 {

extern "C" [[gnu::visibility("default")]] int __cxa_guard_acquire(__guard* guard) {
  ChildRecord* const child = current_child();
  const int begins = next_acquire.get()(guard);
  if (begins != 0 && child != nullptr) {
    child->initialisations.begin(guard, Initialisations::Kind::guard);
  }
  return begins;
}

extern "C" [[gnu::visibility("default")]] void __cxa_guard_release(__guard* guard) noexcept {
  ChildRecord* const child = current_child();
  next_release.get()(guard);
  if (child != nullptr) {
    child->initialisations.end(guard, Initialisations::Kind::guard);
  }
}

extern "C" [[gnu::visibility("default")]] void __cxa_guard_abort(__guard* guard) noexcept {
  if (ChildRecord* const child = current_child()) {
    child->initialisations.end(guard, Initialisations::Kind::guard);
  }
  next_abort.get()(guard);
}

}  // namespace __cxxabiv1

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

extern "C" [[gnu::visibility("default")]] int pthread_cond_destroy(
    pthread_cond_t* condition) noexcept {
  const auto* const child = current_child();
  return child != nullptr && child->after_death ? 0 : next_destroy.get()(condition);
}
