// Defines read(), pread(), recv() and recvfrom() for the whole program. The kernel does not write
// where the calling thread may not: into another node's private memory the call fails with EFAULT,
// which looks like any wrong address. Here the node then tries the write itself, and dies of it as
// of any other, with whose memory it was. In a handler of the node, whose rights are those of
// handlers until the first access, the call is made again.

#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdint>

#include "base/next_function.hpp"
#include "isolation/memory/private_memory.hpp"
#include "isolation/record/child_record.hpp"

namespace {

using play_launch::NextFunction;
using play_launch::isolation::ChildRecord;
using play_launch::isolation::current_child;
using play_launch::isolation::PrivateMemory;

const NextFunction<"read", ssize_t(int, void*, std::size_t)> next_read;
const NextFunction<"pread", ssize_t(int, void*, std::size_t, off_t)> next_pread;
const NextFunction<"pread64", ssize_t(int, void*, std::size_t, off64_t)> next_pread64;
const NextFunction<"recv", ssize_t(int, void*, std::size_t, int)> next_recv;
const NextFunction<"recvfrom", ssize_t(int, void*, std::size_t, int, sockaddr*, socklen_t*)>
    next_recvfrom;

/// Writes what is there to each page of it that is private memory of a node. False: no page is.
bool touch(void* buffer, std::size_t size) noexcept {
  constexpr std::uintptr_t kPage = 4096;
  const auto begin = reinterpret_cast<std::uintptr_t>(buffer);
  bool is_private = false;
  for (std::uintptr_t place = begin; place - begin < size; place = (place / kPage + 1) * kPage) {
    if (!PrivateMemory::is_any(place)) {
      return is_private;  // the ordinary reason for EFAULT
    }
    is_private = true;
    std::atomic_ref<char>(*reinterpret_cast<char*>(place)).fetch_or(0);
  }
  return is_private;
}

/// Of a call that ended so: whether to make it again. Keeps errno.
bool is_to_be_repeated(ssize_t result, void* buffer, std::size_t size) noexcept {
  if (result >= 0 || errno != EFAULT) {
    return false;
  }
  const ChildRecord* const child = current_child();
  const bool repeat = child != nullptr && child->options.key_rights != 0 && touch(buffer, size);
  errno = EFAULT;
  return repeat;
}

}  // namespace

extern "C" {

[[gnu::visibility("default")]] ssize_t read(int fd, void* buffer, std::size_t size) {
  const ssize_t result = next_read.get()(fd, buffer, size);
  return is_to_be_repeated(result, buffer, size) ? next_read.get()(fd, buffer, size) : result;
}

[[gnu::visibility("default")]] ssize_t pread(int fd, void* buffer, std::size_t size, off_t offset) {
  const ssize_t result = next_pread.get()(fd, buffer, size, offset);
  return is_to_be_repeated(result, buffer, size) ? next_pread.get()(fd, buffer, size, offset)
                                                 : result;
}

[[gnu::visibility("default")]] ssize_t pread64(int fd, void* buffer, std::size_t size,
                                               off64_t offset) {
  const ssize_t result = next_pread64.get()(fd, buffer, size, offset);
  return is_to_be_repeated(result, buffer, size) ? next_pread64.get()(fd, buffer, size, offset)
                                                 : result;
}

[[gnu::visibility("default")]] ssize_t recv(int fd, void* buffer, std::size_t size, int flags) {
  const ssize_t result = next_recv.get()(fd, buffer, size, flags);
  return is_to_be_repeated(result, buffer, size) ? next_recv.get()(fd, buffer, size, flags)
                                                 : result;
}

[[gnu::visibility("default")]] ssize_t recvfrom(int fd, void* buffer, std::size_t size, int flags,
                                                sockaddr* address, socklen_t* length) {
  const ssize_t result = next_recvfrom.get()(fd, buffer, size, flags, address, length);
  return is_to_be_repeated(result, buffer, size)
             ? next_recvfrom.get()(fd, buffer, size, flags, address, length)
             : result;
}

}  // extern "C"
