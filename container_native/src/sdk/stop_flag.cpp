#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <ctime>
#include <play_launch/detail/stop_flag.hpp>

namespace play_launch::detail {

static_assert(std::atomic<std::uint32_t>::is_always_lock_free &&
              sizeof(std::atomic<std::uint32_t>) == sizeof(std::uint32_t));

void Doorbell::ring(int waiters) noexcept {
  rings_.fetch_add(1);
  if (waiters_.load() == 0) return;
  const int error = errno;  // of what a signal handler that rings interrupted
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&rings_), FUTEX_WAKE_PRIVATE, waiters,
          nullptr, nullptr, 0);
  errno = error;
}

void Doorbell::wait(std::uint32_t seen, Nanoseconds deadline) noexcept {
  constexpr Nanoseconds kSecond = 1'000'000'000;
  timespec until{};
  const timespec* timeout = nullptr;
  if (deadline != kNever) {
    const Nanoseconds at = deadline < 0 ? 0 : deadline;
    until.tv_sec = at / kSecond;
    until.tv_nsec = at % kSecond;
    timeout = &until;
  }
  waiters_.fetch_add(1);
  // The bitset form takes an absolute time, by CLOCK_MONOTONIC.
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&rings_), FUTEX_WAIT_BITSET_PRIVATE, seen,
          timeout, nullptr, FUTEX_BITSET_MATCH_ANY);
  waiters_.fetch_sub(1);
}

void StopFlag::wait() noexcept {
  while (true) {
    const auto seen = doorbell_.rings();
    if (is_set()) return;
    doorbell_.wait(seen);
  }
}

}  // namespace play_launch::detail
