#include "control/channel.hpp"

#include <poll.h>
#include <pthread.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <optional>
#include <system_error>
#include <utility>

#include "base/unique_fd.hpp"

namespace play_launch::control {
namespace {

constexpr std::size_t kReadSize = 64 * 1024;  // bytes

/// 0: it is not open.
ino_t inode_of(int fd) noexcept {
  struct stat status{};
  return ::fstat(fd, &status) == 0 ? status.st_ino : 0;
}

}  // namespace

Channel::Channel(UniqueFd socket, std::size_t queue_capacity)
    : socket_(std::move(socket)),
      socket_inode_(inode_of(socket_.get())),
      wake_(make_eventfd()),
      capacity_(queue_capacity) {}

Channel::~Channel() { stop(); }

bool Channel::has_its_socket() const noexcept {
  return socket_inode_ != 0 && inode_of(socket_.get()) == socket_inode_;
}

void Channel::start(ChannelHandler& handler) {
  handler_ = &handler;
  thread_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "control-read");
    try {
      serve();
    } catch (const ProtocolError& error) {
      handler_->on_protocol_error(error.what());
    } catch (const std::system_error& error) {
      handler_->on_protocol_error(error.what());
    }
  });
}

void Channel::open_gate() {
  gate_open_ = true;
  notify_eventfd(wake_.get());
}

void Channel::expect_no_more() { ::shutdown(socket_.get(), SHUT_RD); }

void Channel::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_all();
  notify_eventfd(wake_.get());
  if (thread_.joinable()) {
    thread_.join();
  }
}

bool Channel::send(FrameKind kind, std::span<const std::uint8_t> payload) {
  std::vector<std::uint8_t> bytes = encode_frame(kind, payload);
  const std::lock_guard lock(mutex_);
  if (broken_ || stopping_ || queue_.size() >= capacity_) {
    dropped_.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  queue_.push_back(std::move(bytes));
  if (queue_.size() == 1) {
    // Not through another thread when the socket has room: on a busy machine that costs more than
    // everything else between a crash and its event.
    write_waiting();
    if (!queue_.empty()) {
      notify_eventfd(wake_.get());
    }
  }
  return !broken_;
}

/// Writes what the socket takes now of the frames that wait.
void Channel::write_waiting() {
  while (!queue_.empty()) {
    const std::span bytes = std::span(queue_.front()).subspan(written_);
    // The socket's flags are shared with its creator: request non-blocking per call.
    const ssize_t sent =
        ::send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent < 0 && errno != EINTR) {
      if (errno != EAGAIN && errno != EWOULDBLOCK) {
        // The reader notices the end; here nothing more may pile up.
        broken_ = true;
        dropped_.fetch_add(queue_.size(), std::memory_order_relaxed);
        queue_.clear();
      }
      break;
    }
    written_ += static_cast<std::size_t>(std::max<ssize_t>(sent, 0));
    if (written_ == queue_.front().size()) {
      queue_.pop_front();
      written_ = 0;
    }
  }
  if (queue_.empty()) {
    changed_.notify_all();
  }
}

bool Channel::flush(std::chrono::steady_clock::time_point deadline) {
  std::unique_lock lock(mutex_);
  changed_.wait_until(lock, deadline, [this] { return stopping_ || queue_.empty(); });
  return !broken_ && queue_.empty();
}

bool Channel::is_waiting_to_write() {
  const std::lock_guard lock(mutex_);
  return !queue_.empty();
}

void Channel::serve() {
  FrameDecoder decoder;
  std::vector<std::uint8_t> buffer(kReadSize);
  while (!stopping_) {
    const int events = (gate_open_ ? POLLIN : POLLRDHUP) | (is_waiting_to_write() ? POLLOUT : 0);
    std::array<pollfd, 2> fds{{
        {socket_.get(), static_cast<short>(events), 0},
        {wake_.get(), POLLIN, 0},
    }};
    if (::poll(fds.data(), fds.size(), -1) < 0) {
      if (errno == EINTR) {
        continue;
      }
      throw std::system_error(errno, std::generic_category(), "poll");
    }
    if (fds[1].revents != 0) {
      clear_eventfd(wake_.get());
    }
    if ((fds[0].revents & POLLOUT) != 0) {
      const std::lock_guard lock(mutex_);
      write_waiting();
    }
    if ((fds[0].revents & ~POLLOUT) == 0) {
      continue;
    }
    if (!gate_open_) {
      handler_->on_closed();  // only the peer's end wakes us before the gate is open
      return;
    }
    const ssize_t got = ::recv(socket_.get(), buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR)) {
      continue;
    }
    if (got <= 0) {  // ECONNRESET: the peer died with unread data; gone all the same
      handler_->on_closed();
      return;
    }
    decoder.feed(std::span(buffer).first(static_cast<std::size_t>(got)));
    while (const std::optional<Frame> frame = decoder.next()) {
      if (stopping_) {
        return;
      }
      handler_->on_frame(*frame);
    }
  }
}

}  // namespace play_launch::control
