#include "isolation/clone/child.hpp"

#include <sched.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <memory>

#include "base/process.hpp"
#include "isolation/clone/vm_clone.hpp"
#include "isolation/crash/crash_handler.hpp"
#include "isolation/memory/protection_keys.hpp"
#include "isolation/quiesce/quiesce.hpp"
#include "isolation/record/child_record.hpp"
#include "isolation/record/child_threads.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

struct Launch {
  ChildRecord& record;
  AlternateStack& alternate_stack;
  std::array<char, 16> name{};
  pid_t container;
  Birth birth{};
};

constexpr int kExitOrphaned = 125;
constexpr int kExitKeptOut = 126;
constexpr int kExitStatusMask = 0xff;
/// For dying of the signal that its time is over, which it may have blocked.
constexpr std::chrono::milliseconds kHearingLimit{1000};

/// The child has a copy of the container's actions, which would act on the container's memory.
void forget_signal_actions() noexcept {
  for (int signal = 1; signal <= SIGRTMAX; ++signal) {
    struct sigaction action{};
    // SIGPIPE: that the container does not die of it holds for its nodes as well.
    if (signal == SIGPIPE || ::sigaction(signal, nullptr, &action) != 0 ||
        action.sa_handler == SIG_DFL || action.sa_handler == SIG_IGN) {
      continue;
    }
    action = {};
    action.sa_handler = SIG_DFL;
    ::sigaction(signal, &action, nullptr);
  }
}

void enter(const Launch& launch) noexcept {
  const pid_t pid = ::getpid();
  ChildRecord& record = launch.record;
  CrashSlot& slot = *record.slot;
  forget_dead_thread(pid);
  *record.registered_pid = pid;
  slot.pid = pid;
  slot.start_time = start_time_of_self();
  slot.alive = true;
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != launch.container) {
    ::_exit(kExitOrphaned);  // it died before it could be watched
  }
  ::prctl(PR_SET_NAME, launch.name.data());
  forget_signal_actions();
  // The limits are this process's own, whatever it shares.
  set_core_dumps(record.options.core_dumps);
  if (record.options.urgency) {
    assume(0, *record.options.urgency);
  }
  for (const ResourceSetting& setting : record.options.resources) {
    if (setting.kind != ResourceSetting::Kind::cgroup || !launch.birth.in_group) {
      if (!apply_or_complain(setting)) {
        slot.report.kept_out = true;
        ::_exit(kExitKeptOut);
      }  // of the others, the supervisor checks what is in force
    }
  }
  if (record.options.group != nullptr) {
    record.options.group->reset();  // the descriptor is the container's as well
  }
  launch.alternate_stack.use();
  install_crash_handlers();
  if (record.options.time_limit.count() > 0) {
    signal_self_after(record.options.time_limit, SIGALRM, &record);
    signal_self_after(record.options.time_limit + kHearingLimit, SIGKILL);
  }
  if (record.options.cpu_limit.count() > 0) {
    signal_self_after(record.options.cpu_limit, SIGXCPU, &record, CLOCK_PROCESS_CPUTIME_ID);
  }
  if (record.options.key_rights != 0) {
    assume_rights(record.options.key_rights);  // threads that it starts begin with them
  }
  slot.phase = ChildPhase::running;
  unblock_all_signals();
}

int run_program(void* argument) {
  const auto& launch = *static_cast<const Launch*>(argument);
  enter(launch);
  ChildRecord& record = launch.record;
  const int status = record.program->run();
  // Threads that the program left behind are about to be killed, too.
  claim_end(record);
  record.slot->phase = ChildPhase::returned;
  quiesce(record);
  block_all_signals();
  const int stop_signal = record.slot->stop_signal;
  record.slot->died_of = stop_signal;
  return stop_signal != 0 ? -stop_signal : status & kExitStatusMask;
}

void before_reaping(void* argument) noexcept {
  const auto& launch = *static_cast<const Launch*>(argument);
  CrashSlot& slot = *launch.record.slot;
  const pid_t pid = slot.pid;
  if (slot.phase != ChildPhase::returned) {
    note_dead_thread(pid, pid, launch.name.data());
  }
  launch.record.threads.clean_up([&](pid_t thread, std::uintptr_t pointer) {
    note_dead_thread(thread, pid, launch.name.data());
    if (pointer != 0 && slot.report.resting_thread_count < slot.report.resting_threads.size()) {
      slot.report.resting_threads[slot.report.resting_thread_count++] = pointer;
    }
  });
  launch.record.initialisations.undo();
  slot.alive = false;
  while (slot.senders != 0) {
    ::sched_yield();
  }
  *launch.record.registered_pid = 0;
}

}  // namespace

ChildEnd run_in_child(ChildProgram& program, CrashSlot& slot,
                      const ChildOptions& options) noexcept {
  std::construct_at(&slot);
  ChildEnd end;
  ChildRecord record;
  record.program = &program;
  record.slot = &slot;
  record.options = options;
  record.after_death = donor_is_tainted();
  record.first_thread = ::pthread_self();
  const Registration registration(record);
  AlternateStack alternate_stack;
  if (!registration || !alternate_stack) {
    end.error = registration ? ENOMEM : EAGAIN;
    return end;
  }
  Launch launch{record, alternate_stack, {}, ::getpid()};
  std::copy_n(options.name.data(), std::min(options.name.size(), launch.name.size() - 1),
              launch.name.data());
  if (options.group != nullptr) {
    launch.birth.group = options.group->get();
  }
  end = clone_and_wait(run_program, &launch, before_reaping, &launch.birth);
  if (end.signal == SIGKILL && slot.died_of != 0) {
    end.signal = slot.died_of;
  }
  return end;
}

bool send_signal(CrashSlot& slot, int signal) noexcept {
  // The donor does not reap the child while a thread is between these two.
  ++slot.senders;
  const bool sent = slot.alive && ::kill(slot.pid, signal) == 0;
  --slot.senders;
  return sent;
}

}  // namespace play_launch::isolation
