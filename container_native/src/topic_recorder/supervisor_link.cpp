#include "topic_recorder/supervisor_link.hpp"

#include <pthread.h>
#include <sys/socket.h>
#include <sys/uio.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

namespace play_launch::topics {

SupervisorLink::SupervisorLink(UniqueFd socket, std::function<void()> on_arrival)
    : socket_(std::move(socket)), on_arrival_(std::move(on_arrival)), receiver_([this] {
        ::pthread_setname_np(::pthread_self(), "supervisor");
        receive();
      }) {}

SupervisorLink::~SupervisorLink() {
  ::shutdown(socket_.get(), SHUT_RD);
  receiver_.join();
}

void SupervisorLink::post(Packet packet) {
  waiting_.push_back(std::move(packet));
  flush();
}

bool SupervisorLink::flush() {
  while (!waiting_.empty() && send(waiting_.front())) {
    waiting_.pop_front();
  }
  return waiting_.empty();
}

bool SupervisorLink::send(const Packet& packet, int descriptor) {
  const std::string& content = packet.content();
  iovec part{const_cast<char*>(content.data()), content.size()};
  msghdr header{};
  header.msg_iov = &part;
  header.msg_iovlen = 1;
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
  if (descriptor >= 0) {
    header.msg_control = control.data();
    header.msg_controllen = control.size();
    cmsghdr* const rights = CMSG_FIRSTHDR(&header);
    rights->cmsg_level = SOL_SOCKET;
    rights->cmsg_type = SCM_RIGHTS;
    rights->cmsg_len = CMSG_LEN(sizeof(int));
    std::memcpy(CMSG_DATA(rights), &descriptor, sizeof(int));
  }
  while (::sendmsg(socket_.get(), &header, MSG_NOSIGNAL | MSG_DONTWAIT) < 0) {
    if (errno == EAGAIN || errno == ENOBUFS || errno == ETOOMANYREFS) {
      return false;
    }
    if (errno != EINTR) {
      return true;
    }
  }
  return true;
}

std::vector<Request> SupervisorLink::requests() {
  const std::lock_guard lock(mutex_);
  return std::exchange(requests_, {});
}

void SupervisorLink::receive() {
  std::array<char, 64> data{};
  while (true) {
    const ssize_t size = ::recv(socket_.get(), data.data(), data.size(), 0);
    if (size < 0 && errno == EINTR) {
      continue;
    }
    Request request;
    request.kind = Kind::gone;
    if (size > 0) {
      request = Request::read(data.data(), static_cast<std::size_t>(size));
    }
    {
      const std::lock_guard lock(mutex_);
      requests_.push_back(request);
    }
    on_arrival_();
    if (size <= 0) {
      return;
    }
  }
}

}  // namespace play_launch::topics
