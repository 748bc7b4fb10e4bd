#pragma once

#include <atomic>
#include <functional>
#include <mutex>

#if defined(__x86_64__)
/// Says that it is there, and never returns. Where its frame should be, no memory is.
extern "C" [[noreturn]] void stay_inside_without_frame(std::atomic<bool>* inside);
#endif

/// What a middleware does, from a library whose name makes it one.
namespace stand_in {

/// A lock that all nodes share.
std::mutex& shared_lock();
/// Takes it, works for some microseconds, and gives it back.
void publish();
/// Calls the callback without holding the lock, as an executor does.
void spin_once(void (*callback)());
/// Takes it, reports that it has it, and never gives it back.
[[noreturn]] void stay_inside(const std::function<void()>& report);
/// Crashes while it holds the lock.
void crash();

}  // namespace stand_in
