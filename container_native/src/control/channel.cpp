#include "control/channel.hpp"

#include <poll.h>
#include <pthread.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <array>
#include <cerrno>
#include <cstring>
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
      wake_reader_(make_eventfd()),
      wake_writer_(make_eventfd()),
      capacity_(queue_capacity) {}

Channel::~Channel() { stop(); }

bool Channel::has_its_socket() const noexcept {
  return socket_inode_ != 0 && inode_of(socket_.get()) == socket_inode_;
}

void Channel::start(ChannelHandler& handler) {
  handler_ = &handler;
  writer_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "control-write");
    write_loop();
  });
  reader_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "control-read");
    read_loop();
  });
}

void Channel::open_gate() {
  gate_open_ = true;
  notify_eventfd(wake_reader_.get());
}

void Channel::expect_no_more() { ::shutdown(socket_.get(), SHUT_RD); }

void Channel::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_all();
  notify_eventfd(wake_reader_.get());
  notify_eventfd(wake_writer_.get());
  for (std::thread* thread : {&reader_, &writer_}) {
    if (thread->joinable()) {
      thread->join();
    }
  }
}

bool Channel::send(FrameKind kind, std::span<const std::uint8_t> payload) {
  std::vector<std::uint8_t> bytes = encode_frame(kind, payload);
  {
    const std::lock_guard lock(mutex_);
    if (broken_ || stopping_ || queue_.size() >= capacity_) {
      dropped_.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    if (queue_.empty() && !writing_) {
      // Not through another thread when the socket has room: on a busy machine that costs more than
      // everything else between a crash and its event.
      const std::size_t written = write_now(bytes);
      if (written == bytes.size()) {
        return true;
      }
      bytes.erase(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(written));
    }
    queue_.push_back(std::move(bytes));
  }
  changed_.notify_all();
  return true;
}

std::size_t Channel::write_now(std::span<const std::uint8_t> bytes) noexcept {
  // The socket's flags are shared with its creator: request non-blocking per call. What goes
  // wrong goes wrong for the writer as well, which deals with it.
  const ssize_t sent =
      ::send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  return sent > 0 ? static_cast<std::size_t>(sent) : 0;
}

bool Channel::flush(std::chrono::steady_clock::time_point deadline) {
  std::unique_lock lock(mutex_);
  changed_.wait_until(lock, deadline,
                      [this] { return broken_ || stopping_ || (queue_.empty() && !writing_); });
  return !broken_ && queue_.empty() && !writing_;
}

bool Channel::wait_readable() {
  while (!stopping_) {
    const bool open = gate_open_;
    std::array<pollfd, 2> fds{{
        {socket_.get(), static_cast<short>(open ? POLLIN : POLLRDHUP), 0},
        {wake_reader_.get(), POLLIN, 0},
    }};
    if (::poll(fds.data(), fds.size(), -1) < 0) {
      if (errno == EINTR) {
        continue;
      }
      throw std::system_error(errno, std::generic_category(), "poll");
    }
    if (fds[1].revents != 0) {
      clear_eventfd(wake_reader_.get());
    }
    if (fds[0].revents != 0) {
      return true;
    }
  }
  return false;
}

void Channel::read_loop() {
  FrameDecoder decoder;
  std::vector<std::uint8_t> buffer(kReadSize);
  try {
    while (wait_readable()) {
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
  } catch (const ProtocolError& error) {
    handler_->on_protocol_error(error.what());
  } catch (const std::system_error& error) {
    handler_->on_protocol_error(error.what());
  }
}

void Channel::write_loop() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return stopping_ || !queue_.empty(); });
    if (stopping_) {
      return;
    }
    const std::vector<std::uint8_t> bytes = std::move(queue_.front());
    queue_.pop_front();
    writing_ = true;
    lock.unlock();
    const bool written = write_all(bytes);
    lock.lock();
    writing_ = false;
    if (!written) {
      // The reader notices the end; here nothing more may pile up.
      broken_ = true;
      dropped_.fetch_add(queue_.size() + 1, std::memory_order_relaxed);
      queue_.clear();
      changed_.notify_all();
      return;
    }
    changed_.notify_all();
  }
}

bool Channel::write_all(std::span<const std::uint8_t> bytes) {
  while (!bytes.empty()) {
    // The socket's flags are shared with its creator: request non-blocking per call.
    const ssize_t sent =
        ::send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent >= 0) {
      bytes = bytes.subspan(static_cast<std::size_t>(sent));
      continue;
    }
    if (errno == EINTR) {
      continue;
    }
    if (errno != EAGAIN && errno != EWOULDBLOCK) {
      return false;
    }
    std::array<pollfd, 2> fds{{
        {socket_.get(), POLLOUT, 0},
        {wake_writer_.get(), POLLIN, 0},
    }};
    if (::poll(fds.data(), fds.size(), -1) < 0 && errno != EINTR) {
      return false;
    }
    if (stopping_) {
      return false;
    }
  }
  return true;
}

}  // namespace play_launch::control
