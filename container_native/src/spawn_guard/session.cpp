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

#include "base/process.hpp"
#include "base/unique_fd.hpp"
#include "spawn_guard/command_file.hpp"
#include "spawn_guard/descendants.hpp"

namespace play_launch::guard {

namespace {

/// What a SOCK_SEQPACKET carries in one piece: native-endian 32-bit integers, and descriptors.
struct DescriptorMessage {
  static constexpr std::size_t kMostDescriptors = 20;
  static constexpr std::size_t kMostNumbers = kMostDescriptors + 4;

  std::vector<std::int32_t> numbers;
  std::vector<UniqueFd> descriptors;

  /// False at the end of the socket, and when nothing can be received.
  bool receive(int socket);
};

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

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kRound{5};
/// Each goes through all of /proc, and what does not die of SIGKILL may take any time.
constexpr milliseconds kLongestRound{50};
enum Request : std::int32_t {
  kSpawn = 1,
  kStatus = 2,
  kReap = 3,
  kFarewell = 4,
  kGroup = 5,
  kForget = 6
};

using Answer = std::array<std::int32_t, 3>;
using Message = DescriptorMessage;

/// What stands before the numbers of the descriptors.
constexpr std::size_t kSpawnHead = 3;
/// What stands before the descriptors: the command, and the pipe of the go-ahead.
constexpr std::size_t kSpawnFiles = 2;

/// A copy above all numbers that a command wants, closed by exec.
UniqueFd out_of_the_way(const UniqueFd& fd, std::span<const std::int32_t> wanted) {
  const int above = std::max(2, *std::max_element(wanted.begin(), wanted.end())) + 1;
  return UniqueFd(::fcntl(fd.get(), F_DUPFD_CLOEXEC, above));
}

/// Waits for one byte; false at the end of the pipe.
bool wait_for_byte(const UniqueFd& pipe) {
  char byte = 0;
  ssize_t size = 0;
  while ((size = ::read(pipe.get(), &byte, 1)) < 0 && errno == EINTR) {
  }
  return size == 1;
}

class Session {
 public:
  explicit Session(UniqueFd socket)
      : socket_(std::move(socket)), guard_(::getpid()), supervisor_(::getppid()) {}

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
        if (!message.receive(socket_.get())) {
          break;
        }
        if (message.numbers.size() == 1 && message.numbers[0] == kGroup &&
            message.descriptors.size() == 1) {
          group_ = std::move(message.descriptors.front());
          message = {};
          continue;
        }
        if (message.numbers.size() == 1 && message.numbers[0] == kFarewell) {
          said_farewell_ = true;
          message = {};
          continue;
        }
        if (message.numbers.size() == 2 && message.numbers[0] == kForget) {
          started_.erase(message.numbers[1]);
          leaving_.erase(message.numbers[1]);
          reap_orphans();  // it may have ended already
          message = {};
          continue;
        }
        const Answer answer = carry_out(message);
        message = {};  // what was passed on is no business of ours any more
        if (::send(socket_.get(), answer.data(), sizeof answer, MSG_NOSIGNAL) < 0) {
          break;
        }
      }
    }
    leave_nothing();
    if (group_ && supervisor_has_died()) {
      remove_group(group_);
    }
    return 0;
  }

  /// Not so for one that ends in order, and waits for us. One that was killed may be our parent
  /// for a moment after its end of the socket has closed.
  bool supervisor_has_died() const { return !said_farewell_ || ::getppid() != supervisor_; }

 private:
  Answer carry_out(Message& message) {
    const std::span numbers(message.numbers);
    if (numbers.size() >= kSpawnHead && numbers[0] == kSpawn) {
      return spawn(message);
    }
    if (numbers.size() == 2 && (numbers[0] == kStatus || numbers[0] == kReap)) {
      return status(numbers[1], numbers[0] == kReap);
    }
    return {-EINVAL, 0, 0};
  }

  Answer spawn(Message& message) {
    const std::span numbers(message.numbers);
    const std::span wanted = numbers.subspan(kSpawnHead);
    Command command;
    if (wanted.size() < 3 || wanted.size() != static_cast<std::size_t>(numbers[2]) ||
        message.descriptors.size() != kSpawnFiles + wanted.size() ||
        !command.read(message.descriptors.front().get())) {
      return {-EINVAL, 0, 0};
    }
    const pid_t pid = start(command, std::span(message.descriptors).subspan(kSpawnFiles), wanted,
                            message.descriptors[1]);
    if (pid > 0) {
      (numbers[1] != 0 ? leaving_ : started_).insert(pid);
    }
    return {pid, 0, 0};
  }

  /// -errno when it could not be started. Executes nothing before a byte is in `go_ahead`: what the
  /// supervisor has given up would be a twin of what it starts instead.
  pid_t start(Command& command, std::span<const UniqueFd> descriptors,
              std::span<const std::int32_t> wanted, const UniqueFd& go_ahead) const {
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
      const UniqueFd is_set_up = out_of_the_way(write_end, wanted);
      const UniqueFd go = out_of_the_way(go_ahead, wanted);
      if (!place_descriptors(descriptors, wanted) || !command.apply_settings() ||
          !tie_to(guard_, command.argv[0])) {
        ::_exit(kRefused);
      }
      if (::write(is_set_up.get(), "", 1) != 1 || !wait_for_byte(go)) {
        ::_exit(kRefused);
      }
      ::_exit(enter(command.folder.front()) ? become(command.argv.data()) : kCannotRun);
    }
    // Until it leads a session of its own, and can be signalled, or has ended. Not until exec: a
    // program may be on a disk that takes long.
    write_end.reset();
    wait_for_byte(read_end);
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

  /// Those that we did not start: their parent has exited. The others keep their pid until the
  /// supervisor has seen their end.
  void reap_orphans() {
    for (const pid_t pid : children()) {
      if (!started_.contains(pid) && !leaving_.contains(pid)) {
        ::waitpid(pid, nullptr, WNOHANG);
      }
    }
  }

  void leave_nothing() {
    const auto deadline = steady_clock::now() + kOrphanGrace;
    sigset_t child;
    sigemptyset(&child);
    sigaddset(&child, SIGCHLD);
    for (auto round = kRound;; round = std::min(2 * round, kLongestRound)) {
      const bool spares = steady_clock::now() < deadline;
      kill_descendants(spares ? leaving_ : std::set<pid_t>());
      pid_t pid = 0;
      while ((pid = ::waitpid(-1, nullptr, WNOHANG)) > 0) {
        leaving_.erase(pid);
      }
      if (pid < 0 && errno == ECHILD) {
        return;
      }
      const timespec limit{0, std::chrono::nanoseconds(round).count()};
      ::sigtimedwait(&child, nullptr, &limit);
    }
  }

  UniqueFd socket_;
  const pid_t guard_;
  const pid_t supervisor_;
  bool said_farewell_ = false;
  UniqueFd group_;  // the folder of the session's control group, if it has one
  std::set<pid_t> started_;
  std::set<pid_t> leaving_;
};

}  // namespace

int guard_session(int socket, char* const* last_command) {
  Session session{UniqueFd(socket)};
  const int status = session.run();
  if (last_command == nullptr || !session.supervisor_has_died() || ::fork() != 0) {
    return status;
  }
  ::setsid();
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  ::signal(SIGPIPE, SIG_DFL);
  return become(last_command);
}

}  // namespace play_launch::guard
