#include "spawn_guard/command_file.hpp"

#include <fcntl.h>
#include <linux/close_range.h>
#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "base/process.hpp"
#include "base/resource_setting.hpp"

namespace play_launch {

namespace {

std::string read_all(int file) {
  std::string text;
  std::array<char, 65536> piece{};
  ssize_t size = 0;
  while ((size = ::pread(file, piece.data(), piece.size(), static_cast<off_t>(text.size()))) > 0) {
    text.append(piece.data(), static_cast<std::size_t>(size));
  }
  return text;
}

/// close_range(2), number by number where that fails: CLOSE_RANGE_CLOEXEC is of Linux 5.11, and
/// sandboxes refuse it. False with errno set when nothing lists what is open.
bool close_at_exec(unsigned first) {
  if (::close_range(first, ~0U, CLOSE_RANGE_CLOEXEC) == 0) {
    return true;
  }
  NumberList open("/proc/self/fd");
  return open.for_each([first](int each) {
    if (static_cast<unsigned>(each) >= first) {
      ::fcntl(each, F_SETFD, FD_CLOEXEC);
    }
  });
}

}  // namespace

bool Command::read(int file) {
  text = read_all(file);
  argv.clear();
  environment.clear();
  folder.clear();
  settings.clear();
  std::array<std::uint32_t, 4> counts{};
  if (text.size() < sizeof counts || text.back() != '\0') {
    return false;
  }
  std::memcpy(counts.data(), text.data(), sizeof counts);
  std::size_t at = sizeof counts;
  const std::array lists{&argv, &environment, &folder, &settings};
  for (std::size_t index = 0; index < lists.size(); ++index) {
    std::vector<char*>* list = lists[index];
    for (std::uint32_t left = counts[index]; left > 0; --left) {
      if (at >= text.size()) {
        return false;
      }
      list->push_back(text.data() + at);
      at = text.find('\0', at) + 1;
    }
    list->push_back(nullptr);
  }
  return at == text.size() && argv.front() != nullptr;
}

bool Command::apply_settings() const {
  for (const char* const text : settings) {
    const auto setting = text == nullptr ? std::nullopt : parse_resource_setting(text);
    if (text != nullptr && (!setting || !apply_or_complain(*setting))) {
      return false;
    }
  }
  return true;
}

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
  if (!close_at_exec(3)) {
    return false;
  }
  for (std::size_t index = 0; index < wanted.size(); ++index) {
    if (::dup2(moved[index], wanted[index]) < 0) {
      return false;
    }
  }
  return true;
}

}  // namespace play_launch

namespace play_launch::guard {

namespace {

/// Ignored signals and a signal mask survive exec; the command gets neither from us.
void reset_signals() {
  for (int number = 1; number < NSIG; ++number) {
    ::signal(number, SIG_DFL);  // fails for SIGKILL, SIGSTOP and the two of libc; nothing to do
  }
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
}

}  // namespace

bool tie_to(pid_t parent, const char* command) {
  if (::prctl(PR_SET_PDEATHSIG, SIGKILL) != 0) {
    std::perror("spawn_guard: PR_SET_PDEATHSIG");
    return false;
  }
  // The parent may have died before the request above; then no process would ever kill us.
  // Comparing with 1 is not enough: orphans may go to a subreaper.
  if (::getppid() != parent) {
    std::fprintf(stderr, "spawn_guard: parent %d is gone, not starting %s\n",
                 static_cast<int>(parent), command);
    return false;
  }
  return true;
}

bool enter(const char* folder) {
  if (folder == nullptr || ::chdir(folder) == 0) {
    return true;
  }
  std::fprintf(stderr, "spawn_guard: cannot enter %s: %s\n", folder, std::strerror(errno));
  return false;
}

int become(char* const* argv) {
  reset_signals();
  ::execvp(argv[0], argv);
  const int error = errno;
  std::fprintf(stderr, "spawn_guard: cannot execute %s: %s\n", argv[0], std::strerror(error));
  return error == ENOENT ? kNotFound : kCannotRun;
}

}  // namespace play_launch::guard
