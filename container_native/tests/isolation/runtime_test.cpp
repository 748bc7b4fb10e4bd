// A child is a complete process of C and C++: what the libraries offer works in it and, whatever it
// did, on its donor's next child.

#include <dlfcn.h>
#include <locale.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <sys/wait.h>
#include <threads.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <csetjmp>
#include <cstdlib>
#include <locale>
#include <mutex>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "harness.hpp"
#include "overrides/exit_guard.hpp"

namespace {

using namespace isolation_test;

/// The child runs the body; its return value must be 0.
void in_child(const std::function<void()>& body) {
  Outcome outcome;
  run(outcome, [&body](Program&) {
    body();
    return 0;
  });
  if (!outcome.end.clean()) {
    std::fprintf(stderr, "%s\n%s", outcome.text().c_str(), joined(outcome.slot).c_str());
  }
  CHECK(outcome.end.clean());
  CHECK(outcome.slot.phase == ChildPhase::returned);
}

void use_the_libraries() {
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%f %g", 1.5, 2.5e300);
  CHECK(std::string(text.data()) == "1.500000 2.5e+300");
  std::ostringstream stream;
  stream.imbue(std::locale::classic());
  stream << 3.25 << " " << std::sqrt(2.0);
  CHECK(stream.str() == "3.25 1.41421");
  thread_local std::string kept = "x";
  kept += "y";
  CHECK(kept == "xy");
  try {
    static_cast<void>(std::vector<int>().at(3));
    CHECK(!"thrown");
  } catch (const std::out_of_range&) {
  }
  CHECK(std::uncaught_exceptions() == 0);
  errno = ENOENT;
  int error_in_thread = ENOENT;
  std::thread([&] { error_in_thread = errno; }).join();
  CHECK(errno == ENOENT && error_in_thread == 0);
}

void test_libraries() {
  in_child(use_the_libraries);
  in_child([] { std::thread(use_the_libraries).join(); });
}

void test_locale_stays_in_the_child() {
  locale_t before = nullptr;
  locale_t after = nullptr;
  Outcome outcome;
  Program program([](Program&) {
    ::uselocale(::newlocale(LC_ALL_MASK, "C.UTF-8", nullptr));
    std::abort();
    return 0;
  });
  DonorThread donor("donor", [&] {
    before = ::uselocale(nullptr);
    errno = EDOM;
    outcome.end = run_in_child(program, outcome.slot);
    after = ::uselocale(nullptr);
    CHECK(errno == EDOM);
  });
  donor.join();
  CHECK(before == after);
  CHECK(outcome.end.signal == SIGABRT);
}

void test_thread_is_the_process() {
  in_child([] {
    CHECK(::gettid() == ::getpid());
    // By the thread's handle: the C library must know its present id.
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(::sched_getcpu(), &one);
    CHECK(::pthread_setaffinity_np(::pthread_self(), sizeof one, &one) == 0);
    cpu_set_t now;
    CHECK(::sched_getaffinity(0, sizeof now, &now) == 0);
    CHECK(CPU_COUNT(&now) == 1);
    static std::atomic<pid_t> signalled{0};
    ::signal(SIGUSR1, [](int) { signalled = ::gettid(); });
    CHECK(::pthread_kill(::pthread_self(), SIGUSR1) == 0 && signalled == ::gettid());
    CHECK(::raise(SIGUSR1) == 0 && signalled == ::gettid());
    const pthread_t first = ::pthread_self();
    const pid_t process = ::getpid();
    std::thread([first] { CHECK(::pthread_kill(first, SIGUSR1) == 0); }).join();
    CHECK(signalled == process);
    pid_t raised = 0;
    std::thread([&raised] {
      CHECK(::raise(SIGUSR1) == 0);
      raised = ::gettid();
    }).join();
    CHECK(signalled == raised);
  });
}

struct Mutex {
  Mutex(int type, int protocol, int robustness) {
    pthread_mutexattr_t attributes;
    ::pthread_mutexattr_init(&attributes);
    ::pthread_mutexattr_settype(&attributes, type);
    ::pthread_mutexattr_setprotocol(&attributes, protocol);
    ::pthread_mutexattr_setrobust(&attributes, robustness);
    CHECK(::pthread_mutex_init(&mutex, &attributes) == 0);
  }
  pthread_mutex_t mutex{};
};

void test_mutexes() {
  static Mutex errors(PTHREAD_MUTEX_ERRORCHECK, PTHREAD_PRIO_NONE, PTHREAD_MUTEX_STALLED);
  static Mutex inherits(PTHREAD_MUTEX_RECURSIVE, PTHREAD_PRIO_INHERIT, PTHREAD_MUTEX_STALLED);
  in_child([] {
    for (Mutex* const mutex : {&errors, &inherits}) {
      // Contended, so that the kernel takes part.
      int count = 0;
      const auto work = [&count, mutex] {
        for (int i = 0; i < 20000; ++i) {
          CHECK(::pthread_mutex_lock(&mutex->mutex) == 0);
          ++count;
          CHECK(::pthread_mutex_unlock(&mutex->mutex) == 0);
        }
      };
      std::thread other(work);
      work();
      other.join();
      CHECK(count == 40000);
    }
    CHECK(::pthread_mutex_lock(&errors.mutex) == 0);
    CHECK(::pthread_mutex_lock(&errors.mutex) == EDEADLK);
    CHECK(::pthread_mutex_unlock(&errors.mutex) == 0);
  });
}

/// A robust mutex reports that its owner died.
void test_robust_mutex() {
  static Mutex robust(PTHREAD_MUTEX_NORMAL, PTHREAD_PRIO_NONE, PTHREAD_MUTEX_ROBUST);
  Outcome outcome;
  run(outcome, [](Program&) {
    CHECK(::pthread_mutex_lock(&robust.mutex) == 0);
    ::kill(::getpid(), SIGKILL);
    return 0;
  });
  CHECK(outcome.end.signal == SIGKILL);
  CHECK(::pthread_mutex_lock(&robust.mutex) == EOWNERDEAD);
  CHECK(::pthread_mutex_consistent(&robust.mutex) == 0);
  CHECK(::pthread_mutex_unlock(&robust.mutex) == 0);
}

void cancel_from_another_thread() {
  const pthread_t first = ::pthread_self();
  std::thread([first] { ::pthread_cancel(first); }).detach();
  while (true) {
    ::pause();
  }
}

/// A library that finds the C library's pthread_cancel() first reaches the thread, which must not
/// unwind into the donor's frames.
void test_cancel_past_the_guard() {
  const auto cancel = reinterpret_cast<int (*)(pthread_t)>(::dlsym(RTLD_NEXT, "pthread_cancel"));
  Outcome outcome;
  run(outcome, [cancel](Program&) {
    const pthread_t first = ::pthread_self();
    CHECK(cancel != nullptr && cancel(first) == 0);
    ::pthread_testcancel();
    return 0;
  });
  CHECK(outcome.end.clean());
}

void test_exits() {
  static bool handler_ran = false;
  std::atexit([] { handler_ran = true; });
  struct Way {
    void (*leave)();
    int status;
    const char* noted;
  };
  const std::array ways{
      Way{[] { std::exit(3); }, 3, "exit()"},
      Way{[] { std::quick_exit(4); }, 4, "quick_exit()"},
      Way{[] { std::_Exit(5); }, 5, nullptr},
      Way{[] { std::thread([] { std::exit(6); }).join(); }, 6, "exit()"},
      Way{[] { ::pthread_exit(nullptr); }, 0, "pthread_exit()"},
      Way{[] { ::pthread_cancel(::pthread_self()); }, 0, "pthread_cancel()"},
      Way{cancel_from_another_thread, 0, "pthread_cancel()"},
  };
  for (const Way& way : ways) {
    Outcome outcome;
    run(outcome, [&way](Program&) {
      way.leave();
      return 1;
    });
    CHECK(outcome.end.signal == 0 && outcome.end.exit_code == way.status);
    CHECK(!outcome.end.returned && !outcome.end.clean());
    CHECK((outcome.slot.report.end_call != nullptr) == (way.noted != nullptr));
    CHECK(way.noted == nullptr || outcome.slot.report.exit_status == way.status);
    CHECK(way.noted == nullptr || contains(outcome.text(), way.noted));
    CHECK(contains(outcome.text(), "exit status " + std::to_string(way.status)));
  }
  CHECK(!handler_ran);
  Outcome outcome;
  run(outcome, [](Program&) { return 7; });
  CHECK(outcome.end.exit_code == 7 && outcome.end.returned);
  in_child([] { std::thread([] { ::pthread_exit(nullptr); }).join(); });
}

void test_processes_of_a_child() {
  in_child([] {
    int status = -1;
    CHECK(::waitpid(-1, &status, 0) == -1 && errno == ECHILD);
    CHECK(std::system("exit 3") == 3 << 8);
    const pid_t forked = ::fork();
    if (forked == 0) {
      ::_exit(current_child() == nullptr ? 4 : 5);
    }
    CHECK(::waitpid(-1, &status, 0) == forked && WEXITSTATUS(status) == 4);
    const pid_t crashing = ::fork();
    if (crashing == 0) {
      ::raise(SIGSEGV);
      ::_exit(0);
    }
    CHECK(::waitpid(crashing, &status, 0) == crashing && WTERMSIG(status) == SIGSEGV);
  });
  // The container does not have the children that it did not make.
  int status = -1;
  CHECK(::waitpid(-1, &status, WNOHANG) == -1 && errno == ECHILD);
}

sigjmp_buf behind_fault;

void test_own_signal_handler() {
  in_child([] {
    ::signal(SIGSEGV, [](int) { ::siglongjmp(behind_fault, 1); });
    if (::sigsetjmp(behind_fault, 1) == 0) {
      *reinterpret_cast<volatile int*>(::getpid() & 0) = 1;
      CHECK(!"faulted");
    }
  });
}

std::atomic<int> containers_signals{0};

void test_signal_actions_and_mask() {
  ::signal(SIGINT, [](int) { ++containers_signals; });
  ::signal(SIGWINCH, [](int) { ++containers_signals; });
  ::signal(SIGPIPE, [](int) {});
  sigset_t blocked;
  sigemptyset(&blocked);
  sigaddset(&blocked, SIGWINCH);
  ::pthread_sigmask(SIG_BLOCK, &blocked, nullptr);  // donors inherit it
  in_child([] {
    sigset_t mask;
    ::pthread_sigmask(SIG_SETMASK, nullptr, &mask);
    for (int signal = 1; signal < SIGRTMAX; ++signal) {
      CHECK(::sigismember(&mask, signal) != 1);
    }
    struct sigaction action{};
    ::sigaction(SIGWINCH, nullptr, &action);
    CHECK(action.sa_handler == SIG_DFL);
    CHECK(::raise(SIGPIPE) == 0);
  });
  Outcome outcome;
  run(outcome, [](Program& program) {
    ::kill(::getpid(), SIGINT);
    CHECK(program.cancelled);
    return 0;
  });
  CHECK(outcome.end.signal == SIGINT && outcome.end.returned);
  CHECK(containers_signals == 0);
  ::pthread_sigmask(SIG_UNBLOCK, &blocked, nullptr);
  ::signal(SIGINT, SIG_DFL);
}

/// An uncaught exception is reported each time, though all children share the C++ library's memory.
void test_exception_text() {
  for (const char* const text : {"first", "second"}) {
    Outcome outcome;
    run(outcome, [text](Program&) -> int { throw std::logic_error(text); });
    CHECK(contains(outcome.text(), std::string("std::logic_error: ") + text));
  }
  Outcome outcome;
  run(outcome, [](Program&) -> int { throw 3; });
  CHECK(contains(outcome.text(), "uncaught exception int"));
}

}  // namespace

int main() {
  prepare_crash_handling();
  test_libraries();
  test_locale_stays_in_the_child();
  test_thread_is_the_process();
  test_mutexes();
  test_robust_mutex();
  test_exits();
  test_cancel_past_the_guard();
  test_processes_of_a_child();
  test_own_signal_handler();
  test_signal_actions_and_mask();
  test_exception_text();
  try {
    throw std::runtime_error("in the container, after all that");
  } catch (const std::exception&) {
  }
  return 0;
}
