#include "isolation/clone/vm_clone.hpp"

#include <linux/sched.h>
#include <pthread.h>
#include <signal.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>

#include "base/scheduling.hpp"
#include "isolation/clone/donor_state.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

// By clone() and not by clone3(), which container runtimes' filters often forbid, but for a child
// that is born in another control group, which clone() cannot do.
//
// No signal at its death: its parent waits already, and it is out of reach
// for a wait() that some library in the container calls for any child. No CLONE_FS: a node's
// working directory and umask are its own.
constexpr unsigned long kFlags = CLONE_VM | CLONE_FILES;

thread_local bool tainted = false;

struct Start {
  CloneEntry entry;
  void* argument;
  const DonorState& donor;
  bool returned = false;
};

int start_child(void* argument) {
  auto& start = *static_cast<Start*>(argument);
  start.donor.adopt();
  const int status = start.entry(start.argument);
  start.returned = true;
  if (status < 0) {
    die_of(-status);
  }
  return status;
}

/// The process's pid once it has ended, or a negative errno.
long make_process(Start& start, Birth* birth) noexcept {
  if (birth != nullptr && birth->group >= 0) {
    clone_args arguments{};
    arguments.flags = kFlags | CLONE_INTO_CGROUP;
    arguments.cgroup = static_cast<std::uint64_t>(birth->group);
    birth->in_group = true;
    const long pid =
        play_launch_clone_on_own_stack(SYS_clone3, reinterpret_cast<unsigned long>(&arguments),
                                       sizeof arguments, start_child, &start);
    if (pid > 0) {
      return pid;
    }
    birth->in_group = false;
  }
  return play_launch_clone_on_own_stack(SYS_clone, kFlags, 0, start_child, &start);
}

/// Once per address space, the C library installs the handler by which pthread_cancel() works. A
/// process that comes later and never got it dies of that signal.
void install_cancel_handler() {
  pthread_t thread{};
  // With cancellation off, nothing is sent: it ends also where no signal can be queued (ulimit -i).
  const auto cancel_itself = [](void*) -> void* {
    ::pthread_setcancelstate(PTHREAD_CANCEL_DISABLE, nullptr);
    ::pthread_cancel(::pthread_self());
    return nullptr;
  };
  if (::pthread_create(&thread, nullptr, cancel_itself, nullptr) == 0) {
    ::pthread_join(thread, nullptr);
  }
}

}  // namespace

ChildEnd clone_and_wait(CloneEntry entry, void* argument, void (*before_reaping)(void*),
                        Birth* birth) noexcept {
  const DonorState donor;
  Start start{entry, argument, donor};
  ChildEnd end;
  const long pid = make_process(start, birth);
  if (pid < 0) {
    end.error = static_cast<int>(-pid);
    return end;
  }
  end.pid = static_cast<pid_t>(pid);
  if (before_reaping != nullptr) {
    before_reaping(argument);
  }
  siginfo_t info{};
  const NotRealTime reaping;
  while (::waitid(P_PID, static_cast<id_t>(end.pid), &info, WEXITED | __WALL) != 0) {
    if (errno != EINTR) {
      end.error = errno;
      break;
    }
  }
  end.returned = start.returned;
  tainted = tainted || !end.returned;
  if (info.si_code == CLD_EXITED) {
    end.exit_code = info.si_status;
  } else {
    end.signal = info.si_status;
    end.dumped_core = info.si_code == CLD_DUMPED;
  }
  return end;
}

bool donor_is_tainted() noexcept { return tainted; }

const char* prepare_clone() {
  static const char* const obstacle = [] {
    install_cancel_handler();
    return DonorState::prepare();
  }();
  return obstacle;
}

}  // namespace play_launch::isolation

// The system calls clone and clone3 with a new process that goes on on its parent's stack. They
// cannot be made through a function that returns: the child would return into its parent's frames.
//
// CLONE_VFORK would keep the parent away from the stack as well, but in a sleep that nothing
// interrupts: it counts into the load average, and neither debuggers nor a stop (Ctrl-Z) get to the
// thread. So the parent waits in registers only. waitid() gives 0 when the child is dead
// with all its threads, and ECHILD when it was reaped elsewhere. Whatever else it gives, the
// child may live, and the parent must not go on.

