#include "components/opening_guard.hpp"

#include <string.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>

#include "base/report.hpp"
#include "isolation/record/survive.hpp"

namespace play_launch::container {
namespace {

std::atomic<const char*> text{nullptr};
std::atomic<pid_t> thread{0};
pid_t process = 0;

/// Goes on as if there had been no handler: the process dies of the signal when this returns.
void on_fault(int signal, siginfo_t* info, void* context) {
  const int error = errno;
  isolation::is_surviving(*info);  // in another thread, which reads what a crash has damaged
  const char* const what = text;
  if (what != nullptr && ::gettid() == thread && ::getpid() == process) {
    // Put together without the allocator, which may be what crashed.
    std::array<char, 1024> line{};
    const char* const name = ::sigabbrev_np(signal);
    ::strncpy(line.data(), what, line.size() - 16);
    ::strcat(line.data(), name != nullptr ? "SIG" : "a signal");
    ::strcat(line.data(), name != nullptr ? name : "");
    report(line.data());
  }
  struct sigaction action{};
  action.sa_handler = SIG_DFL;
  ::sigaction(signal, &action, nullptr);
  ::syscall(SYS_rt_tgsigqueueinfo, ::getpid(), ::gettid(), signal, info);
  sigdelset(&static_cast<ucontext_t*>(context)->uc_sigmask, signal);
  errno = error;
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
            ", an initialiser of it died of ") {
  process = ::getpid();
  thread = ::gettid();
  text = text_.c_str();
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
  text = nullptr;
}

}  // namespace play_launch::container
