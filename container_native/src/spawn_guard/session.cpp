#include "spawn_guard/session.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/signalfd.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "base/unique_fd.hpp"
#include "spawn_guard/command.hpp"
#include "spawn_guard/descendants.hpp"

namespace play_launch::guard {

namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kGrace{700};
constexpr milliseconds kRound{5};
constexpr std::size_t kMostDescriptors = 16;
constexpr std::size_t kMostNumbers = kMostDescriptors + 3;

enum Request : std::int32_t { kSpawn = 1, kStatus = 2, kReap = 3 };

using Answer = std::array<std::int32_t, 3>;

struct Message {
  std::vector<std::int32_t> numbers;
  std::vector<UniqueFd> descriptors;
};

/// A command as it was written into a file: pointers into the text, each list with a null at its
/// end.
struct Command {
  std::string text;
  std::vector<char*> argv;
  std::vector<char*> environment;
};

/// False at the end of the socket.
bool receive(int socket, Message& message) {
  message = {};
  std::array<std::int32_t, kMostNumbers> numbers{};
  alignas(cmsghdr) std::array<char, CMSG_SPACE((kMostDescriptors + 1) * sizeof(int))> control{};
  iovec part{numbers.data(), sizeof numbers};
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
        message.descriptors.emplace_back(fd);
      }
    }
  }
  const auto count = static_cast<std::size_t>(size) / sizeof(std::int32_t);
  message.numbers.assign(numbers.begin(), numbers.begin() + static_cast<std::ptrdiff_t>(count));
  return true;
}

std::string read_all(int file) {
  std::string text;
  std::array<char, 65536> piece{};
  ssize_t size = 0;
  while ((size = ::pread(file, piece.data(), piece.size(), static_cast<off_t>(text.size()))) > 0) {
    text.append(piece.data(), static_cast<std::size_t>(size));
  }
  return text;
}

/// False when the file does not hold a command.
bool read_command(int file, Command& command) {
  command.text = read_all(file);
  std::array<std::uint32_t, 2> counts{};
  if (command.text.size() < sizeof counts || command.text.back() != '\0') {
    return false;
  }
  std::memcpy(counts.data(), command.text.data(), sizeof counts);
  std::size_t at = sizeof counts;
  for (auto* list : {&command.argv, &command.environment}) {
    for (std::uint32_t left = counts[list == &command.environment]; left > 0; --left) {
      if (at >= command.text.size()) {
        return false;
      }
      list->push_back(command.text.data() + at);
      at = command.text.find('\0', at) + 1;
    }
    list->push_back(nullptr);
  }
  return at == command.text.size() && command.argv.front() != nullptr;
}

/// Gives the received descriptors the numbers that the command knows; false with errno set.
bool place_descriptors(std::span<const UniqueFd> received, std::span<const std::int32_t> wanted) {
  // Out of the way first: a number that is wanted may be one that was received.
  const int above = std::max(2, *std::max_element(wanted.begin(), wanted.end())) + 1;
  std::vector<int> moved;
  for (const UniqueFd& each : received) {
    moved.push_back(::fcntl(each.get(), F_DUPFD_CLOEXEC, above));
    if (moved.back() < 0) {
      return false;
    }
  }
  ::close_range(3, ~0U, CLOSE_RANGE_CLOEXEC);
  for (std::size_t index = 0; index < wanted.size(); ++index) {
    if (::dup2(moved[index], wanted[index]) < 0) {
      return false;
    }
  }
  return true;
}

class Session {
 public:
  explicit Session(UniqueFd socket) : socket_(std::move(socket)), guard_(::getpid()) {}

  int run() {
    sigset_t child;
    sigemptyset(&child);
    sigaddset(&child, SIGCHLD);
    ::signal(SIGPIPE, SIG_IGN);
    if (::sigprocmask(SIG_BLOCK, &child, nullptr) != 0 || ::prctl(PR_SET_CHILD_SUBREAPER, 1) != 0) {
      return kRefused;
    }
    const UniqueFd ended(::signalfd(-1, &child, SFD_CLOEXEC | SFD_NONBLOCK));
    Message message;
    while (true) {
      std::array<pollfd, 2> sources{pollfd{socket_.get(), POLLIN, 0},
                                    pollfd{ended.get(), POLLIN, 0}};
      if (::poll(sources.data(), sources.size(), -1) < 0 && errno != EINTR) {
        break;
      }
      if (sources[1].revents != 0) {
        signalfd_siginfo ignored;
        while (::read(ended.get(), &ignored, sizeof ignored) > 0) {
        }
        reap_orphans();
      }
      if (sources[0].revents != 0) {
        if (!receive(socket_.get(), message)) {
          break;
        }
        const Answer answer = carry_out(message);
        if (::send(socket_.get(), answer.data(), sizeof answer, MSG_NOSIGNAL) < 0) {
          break;
        }
      }
    }
    leave_nothing();
    return 0;
  }

