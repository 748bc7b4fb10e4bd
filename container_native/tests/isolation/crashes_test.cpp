// Every way to die, again and again, beside children that go on: each death ends that child alone,
// is told at once and with its place, and leaves a donor on which C++ works.

#include <signal.h>
#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <thread>
#include <vector>

#include "harness.hpp"

namespace {

using namespace isolation_test;

constexpr int kRounds = 200;

std::atomic<std::uint64_t> kill_time_ns{0};

volatile std::uintptr_t bad_address = 8;
void crash_by_bad_address() { *reinterpret_cast<volatile int*>(bad_address) = 1; }
void crash_by_abort() { std::abort(); }
void crash_by_exception() { throw std::runtime_error("what went wrong"); }
void crash_by_kill() {
  kill_time_ns = now_ns();
  ::kill(::getpid(), SIGKILL);
}
void crash_by_truncated_file() {
  const int file = ::memfd_create("empty", MFD_CLOEXEC);
  void* const page = ::mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  ::close(file);
  *static_cast<volatile char*>(page) = 1;
}
void crash_by_division() {
#if defined(__x86_64__)
  volatile int zero = 0;
  volatile int one = 1;  // the compiler divides a constant 1 without dividing
  volatile int result = one / zero;
  static_cast<void>(result);
#else
  ::raise(SIGFPE);
#endif
}
void crash_by_illegal_instruction() {
#if defined(__x86_64__)
  asm volatile("ud2");
#else
  asm volatile("udf #0");
#endif
}
int crash_by_recursion(int depth) {
  volatile char frame[512] = {};
  frame[0] = static_cast<char>(depth);
  return depth < 0 ? 0 : crash_by_recursion(depth + 1) + frame[0];
}
void crash_by_stack_overflow() { std::exit(crash_by_recursion(0)); }
void crash_by_terminate() { std::terminate(); }

struct Kind {
  const char* name;
  void (*crash)();
  int signal;
  const char* function;  // in the backtrace; null: no signal handler can catch this
  const char* reason;
};

constexpr std::array kKinds{
    Kind{"SIGSEGV", crash_by_bad_address, SIGSEGV, "crash_by_bad_address", "address 0x8"},
    Kind{"SIGABRT", crash_by_abort, SIGABRT, "crash_by_abort", "abort() was called"},
    Kind{"exception", crash_by_exception, SIGABRT, "crash_by_exception",
         "uncaught exception std::runtime_error: what went wrong"},
    Kind{"SIGKILL", crash_by_kill, SIGKILL, nullptr, "SIGKILL"},
    Kind{"SIGBUS", crash_by_truncated_file, SIGBUS, "crash_by_truncated_file",
         "nothing behind the mapping"},
    Kind{"SIGFPE", crash_by_division, SIGFPE, "crash_by_division", "SIGFPE"},
    Kind{"SIGILL", crash_by_illegal_instruction, SIGILL, "crash_by_illegal_instruction",
         "illegal instruction"},
    Kind{"stack overflow", crash_by_stack_overflow, SIGSEGV, "crash_by_recursion", "SIGSEGV"},
    Kind{"terminate", crash_by_terminate, SIGABRT, "crash_by_terminate", "abort() was called"},
};

/// Lives and ticks until told to stop.
class Neighbour {
 public:
  Neighbour()
      : program_([this](Program& program) {
          while (!program.cancelled) {
            std::make_unique<std::vector<int>>(1000)->at(5) = 1;
            ++ticks;
            std::this_thread::yield();
          }
          return 0;
        }),
        donor_("neighbour", [this] { end_ = run_in_child(program_, slot_); }) {}

  void stop() {
    program_.cancelled = true;
    donor_.join();
    CHECK(end_.clean());
  }

  std::atomic<std::uint64_t> ticks{0};

 private:
  Program program_;
  CrashSlot slot_;
  ChildEnd end_;
  DonorThread donor_;
};

double milliseconds(std::uint64_t ns) { return static_cast<double>(ns) / 1e6; }

void check_outcome(const Kind& kind, const Outcome& outcome, bool in_main_thread) {
  if (outcome.end.signal != kind.signal) {
    std::fprintf(stderr, "%s: %s\n%s", kind.name, outcome.text().c_str(),
                 joined(outcome.slot).c_str());
  }
  CHECK(outcome.end.error == 0);
  CHECK(outcome.end.signal == kind.signal);
  CHECK(!outcome.end.returned);
  CHECK(outcome.slot.pid == outcome.end.pid);
  CHECK(outcome.slot.start_time != 0);
  CHECK(contains(outcome.text(), kind.reason));
  if (kind.function == nullptr) {
    CHECK(outcome.slot.thread == 0);
    return;
  }
  CHECK((outcome.slot.thread == outcome.end.pid) == in_main_thread);
  const std::string backtrace = joined(outcome.slot);
  if (!contains(backtrace, kind.function)) {
    std::fprintf(stderr, "%s\n", backtrace.c_str());
  }
  CHECK(contains(backtrace, kind.function));
}

void test_crashes(const Kind& kind, std::vector<std::unique_ptr<Neighbour>>& neighbours) {
  std::vector<std::uint64_t> detection;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<std::uint64_t> before;
    for (const auto& neighbour : neighbours) {
      before.push_back(neighbour->ticks);
    }
    Outcome outcome;
    std::atomic<bool> usable{false};
    Program crashing([&kind](Program&) {
      kind.crash();
      return 0;
    });
    Program throwing([&usable](Program&) {
      try {
        throw std::runtime_error("caught");
      } catch (const std::exception& error) {
        usable = std::strcmp(error.what(), "caught") == 0 && std::uncaught_exceptions() == 0;
      }
      usable = usable && !std::current_exception();
      return 0;
    });
    CrashSlot second_slot;
    ChildEnd second;
    {
      DonorThread donor("donor", [&] {
        outcome.end = run_in_child(crashing, outcome.slot);
        outcome.awake_ns = now_ns();
        second = run_in_child(throwing, second_slot);
      });
    }
    const std::uint64_t death =
        kind.function != nullptr ? outcome.slot.crash_time_ns : kill_time_ns.load();
    detection.push_back(outcome.awake_ns - death);
    check_outcome(kind, outcome, true);
    CHECK(second.clean());
    CHECK(usable);
    for (std::size_t i = 0; i < neighbours.size(); ++i) {
      while (neighbours[i]->ticks == before[i]) {
        std::this_thread::yield();
      }
    }
  }
  std::sort(detection.begin(), detection.end());
  std::printf("%-15s %d deaths, crash to donor awake and child reaped: p50 %.3f ms, p99 %.3f ms\n",
              kind.name, kRounds, milliseconds(detection[kRounds / 2]),
              milliseconds(detection[kRounds * 99 / 100]));
  std::fflush(stdout);
}

/// The same in a thread that the child started.
void test_crashes_in_second_thread() {
  for (const Kind& kind : kKinds) {
    Outcome outcome;
    run(outcome, [&kind](Program&) {
      std::thread(kind.crash).join();
      return 0;
    });
    check_outcome(kind, outcome, false);
  }
}

}  // namespace

int main() {
  prepare_crash_handling();
  std::vector<std::unique_ptr<Neighbour>> neighbours;
  for (int i = 0; i < 3; ++i) {
    neighbours.push_back(std::make_unique<Neighbour>());
  }
  for (const Kind& kind : kKinds) {
    test_crashes(kind, neighbours);
  }
  test_crashes_in_second_thread();
  for (const auto& neighbour : neighbours) {
    neighbour->stop();
  }
  return 0;
}
