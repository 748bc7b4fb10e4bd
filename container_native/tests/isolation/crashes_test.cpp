// Every way to die, again and again, beside children that go on: each death ends that child alone,
// is reported with its place, and leaves a donor on which C++ works.

#include <dlfcn.h>
#include <link.h>
#include <signal.h>
#include <sys/mman.h>

#include <array>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

#include "harness.hpp"

extern "C" [[noreturn]] void __stack_chk_fail();
extern "C" void crash_by_lost_stack();
extern "C" void crash_by_damaged_frame();
extern "C" void crash_by_damaged_unwind_data();

// The stack pointer is gone; what finds the frame is gone; the table for finding it is damaged,
// which makes the unwinder call abort().
#if defined(__x86_64__)
asm(R"(
    .text
    .globl crash_by_lost_stack
    .type crash_by_lost_stack, @function
crash_by_lost_stack:
    .cfi_startproc
    mov $0x100, %esp
    push %rax
    .cfi_endproc
    .size crash_by_lost_stack, . - crash_by_lost_stack

    .globl crash_by_damaged_frame
    .type crash_by_damaged_frame, @function
crash_by_damaged_frame:
    .cfi_startproc
    push %rbp
    mov %rsp, %rbp
    .cfi_def_cfa rbp, 16
    movabs $0x4141414141414141, %rbp
    xor %eax, %eax
    movl $0, 8(%rax)
    .cfi_endproc
    .size crash_by_damaged_frame, . - crash_by_damaged_frame

    .globl crash_by_damaged_unwind_data
    .type crash_by_damaged_unwind_data, @function
crash_by_damaged_unwind_data:
    .cfi_startproc
    .cfi_escape 0x0f, 1, 0xff
    xor %eax, %eax
    movl $0, 8(%rax)
    .cfi_endproc
    .size crash_by_damaged_unwind_data, . - crash_by_damaged_unwind_data
)");
#else
asm(R"(
    .text
    .globl crash_by_lost_stack
    .type crash_by_lost_stack, @function
crash_by_lost_stack:
    .cfi_startproc
    mov x0, #0x100
    mov sp, x0
    str x0, [sp, #-16]!
    .cfi_endproc
    .size crash_by_lost_stack, . - crash_by_lost_stack

    .globl crash_by_damaged_frame
    .type crash_by_damaged_frame, @function
crash_by_damaged_frame:
    .cfi_startproc
    .cfi_def_cfa x29, 16
    .cfi_offset x30, -8
    movz x29, #0x4141, lsl #48
    mov x0, #8
    str w0, [x0]
    .cfi_endproc
    .size crash_by_damaged_frame, . - crash_by_damaged_frame

    .globl crash_by_damaged_unwind_data
    .type crash_by_damaged_unwind_data, @function
crash_by_damaged_unwind_data:
    .cfi_startproc
    .cfi_escape 0x0f, 1, 0xff
    mov x0, #8
    str w0, [x0]
    .cfi_endproc
    .size crash_by_damaged_unwind_data, . - crash_by_damaged_unwind_data
)");
#endif

namespace {

using namespace isolation_test;

constexpr int kRounds = 10;

volatile std::uintptr_t bad_address = 8;
void crash_by_bad_address() { *reinterpret_cast<volatile int*>(bad_address) = 1; }
void crash_by_abort() { std::abort(); }
void crash_by_exception() { throw std::runtime_error("what went wrong"); }
/// It is uncaught, so no frame is left, though some have something to destroy or catch
/// something else.
[[gnu::noinline]] void throw_through(const std::string& text) {
  const std::string longer = text + "wrong";
  throw std::runtime_error(longer);
}
void crash_by_exception_below() {
  try {
    throw_through("what went ");
  } catch (const std::logic_error&) {
    std::abort();
  }
}
void crash_by_exception_thrown_on() {
  try {
    throw_through("what went ");
  } catch (const std::runtime_error&) {
    throw;
  }
}
void crash_by_kill() { ::kill(::getpid(), SIGKILL); }
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

void call(std::uintptr_t address) { reinterpret_cast<void (*)()>(address)(); }
volatile std::uintptr_t low_address = 0x10;
void crash_by_call_to_low_address() { call(low_address); }
volatile std::uintptr_t high_address = 0x4141414141;
void crash_by_call_to_high_address() { call(high_address); }
alignas(64) std::array<char, 64> no_code{};
void crash_by_call_to_data() { call(reinterpret_cast<std::uintptr_t>(no_code.data())); }
void crash_by_smashed_frame() {
  // Its caller's frame pointer and its return address.
  auto* const frame = static_cast<volatile std::uintptr_t*>(__builtin_frame_address(0));
  frame[0] = 0x4141414141414141;
  frame[1] = 0x4141414141414141;
  __stack_chk_fail();
}
void crash_by_trap() {
#if defined(__x86_64__)
  asm volatile("int3");
#else
  asm volatile("brk #1000");
#endif
}
void crash_by_forbidden_system_call() { ::raise(SIGSYS); }

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
    Kind{"deep exception", crash_by_exception_below, SIGABRT,
         "#0 (anonymous namespace)::throw_through",
         "uncaught exception std::runtime_error: what went wrong"},
    Kind{"thrown on", crash_by_exception_thrown_on, SIGABRT,
         "#0 (anonymous namespace)::crash_by_exception_thrown_on",
         "uncaught exception std::runtime_error: what went wrong"},
    Kind{"SIGKILL", crash_by_kill, SIGKILL, nullptr, "SIGKILL"},
    Kind{"SIGBUS", crash_by_truncated_file, SIGBUS, "crash_by_truncated_file",
         "nothing behind the mapping"},
    Kind{"SIGFPE", crash_by_division, SIGFPE, "crash_by_division", "SIGFPE"},
    Kind{"SIGILL", crash_by_illegal_instruction, SIGILL, "crash_by_illegal_instruction",
         "illegal instruction"},
    Kind{"stack overflow", crash_by_stack_overflow, SIGSEGV, "crash_by_recursion", "SIGSEGV"},
    Kind{"terminate", crash_by_terminate, SIGABRT, "crash_by_terminate", "abort() was called"},
    Kind{"SIGTRAP", crash_by_trap, SIGTRAP, "crash_by_trap", "breakpoint"},
    Kind{"SIGSYS", crash_by_forbidden_system_call, SIGSYS, "crash_by_forbidden_system_call",
         "SIGSYS"},
    Kind{"low call", crash_by_call_to_low_address, SIGSEGV, "crash_by_call_to_low_address",
         "jump to address 0x10, where no code is"},
    Kind{"high call", crash_by_call_to_high_address, SIGSEGV, "crash_by_call_to_high_address",
         "jump to address 0x4141414141, where no code is"},
    Kind{"data call", crash_by_call_to_data, SIGSEGV, "crash_by_call_to_data", "where no code is"},
    Kind{"smashed frame", crash_by_smashed_frame, SIGABRT, "crash_by_smashed_frame",
         "abort() was called"},
    Kind{"lost stack", crash_by_lost_stack, SIGSEGV, "#0 crash_by_lost_stack", "address 0xf"},
    Kind{"damaged frame", crash_by_damaged_frame, SIGSEGV, "#0 crash_by_damaged_frame",
         "address 0x8"},
    Kind{"damaged unwind data", crash_by_damaged_unwind_data, SIGSEGV,
         "#0 crash_by_damaged_unwind_data", "address 0x8"},
};

/// Lives and ticks until asked to stop.
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

/// Each module is one of the backtrace; that of this program has its path and its build id.
void check_modules(const CrashSlot& slot) {
  const std::string backtrace = joined(slot);
  bool is_there = false;
  for (const std::string& module : modules_of(slot)) {
    const std::size_t id = module.find(' ') + 1;
    const std::size_t path = module.find(' ', id) + 1;
    CHECK(contains(backtrace, module.substr(0, id - 1) + "+0x"));
    CHECK(module.substr(module.rfind('/') + 1) == module.substr(0, id - 1));
    const std::string build = module.substr(id, path - 1 - id);
    CHECK(build == "-" || (build.size() % 2 == 0 &&
                           build.find_first_not_of("0123456789abcdef") == std::string::npos));
    is_there = is_there || (contains(module, "crashes_test") && build.size() >= 16);
  }
  CHECK(is_there || !contains(backtrace, "crashes_test+0x"));
}

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
  CHECK(outcome.slot.phase == ChildPhase::dying);
  CHECK(outcome.slot.report.threads_not_parked == 0);
  CHECK(!outcome.slot.report.inside);
  const std::string backtrace = joined(outcome.slot);
  if (!contains(backtrace, kind.function)) {
    std::fprintf(stderr, "%s\n", backtrace.c_str());
  }
  CHECK(contains(backtrace, kind.function));
  check_modules(outcome.slot);
}

