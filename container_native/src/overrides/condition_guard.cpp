// Defines pthread_cond_destroy() for the whole program, as exit_guard.cpp does with exit(). The C
// library's waits until every thread that sleeps in the variable has left it, which threads of a
// dead child never do. So a child that cleans up after a dead one does not destroy condition
// variables; they own nothing.

#include <pthread.h>

#include "base/next_function.hpp"
#include "isolation/record/child_record.hpp"

namespace {

const play_launch::NextFunction<"pthread_cond_destroy", int(pthread_cond_t*)> next_destroy;

}  // namespace

extern "C" [[gnu::visibility("default")]] int pthread_cond_destroy(
    pthread_cond_t* condition) noexcept {
  const auto* const child = play_launch::isolation::current_child();
  return child != nullptr && child->after_death ? 0 : next_destroy.get()(condition);
}
