#include "main/probe.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <optional>
#include <string_view>
#include <vector>

#include "base/elf.hpp"
#include "base/unique_fd.hpp"
#include "components/backend_list.hpp"
#include "components/library_loader.hpp"
#include "isolation/clone/child.hpp"
#include "isolation/clone/donor_thread.hpp"
#include "isolation/crash/crash_handler.hpp"
#include "isolation/crash/symbolise.hpp"
#include "main/host_choice.hpp"
#include "main/stop.hpp"

namespace play_launch::container {
namespace {

struct Finding {
  std::string library;
  std::string error;
  int signal = 0;
  std::vector<std::string> modules;
  std::vector<std::string> backtrace;
};

std::string json_text(std::string_view text) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      result += '\\';
      result += c;
    } else if (static_cast<unsigned char>(c) < 0x20) {
      std::array<char, 8> code{};
      std::snprintf(code.data(), code.size(), "\\u%04x", static_cast<unsigned>(c));
      result += code.data();
    } else {
      result += c;
    }
  }
  return result + '"';
}

std::string json_list(const std::vector<std::string>& texts) {
  std::string result;
  for (const std::string& text : texts) {
    result += (result.empty() ? "" : ", ") + json_text(text);
  }
  return "[" + result + "]";
}

std::string json(const Finding& finding) {
  return "{\"library\": " + json_text(finding.library) +
         ", \"error\": " + json_text(finding.error) +
         ", \"signal\": " + std::to_string(finding.signal) +
         ", \"modules\": " + json_list(finding.modules) +
         ", \"backtrace\": " + json_list(finding.backtrace) + "}\n";
}

int conclude(int out, const Finding& finding) {
  const std::string line = json(finding);
  const bool written = ::write(out, line.data(), line.size()) == static_cast<ssize_t>(line.size());
  return written && finding.error.empty() ? kExitOk : kExitFailed;
}

/// Opens the library in a process that shares this one's memory, as a node's does: its crash
/// handlers leave the place of a crash to this one.
class Opening final : public isolation::ChildProgram {
 public:
  Opening(ComponentBackend& backend, const BackendList::Place& place, const std::string& plugin)
      : backend_(backend), place_(place), plugin_(plugin) {}

  int run() override {
    try {
      library_ = open_library(backend_, place_.library);
      library_->find(plugin_);
    } catch (...) {
      failure_ = describe_current_exception();
    }
    return 0;
  }
  void cancel() noexcept override {}

  const std::string& failure() const { return failure_; }
  /// What was opened stays so.
  void forget() noexcept { static_cast<void>(library_.release()); }

 private:
  ComponentBackend& backend_;
  const BackendList::Place& place_;
  const std::string& plugin_;
  std::unique_ptr<ComponentLibrary> library_;
  std::string failure_;
};

Finding open_library(const BackendList& backends, const BackendList::Place& place,
                     const std::string& plugin) {
  Finding finding;
  finding.library = place.library;
  Opening opening(backends[place.backend], place, plugin);
  isolation::prepare_crash_handling();
  isolation::CrashSlot slot;
  isolation::ChildEnd end;
  isolation::ChildOptions options;
  options.name = "probe";
  isolation::DonorThread donor("probe",
                               [&] { end = isolation::run_in_child(opening, slot, options); });
  donor.join();
  if (end.error != 0) {
    opening.run();  // no such processes here: a crash ends this one, and probe() reports it
    end = {};
    end.returned = true;
  }
  if (end.clean()) {
    finding.error = opening.failure();
  } else {
    finding.error = "cannot load library " + place.library + ": an initialiser of it ended with " +
                    isolation::describe_end(end, slot);
    finding.signal = end.signal;
    finding.modules = isolation::modules_of(slot);
    finding.backtrace = isolation::symbolise(slot, kNoLookUpEnd);
  }
  opening.forget();
  return finding;
}

/// stdout becomes stderr; what it was before.
UniqueFd take_stdout() {
  UniqueFd out(::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 3));
  ::dup2(STDERR_FILENO, STDOUT_FILENO);
  return out;
}

}  // namespace

int probe(const std::string& package, const std::string& plugin) {
  const UniqueFd out = take_stdout();
  const BackendList backends = make_backends(nullptr);
  BackendList::Place place;
  try {
    place = backends.place_of(package, plugin);
  } catch (const LoadError& error) {
    return conclude(out.get(), {"", error.what(), 0, {}, {}});
  }
  // However the process that opens it ends, this one is left to report it.
  const pid_t parent = ::getpid();
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::getppid() != parent) {
      ::_exit(kExitFailed);
    }
    ::_exit(conclude(out.get(), open_library(backends, place, plugin)));
  }
  int status = 0;
  if (pid < 0 || ::waitpid(pid, &status, 0) != pid) {
    return conclude(out.get(), {place.library, "cannot start a process", 0, {}, {}});
  }
  if (WIFEXITED(status)) {
    return WEXITSTATUS(status);  // it has written the line
  }
  const int signal = WTERMSIG(status);
  return conclude(
      out.get(), {place.library,
                  "cannot load library " + place.library + ": the process that opened it died of " +
                      isolation::signal_name(signal),
                  signal,
                  {},
                  {}});
}

}  // namespace play_launch::container