 private:
  Answer carry_out(const Message& message) {
    const std::span numbers(message.numbers);
    if (numbers.size() >= 3 && numbers[0] == kSpawn) {
      const auto count = static_cast<std::size_t>(numbers[2]);
      const bool fits = numbers.size() == 3 + count && message.descriptors.size() == 1 + count;
      return {fits && count >= 3 ? spawn(message, numbers[1] != 0) : -EINVAL, 0, 0};
    }
    if (numbers.size() == 2 && (numbers[0] == kStatus || numbers[0] == kReap)) {
      return status(numbers[1], numbers[0] == kReap);
    }
    return {-EINVAL, 0, 0};
  }

  std::int32_t spawn(const Message& message, bool leaves_by_itself) {
    Command command;
    if (!read_command(message.descriptors.front().get(), command)) {
      return -EINVAL;
    }
    std::array<int, 2> ends{};
    if (::pipe2(ends.data(), O_CLOEXEC) != 0) {
      return -errno;
    }
    const UniqueFd read_end(ends[0]);
    UniqueFd write_end(ends[1]);
    const pid_t pid = ::fork();
    if (pid < 0) {
      return -errno;
    }
    if (pid == 0) {
      environ = command.environment.data();
      ::setsid();
      if (!place_descriptors(std::span(message.descriptors).subspan(1),
                             std::span(message.numbers).subspan(3))) {
        ::_exit(kRefused);
      }
      ::_exit(tie_to(guard_, command.argv[0]) ? become(command.argv.data()) : kRefused);
    }
    (leaves_by_itself ? leaving_ : started_).insert(pid);
    // Until exec or its end: from then on it leads a session of its own, and can be signalled.
    write_end.reset();
    char ignored = 0;
    while (::read(read_end.get(), &ignored, 1) < 0 && errno == EINTR) {
    }
    return pid;
  }

  Answer status(pid_t pid, bool reap) {
    siginfo_t info{};
    const int flags = WEXITED | WNOHANG | (reap ? 0 : WNOWAIT);
    if (::waitid(P_PID, static_cast<id_t>(pid), &info, flags) != 0) {
      return {-errno, 0, 0};
    }
    if (info.si_pid == 0) {
      return {0, 0, 0};
    }
    if (reap) {
      started_.erase(pid);
      leaving_.erase(pid);
    }
    return {1, info.si_code, info.si_status};
  }

  /// Those that we did not start: whoever did is gone. The others keep their pid until the
  /// supervisor has seen their end.
  void reap_orphans() {
    std::vector<pid_t> ours(started_.begin(), started_.end());
    ours.insert(ours.end(), leaving_.begin(), leaving_.end());
    for (const pid_t pid : zombie_children()) {
      if (std::find(ours.begin(), ours.end(), pid) == ours.end()) {
        ::waitpid(pid, nullptr, WNOHANG);
      }
    }
  }

  void leave_nothing() {
    const auto deadline = steady_clock::now() + kGrace;
    while (true) {
      const bool spares = steady_clock::now() < deadline;
      kill_descendants(spares ? leaving_ : std::set<pid_t>());
      pid_t pid = 0;
      while ((pid = ::waitpid(-1, nullptr, WNOHANG)) > 0) {
        leaving_.erase(pid);
      }
      if (pid < 0 && errno == ECHILD) {
        return;
      }
      ::usleep(static_cast<useconds_t>(std::chrono::microseconds(kRound).count()));
    }
  }

  UniqueFd socket_;
  const pid_t guard_;
  std::set<pid_t> started_;
  std::set<pid_t> leaving_;
};

}  // namespace

int guard_session(int socket) { return Session(UniqueFd(socket)).run(); }

}  // namespace play_launch::guard
