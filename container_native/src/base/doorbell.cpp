#include "base/doorbell.hpp"

#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <system_error>

namespace play_launch {

UniqueFd make_doorbell() {
  const int fd = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (fd < 0) {
    throw std::system_error(errno, std::generic_category(), "eventfd");
  }
  return UniqueFd(move_to_high_number(fd));
}

void ring(int doorbell) noexcept {
  const std::uint64_t one = 1;
  // Fails only when the counter is full, and then all waiters are awake anyway.
  [[maybe_unused]] const ssize_t written = ::write(doorbell, &one, sizeof one);
}

void hush(int doorbell) noexcept {
  std::uint64_t count = 0;
  [[maybe_unused]] const ssize_t got = ::read(doorbell, &count, sizeof count);
}

}  // namespace play_launch
