// What a child's first thread leaves behind is destroyed in the child, and never in the container.

#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <string>
#include <thread>

#include "harness.hpp"
#include "residue.hpp"

namespace {

using namespace isolation_test;
using namespace std::chrono_literals;

const pid_t container = ::getpid();
std::atomic<int> told_in_children{0};

/// The container would die here, as it might of a destructor.
void report() {
  CHECK(::getpid() != container);
  ++told_in_children;
}

using Leave = void (*)(Deed, Report);

struct Library {
  Library(const std::string& name, int flags) {
    handle = ::dlopen(name.c_str(), RTLD_NOW | flags);
    CHECK(handle != nullptr);
    object = reinterpret_cast<Leave>(::dlsym(handle, "leave_object"));
    value = reinterpret_cast<Leave>(::dlsym(handle, "leave_value"));
    CHECK(object != nullptr && value != nullptr);
  }

  void* handle = nullptr;
  Leave object = nullptr;
  Leave value = nullptr;
  bool brings_cpp = false;
};

constexpr const char* kLibrary = RESIDUE;
/// With a C++ library of its own inside.
constexpr const char* kStaticLibrary = RESIDUE_STATIC;

/// A child that leaves these behind; how it ends, and how many destructors ran.
int end_with(Outcome& outcome, std::function<void()> body) {
  told_in_children = 0;
  ChildOptions options;
  options.leave_limit = 200ms;
  run(
      outcome,
      [&](Program&) {
        body();
        return 0;
      },
      options);
  return told_in_children;
}

void check_orderly(int destructors, std::function<void()> body) {
  Outcome outcome;
  CHECK(end_with(outcome, std::move(body)) == destructors);
  CHECK(outcome.end.clean());
}

void check_death(int signal, const char* text, std::function<void()> body) {
  Outcome outcome;
  CHECK(end_with(outcome, std::move(body)) == 1);
  CHECK(outcome.end.signal == signal && !outcome.end.returned);
  CHECK(contains(outcome.text(), text));
  CHECK(contains(outcome.text(), "while its thread-local objects were being destroyed"));
}

void test_orderly_ends(const Library& library) {
  check_orderly(1, [&] { library.object(Deed::nothing, report); });
  check_orderly(1, [&] { library.value(Deed::nothing, report); });
  check_orderly(2, [&] {
    library.object(Deed::nothing, report);
    library.value(Deed::nothing, report);
  });
  check_orderly(2, [&] { library.object(Deed::another, report); });
  check_orderly(PTHREAD_DESTRUCTOR_ITERATIONS, [&] { library.value(Deed::another, report); });
  check_orderly(2, [&] {
    std::thread([&] {
      library.object(Deed::nothing, report);
      library.value(Deed::nothing, report);
    }).join();
  });
}

void test_deaths(const Library& library) {
  for (const Leave leave : {library.object, library.value}) {
    check_death(SIGSEGV, "no memory at address 0x8", [=] { leave(Deed::fault, report); });
    // What was thrown by a C++ library inside of a library, only that one knows.
    const char* const text = library.brings_cpp ? "abort() was called" : "from a destructor";
    check_death(SIGABRT, text, [=] { leave(Deed::raise, report); });
    check_death(SIGTERM, "did not end in time", [=] { leave(Deed::loop, report); });
  }
}

/// It stays in memory as long as its destructors have to run.
void test_closed_library() {
  check_orderly(1, [] {
    const Library library(kLibrary, 0);
    library.object(Deed::nothing, report);
    CHECK(::dlclose(library.handle) == 0);
  });
}

/// What a child that died left may be half changed.
void test_nothing_after_a_death(const Library& library) {
  told_in_children = 0;
  Outcome outcome;
  Program dying([&](Program&) -> int {
    library.object(Deed::nothing, report);
    library.value(Deed::nothing, report);
    std::abort();
  });
  Program cleaning([](Program&) { return 0; });
  ChildEnd cleaned;
  CrashSlot slot;
  {
    DonorThread donor("donor", [&] {
      outcome.end = run_in_child(dying, outcome.slot);
      cleaned = run_in_child(cleaning, slot);
    });
  }
  CHECK(outcome.end.signal == SIGABRT && cleaned.clean());
  CHECK(told_in_children == 0);
}

/// A child that was asked to leave still does it, and dies of the signal then.
void test_after_a_request(const Library& library) {
  Outcome outcome;
  CHECK(end_with(outcome, [&] {
          library.object(Deed::nothing, report);
          ::raise(SIGTERM);
        }) == 1);
  CHECK(outcome.end.signal == SIGTERM && outcome.end.returned);
}

/// It cannot be kept from ending by handlers of its own.
void test_a_loop_that_ignores_the_request(const Library& library) {
  Outcome outcome;
  CHECK(end_with(outcome, [&] {
          ::signal(SIGTERM, SIG_IGN);
          library.object(Deed::loop, report);
        }) == 1);
  CHECK(outcome.end.signal == SIGKILL);
}

}  // namespace

int main() {
  const rlimit no_cores{0, 0};
  ::setrlimit(RLIMIT_CORE, &no_cores);
  prepare_crash_handling();
  test_closed_library();
  for (const std::string& name : {std::string(kLibrary), std::string(kStaticLibrary)}) {
    for (const int flags : {0, RTLD_DEEPBIND}) {
      Library library(name, flags);
      library.brings_cpp = name == kStaticLibrary;
      test_orderly_ends(library);
      test_deaths(library);
    }
  }
  const Library library(kLibrary, 0);
  test_nothing_after_a_death(library);
  test_after_a_request(library);
  test_a_loop_that_ignores_the_request(library);
  return 0;
}