// What stands in the code below as a number.
static_assert((WEXITED | WNOWAIT | __WALL) == 0x41000004 && P_PID == 1 && EINTR == 4 &&
              ECHILD == 10);

// The child begins below the return address that the parent will need when it goes on. Its frames
// have no caller: debuggers and the search for an exception's handler end there.
#if defined(__x86_64__)
static_assert(SYS_waitid == 247 && SYS_sched_yield == 24 && SYS_exit_group == 231);
asm(R"(
    .text
    .p2align 4
    .hidden play_launch_clone_on_own_stack
    .globl play_launch_clone_on_own_stack
    .type play_launch_clone_on_own_stack, @function
play_launch_clone_on_own_stack:
    .cfi_startproc
    endbr64
    mov %rdi, %rax          # number
    mov %rsi, %rdi
    mov %rdx, %rsi          # of clone: the child's stack, which is this one
    mov %rcx, %r9           # entry; a system call changes rax, rcx and r11 only
    xor %edx, %edx          # argument is in r8, where a child's TLS would be, but for the flag
    xor %r10d, %r10d
    syscall
    test %rax, %rax
    jz 5f
    js 4f
    mov %rax, %r9           # pid
1:
    mov $1, %edi            # P_PID
    mov %r9, %rsi
    xor %edx, %edx          # no siginfo
    mov $0x41000004, %r10d  # WEXITED | WNOWAIT | __WALL
    xor %r8d, %r8d          # no rusage
    mov $247, %eax          # waitid
    syscall
    test %rax, %rax
    jz 3f
    cmp $-10, %rax          # ECHILD
    je 3f
    cmp $-4, %rax           # EINTR
    je 1b
    mov $24, %eax           # sched_yield
    syscall
    jmp 1b
3:
    mov %r9, %rax
4:
    ret
    .cfi_endproc
5:
    .cfi_startproc
    .cfi_undefined rip
    xor %ebp, %ebp
    and $-16, %rsp
    mov %r8, %rdi
    call *%r9
    mov %eax, %edi
    mov $231, %eax          # exit_group
    syscall
    hlt
    .cfi_endproc
    .size play_launch_clone_on_own_stack, . - play_launch_clone_on_own_stack
)");
#elif defined(__aarch64__)
static_assert(SYS_waitid == 95 && SYS_sched_yield == 124 && SYS_exit_group == 94);
asm(R"(
    .text
    .p2align 4
    .hidden play_launch_clone_on_own_stack
    .globl play_launch_clone_on_own_stack
    .type play_launch_clone_on_own_stack, %function
play_launch_clone_on_own_stack:
    .cfi_startproc
    hint #34                // bti c
    mov x8, x0              // number
    mov x9, x3              // entry; a system call changes x0 only
    mov x10, x4             // argument
    mov x0, x1
    mov x1, x2              // of clone: the child's stack, which is this one
    mov x2, xzr
    mov x3, xzr
    mov x4, xzr
    svc #0
    cbz x0, 5f
    tbnz x0, #63, 4f
    mov x9, x0              // pid; x30 still has the return address
1:
    mov x0, #1              // P_PID
    mov x1, x9
    mov x2, xzr             // no siginfo
    movz x3, #0x0004        // WEXITED | WNOWAIT | __WALL
    movk x3, #0x4100, lsl #16
    mov x4, xzr             // no rusage
    mov x8, #95             // waitid
    svc #0
    cbz x0, 3f
    cmn x0, #10             // ECHILD
    b.eq 3f
    cmn x0, #4              // EINTR
    b.eq 1b
    mov x8, #124            // sched_yield
    svc #0
    b 1b
3:
    mov x0, x9
4:
    ret
    .cfi_endproc
5:
    .cfi_startproc
    .cfi_undefined x30
    mov x29, xzr
    mov x30, xzr
    mov x0, x10
    blr x9
    mov x8, #94             // exit_group
    svc #0
    brk #1
    .cfi_endproc
    .size play_launch_clone_on_own_stack, . - play_launch_clone_on_own_stack
)");
#else
#error "isolation in a shared address space is written for x86-64 and aarch64"
#endif
