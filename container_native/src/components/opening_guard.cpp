#include "components/opening_guard.hpp"

#include <string.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>

#include "base/report.hpp"
#include "isolation/record/survive.hpp"
#include "overrides/exit_guard.hpp"

namespace play_launch::container {
namespace {

std::atomic<const char*> text{nullptr};
std::atomic<pid_t> thread{0};
pid_t process = 0;

/// Reports how the initialiser that runs in the calling thread ends the container; once.
void report_end(const char* how, const char* what) {
  const char* const known = text;
  if (known == nullptr || ::gettid() != thread || ::getpid() != process) {
    return;
  }
  // Put together without the allocator, which may be what crashed.
  std::array<char, 1024> line{};
  constexpr std::size_t kRoom = 64;
  ::strncpy(line.data(), known, line.size() - kRoom);
  ::strcat(line.data(), how);
  ::strncat(line.data(), what, kRoom / 2);
  report(line.data());
  text = nullptr;
}

/// Goes on as if there had been no handler: the process dies of the signal when this returns.
void on_fault(int signal, siginfo_t* info, void* context) {
  const int error = errno;
  isolation::is_surviving(*info);  // in another thread, which reads what a crash has damaged
  const char* const name = ::sigabbrev_np(signal);
  report_end(name != nullptr ? "died of SIG" : "died of a signal", name != nullptr ? name : "");
  struct sigaction action{};
  action.sa_handler = SIG_DFL;
  ::sigaction(signal, &action, nullptr);
  ::syscall(SYS_rt_tgsigqueueinfo, ::getpid(), ::gettid(), signal, info);
  sigdelset(&static_cast<ucontext_t*>(context)->uc_sigmask, signal);
  errno = error;
}

/// The container's own exit handlers and destructors would run, while its threads do.
void on_exit_call(const char* call) {
  if (text != nullptr && ::gettid() == thread && ::getpid() == process) {
    report_end("called ", call);
    std::abort();
  }
}

}  // namespace

OpeningGuard::Thread::Thread() noexcept {
  if (stack_) {
    stack_.use();
  }
}

OpeningGuard::Thread::~Thread() { isolation::AlternateStack::stop_using(); }

OpeningGuard::OpeningGuard(const std::string& node, const std::string& library)
    : text_("the container ends: opening " + library + " for node " + node +
            ", an initialiser of it ") {
  process = ::getpid();
  thread = ::gettid();
  text = text_.c_str();
  isolation::set_exit_hook(on_exit_call);
  struct sigaction action{};
  action.sa_sigaction = on_fault;
  action.sa_flags = SA_SIGINFO | SA_RESTART | SA_ONSTACK;
  sigfillset(&action.sa_mask);
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    ::sigaction(kSignals[i], &action, &before_[i]);
  }
}

OpeningGuard::~OpeningGuard() {
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    struct sigaction now{};
    ::sigaction(kSignals[i], nullptr, &now);
    if ((now.sa_flags & SA_SIGINFO) != 0 && now.sa_sigaction == on_fault) {
      ::sigaction(kSignals[i], &before_[i], nullptr);  // unless the library has put in its own
    }
  }
  isolation::set_exit_hook(nullptr);
  text = nullptr;
}

}  // namespace play_launch::container
