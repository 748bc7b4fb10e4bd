#pragma once

#include <pthread.h>

#include <memory>
#include <thread>

namespace play_launch::detail {

/// Puts a new object in the place of a mutex or a condition variable that threads may hold, or wait
/// for, whose process was killed. The old one must not be destroyed, as the C library would wait
/// for those threads, and no other thread can unlock it. It has nothing but its own bytes, so
/// that nothing is lost with it. No thread that lives may use it.
template <class T>
void forget(T& object) noexcept {
  std::construct_at(&object);
}

/// The same for the handle of a thread: its destructor would end the program. Frees the stack of a
/// thread that is dead; one that lives is detached.
inline void forget(std::thread& thread) noexcept {
  if (!thread.joinable()) return;
  const pthread_t handle = thread.native_handle();
  if (::pthread_tryjoin_np(handle, nullptr) != 0) ::pthread_detach(handle);
  std::construct_at(&thread);
}

}  // namespace play_launch::detail
