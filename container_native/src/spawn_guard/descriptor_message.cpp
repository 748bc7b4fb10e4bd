#include "spawn_guard/descriptor_message.hpp"

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

}  // namespace play_launch
