#include "overrides/exit_guard.hpp"

#include <pthread.h>
#include <signal.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>

#include "base/next_function.hpp"
#include "isolation/crash/crash_handler.hpp"
#include "isolation/quiesce/quiesce.hpp"
#include "isolation/record/child_record.hpp"

namespace play_launch::isolation {

namespace {

/// Ends the child alone, with its threads at rest as after a crash. `call` is what was called and
/// means that, such as "exit()".
[[noreturn]] void end_child(ChildRecord& child, int status, const char* call) noexcept {
  claim_end(child);
  CrashSlot& slot = *child.slot;
  slot.report.end_call = call;
  slot.report.exit_status = status;
  slot.phase = ChildPhase::exiting;
  quiesce(child);
  child.threads.rest();
  slot.phase = ChildPhase::dying;
  while (true) {
    ::syscall(SYS_exit_group, status);
  }
}

const NextFunction<"exit", void(int)> next_exit;
const NextFunction<"quick_exit", void(int)> next_quick_exit;
const NextFunction<"pthread_exit", void(void*)> next_pthread_exit;
const NextFunction<"pthread_cancel", int(pthread_t)> next_pthread_cancel;

std::atomic<void (*)(const char*)> exit_hook{nullptr};

void end_container(const char* call) {
  if (auto* const hook = exit_hook.load()) {
    hook(call);
  }
}

}  // namespace

void set_exit_hook(void (*hook)(const char* call)) noexcept { exit_hook = hook; }

}  // namespace play_launch::isolation

using play_launch::isolation::ChildRecord;
using play_launch::isolation::current_child;
using play_launch::isolation::end_child;
using play_launch::isolation::end_container;
using play_launch::isolation::next_exit;
using play_launch::isolation::next_pthread_cancel;
using play_launch::isolation::next_pthread_exit;
using play_launch::isolation::next_quick_exit;

extern "C" {

[[gnu::visibility("default")]] void exit(int status) noexcept {
  if (ChildRecord* const child = current_child()) {
    end_child(*child, status, "exit()");
  }
  end_container("exit()");
  next_exit.get()(status);
  std::abort();
}

/// The C library's takes a lock for its first steps, in the memory that all nodes share: after a
/// node that was ended there, every other abort() of the container would hang.
[[gnu::visibility("default")]] void abort() noexcept {
  sigset_t only;
  ::sigemptyset(&only);
  ::sigaddset(&only, SIGABRT);
  ::pthread_sigmask(SIG_UNBLOCK, &only, nullptr);
  ::syscall(SYS_tgkill, ::getpid(), ::gettid(), SIGABRT);
  // It is ignored, or its handler has returned.
  struct sigaction plain{};
  plain.sa_handler = SIG_DFL;
  ::sigaction(SIGABRT, &plain, nullptr);
  ::syscall(SYS_tgkill, ::getpid(), ::gettid(), SIGABRT);
  while (true) {
    ::_exit(127);
  }
}

[[gnu::visibility("default")]] void quick_exit(int status) noexcept {
  if (ChildRecord* const child = current_child()) {
    end_child(*child, status, "quick_exit()");
  }
  end_container("quick_exit()");
  next_quick_exit.get()(status);
  std::abort();
}

/// The first thread only lends its name to a thread of the container, which must not end here.
[[gnu::visibility("default")]] void pthread_exit(void* result) {
  ChildRecord* const child = current_child();
  if (child != nullptr && ::gettid() == ::getpid()) {
    end_child(*child, 0, "pthread_exit() in the first thread");
  }
  next_pthread_exit.get()(result);
  std::abort();
}

[[gnu::visibility("default")]] int pthread_cancel(pthread_t thread) {
  ChildRecord* const child = current_child();
  if (child != nullptr && ::pthread_equal(thread, child->first_thread) != 0) {
    end_child(*child, 0, "pthread_cancel() of the first thread");
  }
  return next_pthread_cancel.get()(thread);
}

}  // extern "C"