void test_crashes(const Kind& kind, std::vector<std::unique_ptr<Neighbour>>& neighbours) {
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
        second = run_in_child(throwing, second_slot);
      });
    }
    check_outcome(kind, outcome, true);
    CHECK(second.clean());
    CHECK(usable);
    for (std::size_t i = 0; i < neighbours.size(); ++i) {
      while (neighbours[i]->ticks == before[i]) {
        std::this_thread::yield();
      }
    }
  }
}

/// What the container's code does in the handlers must not stand in the way.
void test_program_that_faults_in_handlers() {
  class Damaged final : public ChildProgram {
   public:
    int run() override { std::abort(); }
    void cancel() noexcept override { crash_by_bad_address(); }
    void crashed() noexcept override { std::abort(); }
  };
  Damaged program;
  Outcome outcome;
  DonorThread donor("donor", [&] { outcome.end = run_in_child(program, outcome.slot); });
  donor.join();
  CHECK(outcome.end.signal == SIGABRT);
  CHECK(outcome.slot.report.signal == SIGABRT && outcome.slot.phase == ChildPhase::dying);
  CHECK(contains(joined(outcome.slot), "Damaged::run"));
}

/// In the handler it waits for what never comes, such as a lock that a killed thread holds.
void test_handler_that_does_not_end() {
  class Stuck final : public ChildProgram {
   public:
    int run() override { std::abort(); }
    void cancel() noexcept override {}
    void crashed() noexcept override {
      while (true) {
        ::pause();
      }
    }
  };
  Stuck program;
  Outcome outcome;
  run(outcome, program);
  CHECK(outcome.end.signal == SIGKILL && outcome.slot.phase == ChildPhase::crashed);
  CHECK(contains(outcome.text(), "SIGABRT (abort() was called) in thread 'node', whose handler"));
  CHECK(contains(joined(outcome.slot), "Stuck::run"));
}

