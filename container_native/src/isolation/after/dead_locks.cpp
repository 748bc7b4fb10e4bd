#include "isolation/after/dead_locks.hpp"

#include <fcntl.h>
#include <linux/futex.h>
#include <pthread.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <system_error>

#include "base/process.hpp"
#include "base/unique_fd.hpp"
#include "isolation/record/child_record.hpp"

namespace play_launch::isolation {

/// What a thread sleeps in: futex(address, operation, value), without a time limit.
struct DeadLockSearch::Wait {
  std::uintptr_t address = 0;
  unsigned operation = 0;
  std::uint32_t value = 0;
};

namespace {

using Text = std::array<char, 256>;
using Children = std::array<pid_t, kMaxChildren>;

/// One file's text; empty when it cannot be read. Without the allocator and stdio's locks.
template <class... Parts>
Text read_text(const char* format, Parts... parts) noexcept {
  std::array<char, 64> path{};
  std::snprintf(path.data(), path.size(), format, parts...);
  Text text{};
  const int fd = ::open(path.data(), O_RDONLY | O_CLOEXEC);
  if (fd >= 0) {
    [[maybe_unused]] const ssize_t size = ::read(fd, text.data(), text.size() - 1);
    ::close(fd);
  }
  return text;
}

bool is_thread_of(pid_t thread, pid_t process) noexcept {
  std::array<char, 64> path{};
  std::snprintf(path.data(), path.size(), "/proc/%d/task/%d", process, thread);
  return ::access(path.data(), F_OK) == 0;
}

template <class Visit>
void for_each_thread(pid_t process, Visit visit) noexcept {
  std::array<char, 64> path{};
  std::snprintf(path.data(), path.size(), "/proc/%d/task", process);
  NumberList(path.data()).for_each(visit);
}

std::array<char, 16> name_of(pid_t process, pid_t thread) noexcept {
  const Text text = read_text("/proc/%d/task/%d/comm", process, thread);
  std::array<char, 16> name{};
  std::copy_n(text.data(), std::min(std::strcspn(text.data(), "\n"), name.size() - 1), name.data());
  return name;
}

// What follows knows how the C library (since 2.25) keeps a lock that is waited for. Each check
// rules out memory that is something else and looks like a lock by chance.

constexpr unsigned kMostUsers = 4096;

pid_t holder_of(const pthread_mutex_t& mutex) noexcept {
  constexpr int kWaitedFor = 2;
  // The others have other ways to deal with a dead holder.
  constexpr int kOrdinary = PTHREAD_MUTEX_RECURSIVE_NP | PTHREAD_MUTEX_ERRORCHECK_NP;
  constexpr int kElisionFlags = 0x300;
  const auto& data = mutex.__data;
  const bool plausible = data.__lock == kWaitedFor && data.__nusers >= 1 &&
                         data.__nusers <= kMostUsers &&
                         (data.__kind & ~(kOrdinary | kElisionFlags)) == 0;
  return plausible ? data.__owner : 0;
}

pid_t holder_of(const pthread_rwlock_t& lock) noexcept {
  constexpr unsigned kWriteLocked = 2;
  constexpr unsigned kMostKinds = 2;
  const auto& data = lock.__data;
  const bool plausible = (data.__readers & kWriteLocked) != 0 && data.__shared == 0 &&
                         data.__pad3 == 0 && data.__pad4 == 0 && data.__flags <= kMostKinds;
  return plausible ? data.__cur_writer : 0;
}

std::size_t living(Children& pids) noexcept {
  const std::size_t children = living_children(pids);
  if (children < pids.size()) {
    pids[children] = ::getpid();
    return children + 1;
  }
  return children;
}

bool is_alive(pid_t thread) noexcept {
  Children pids;
  const std::size_t count = living(pids);
  return std::any_of(pids.begin(), pids.begin() + count,
                     [thread](pid_t process) { return is_thread_of(thread, process); });
}

}  // namespace

std::string describe(const DeadLock& lock) {
  return "thread " + std::to_string(lock.thread) + " ('" + lock.thread_name.data() +
         "') of process " + std::to_string(lock.process) +
         " waits for a lock that was held by process " + std::to_string(lock.holder.process) +
         " ('" + lock.holder.process_name.data() + "') when it died";
}

DeadLockSearch::DeadLockSearch() {
  if (::pipe2(pipe_.data(), O_CLOEXEC | O_NONBLOCK) != 0) {
    throw std::system_error(errno, std::generic_category(), "pipe");
  }
  for (int& end : pipe_) {
    end = move_to_high_number(end);
  }
}

DeadLockSearch::~DeadLockSearch() {
  ::close(pipe_[0]);
  ::close(pipe_[1]);
}

std::optional<DeadLockSearch::Wait> DeadLockSearch::wait_of(pid_t process, pid_t thread) noexcept {
  const Text text = read_text("/proc/%d/task/%d/syscall", process, thread);
  long number = 0;
  unsigned long address = 0;
  unsigned long operation = 0;
  unsigned long value = 0;
  unsigned long limit = 0;
  // "running" for one that does not sleep in a system call.
  if (std::sscanf(text.data(), "%ld %lx %lx %lx %lx", &number, &address, &operation, &value,
                  &limit) != 5 ||
      number != SYS_futex || limit != 0) {
    return std::nullopt;
  }
  return Wait{address, static_cast<unsigned>(operation), static_cast<std::uint32_t>(value)};
}

pid_t DeadLockSearch::holder_of(const Wait& wait) noexcept {
  namespace here = play_launch::isolation;
  constexpr unsigned kMutex = FUTEX_WAIT | FUTEX_PRIVATE_FLAG;
  constexpr std::uint32_t kMutexWaitedFor = 2;
  constexpr unsigned kOther = FUTEX_WAIT_BITSET | FUTEX_PRIVATE_FLAG;
  constexpr std::uint32_t kWriterWaitedFor = 3;
  if (wait.operation == kMutex && wait.value == kMutexWaitedFor) {
    pthread_mutex_t mutex;
    return read(wait.address, mutex) ? here::holder_of(mutex) : 0;
  }
  if ((wait.operation & ~FUTEX_CLOCK_REALTIME) == kOther && wait.value == kWriterWaitedFor) {
    // Readers wait in the one place, writers in the other.
    for (const std::size_t offset : {offsetof(pthread_rwlock_t, __data.__wrphase_futex),
                                     offsetof(pthread_rwlock_t, __data.__writers_futex)}) {
      pthread_rwlock_t lock;
      const pid_t holder = read(wait.address - offset, lock) ? here::holder_of(lock) : 0;
      if (holder != 0 && find_dead_thread(holder)) {
        return holder;
      }
    }
  }
  return 0;
}

/// Memory that may be gone by now: through the kernel, which does not mind.
template <class Lock>
bool DeadLockSearch::read(std::uintptr_t address, Lock& lock) noexcept {
  const ssize_t written = ::write(pipe_[1], reinterpret_cast<const void*>(address), sizeof lock);
  if (written <= 0) {
    return false;
  }
  // What came in part must not be found by the next one.
  return ::read(pipe_[0], &lock, static_cast<std::size_t>(written)) == sizeof lock;
}

std::size_t DeadLockSearch::look(std::span<DeadLock> found) noexcept {
  std::size_t count = 0;
  Children pids;
  const std::size_t processes = living(pids);
  for (std::size_t i = 0; i < processes; ++i) {
    for_each_thread(pids[i], [&](pid_t thread) {
      const std::optional<Wait> wait = wait_of(pids[i], thread);
      if (!wait || count == found.size()) {
        return;
      }
      const pid_t holder = holder_of(*wait);
      const std::optional<DeadThread> dead = holder != 0 ? find_dead_thread(holder) : std::nullopt;
      // The owner locked it before the living threads were listed.
      if (dead && !is_alive(holder) && holder_of(*wait) == holder) {
        found[count++] = {pids[i], thread, name_of(pids[i], thread), wait->address, *dead};
      }
    });
  }
  return count;
}

}  // namespace play_launch::isolation
