#include "base/descriptor_message.hpp"

#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <cstring>

namespace play_launch {

bool DescriptorMessage::receive(int socket) {
  numbers.clear();
  descriptors.clear();
  std::array<std::int32_t, kMostNumbers> content{};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(kMostDescriptors * sizeof(int))> control{};
  iovec part{content.data(), sizeof content};
  msghdr header{};
  header.msg_iov = &part;
  header.msg_iovlen = 1;
  header.msg_control = control.data();
  header.msg_controllen = control.size();
  ssize_t size = 0;
  do {
    size = ::recvmsg(socket, &header, MSG_CMSG_CLOEXEC);
  } while (size < 0 && errno == EINTR);
  if (size <= 0) {
    return false;
  }
  for (cmsghdr* each = CMSG_FIRSTHDR(&header); each != nullptr; each = CMSG_NXTHDR(&header, each)) {
    if (each->cmsg_level == SOL_SOCKET && each->cmsg_type == SCM_RIGHTS) {
      std::vector<int> fds((each->cmsg_len - CMSG_LEN(0)) / sizeof(int));
      std::memcpy(fds.data(), CMSG_DATA(each), fds.size() * sizeof(int));
      for (const int fd : fds) {
        descriptors.emplace_back(fd);
      }
    }
  }
  const auto count = static_cast<std::size_t>(size) / sizeof(std::int32_t);
  numbers.assign(content.begin(), content.begin() + static_cast<std::ptrdiff_t>(count));
  return true;
}

bool send_message(int socket, std::span<const std::int32_t> numbers,
                  std::span<const int> descriptors) {
  if (descriptors.size() > DescriptorMessage::kMostDescriptors) {
    errno = EINVAL;
    return false;
  }
  alignas(cmsghdr) std::array<char, CMSG_SPACE(DescriptorMessage::kMostDescriptors * sizeof(int))>
      control{};
  iovec part{const_cast<std::int32_t*>(numbers.data()), numbers.size_bytes()};
  msghdr header{};
  header.msg_iov = &part;
  header.msg_iovlen = 1;
  if (!descriptors.empty()) {
    header.msg_control = control.data();
    header.msg_controllen = CMSG_SPACE(descriptors.size_bytes());
    cmsghdr* const rights = CMSG_FIRSTHDR(&header);
    rights->cmsg_level = SOL_SOCKET;
    rights->cmsg_type = SCM_RIGHTS;
    rights->cmsg_len = CMSG_LEN(descriptors.size_bytes());
    std::memcpy(CMSG_DATA(rights), descriptors.data(), descriptors.size_bytes());
  }
  ssize_t size = 0;
  do {
    size = ::sendmsg(socket, &header, MSG_NOSIGNAL | MSG_DONTWAIT);
  } while (size < 0 && errno == EINTR);
  return size == static_cast<ssize_t>(numbers.size_bytes());
}

}  // namespace play_launch