void crash_unlike_the_others() { *reinterpret_cast<volatile int*>(bad_address) = 1; }

/// The loader's records of a library are memory that every node can overwrite.
void test_library_with_damaged_records() {
  Outcome outcome;
  run(outcome, [](Program&) {
    crash_unlike_the_others();
    return 0;
  });
  auto* const program = static_cast<link_map*>(::dlopen(nullptr, RTLD_LAZY));
  std::array<ElfW(Dyn), 2> damaged{};
  damaged[0].d_tag = DT_GNU_HASH;
  damaged[0].d_un.d_ptr = 0x4141414141414141;
  ElfW(Dyn)* const sound = std::exchange(program->l_ld, damaged.data());
  const std::string backtrace = joined(outcome.slot);
  const std::vector<std::string> modules = modules_of(outcome.slot);
  program->l_ld = sound;
  CHECK(contains(backtrace, "isolation_crashes_test+0x"));
  CHECK(!modules.empty());
  CHECK(contains(joined(outcome.slot), "#0 (anonymous namespace)::crash_unlike_the_others"));
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
  test_program_that_faults_in_handlers();
  test_handler_that_does_not_end();
  test_library_with_damaged_records();
  for (const auto& neighbour : neighbours) {
    neighbour->stop();
  }
  return 0;
}
