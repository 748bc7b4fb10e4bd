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
#include <set>
#include <span>
#include <vector>

#include "base/command_file.hpp"
#include "base/descriptor_message.hpp"
#include "base/unique_fd.hpp"
#include "spawn_guard/command.hpp"
#include "spawn_guard/descendants.hpp"
#include "spawn_guard/zygote_line.hpp"

namespace play_launch::guard {

namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kGrace{700};
constexpr milliseconds kRound{5};

enum Request : std::int32_t { kSpawn = 1, kStatus = 2, kReap = 3, kHelper = 4 };

using Answer = std::array<std::int32_t, 3>;
using Message = DescriptorMessage;

/// What stands before the numbers of the descriptors.
constexpr std::size_t kSpawnHead = 4;
constexpr std::size_t kHelperHead = 2;

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
        if (!message.receive(socket_.get())) {
          break;
        }
        if (message.numbers.size() > kHelperHead && message.numbers[0] == kHelper) {
          start_helper(message);
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
    return 0;
  }

 private:
  Answer carry_out(const Message& message) {
    const std::span numbers(message.numbers);
    if (numbers.size() >= kSpawnHead && numbers[0] == kSpawn) {
      return spawn(message);
    }
    if (numbers.size() == 2 && (numbers[0] == kStatus || numbers[0] == kReap)) {
      return status(numbers[1], numbers[0] == kReap);
    }
    return {-EINVAL, 0, 0};
  }

  Answer spawn(const Message& message) {
    const std::span numbers(message.numbers);
    const auto helper = static_cast<std::size_t>(numbers[2]);
    const std::size_t zygotes = helper == 0 ? 0 : 1;
    const std::span wanted = numbers.subspan(kSpawnHead);
    Command command;
    if (wanted.size() < 3 || wanted.size() != static_cast<std::size_t>(numbers[3]) ||
        message.descriptors.size() != 1 + zygotes + wanted.size() ||
        !command.read(message.descriptors.front().get())) {
      return {-EINVAL, 0, 0};
    }
    const std::span descriptors = std::span(message.descriptors).subspan(1 + zygotes);
    pid_t pid = 0;
    int obstacle = 0;
    if (zygotes != 0) {
      pid = fork_of_zygote(message.descriptors[1].get(), message.descriptors.front(), descriptors,
                           wanted);
      obstacle = pid < 0 ? -pid : 0;
    }
    if (obstacle == ETIMEDOUT && helper <= helpers_.size() && helpers_[helper - 1] > 0) {
      // It would keep open what was sent to it.
      ::kill(helpers_[helper - 1], SIGKILL);
    }
    if (pid <= 0) {
      pid = start(command, descriptors, wanted);
    }
    if (pid > 0) {
      (numbers[1] != 0 ? leaving_ : started_).insert(pid);
    }
    return {pid, obstacle, 0};
  }

  void start_helper(const Message& message) {
    const std::span wanted = std::span(message.numbers).subspan(kHelperHead);
    const std::span descriptors(message.descriptors);
    Command command;
    const bool fits = wanted.size() == static_cast<std::size_t>(message.numbers[1]) &&
                      descriptors.size() == 1 + wanted.size() &&
                      command.read(descriptors.front().get());
    helpers_.push_back(fits ? start(command, descriptors.subspan(1), wanted) : -EINVAL);
  }

  /// -errno when it could not be started.
  pid_t start(Command& command, std::span<const UniqueFd> descriptors,
              std::span<const std::int32_t> wanted) const {
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
      if (!place_descriptors(descriptors, wanted)) {
        ::_exit(kRefused);
      }
      ::_exit(tie_to(guard_, command.argv[0]) ? become(command.argv.data()) : kRefused);
    }
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
        std::replace(helpers_.begin(), helpers_.end(), pid, pid_t{0});
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
  std::vector<pid_t> helpers_;  // 0 or less: it does not run
};

}  // namespace

int guard_session(int socket) { return Session(UniqueFd(socket)).run(); }

}  // namespace play_launch::guard
