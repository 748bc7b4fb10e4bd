#include "isolation/crash/crash_handler.hpp"

#include <cxxabi.h>
#include <pthread.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <mutex>
#include <string_view>
#include <tuple>
#include <typeinfo>

#include "base/elf.hpp"
#include "isolation/memory/protection_keys.hpp"
#include "isolation/quiesce/call_stack.hpp"
#include "isolation/quiesce/code_map.hpp"
#include "isolation/quiesce/quiesce.hpp"
#include "isolation/record/own_signals.hpp"

namespace play_launch::isolation {
namespace {

using namespace std::string_view_literals;

/// What instructions cause, and what the kernel sends when a limit is exceeded.
constexpr std::array kFaults{SIGSEGV, SIGBUS, SIGFPE,  SIGILL, SIGABRT,
                             SIGTRAP, SIGSYS, SIGXCPU, SIGXFSZ};
/// What ends a process that has no handler for it, and tells nothing about the process.
constexpr std::array kRequests{SIGTERM, SIGINT,  SIGHUP,    SIGQUIT, SIGUSR1, SIGUSR2,
                               SIGALRM, SIGPROF, SIGVTALRM, SIGIO,   SIGPWR};

std::terminate_handler terminate_before = nullptr;

/// For the handler of a crash, besides quiescing: a lock that it needs may be held for good.
constexpr std::chrono::milliseconds kHandlerLimit{3000};
constexpr int kQuiesceLimits = 4;  // see ChildOptions::quiesce_limit

/// See watch_own_crash().
std::atomic<CrashSlot*> own_slot{nullptr};
void (*own_described)() noexcept = nullptr;
pid_t own_pid = 0;

std::uint64_t time_ns(clockid_t clock) noexcept {
  constexpr std::uint64_t kPerSecond = 1'000'000'000;
  timespec time{};
  ::clock_gettime(clock, &time);
  return static_cast<std::uint64_t>(time.tv_sec) * kPerSecond +
         static_cast<std::uint64_t>(time.tv_nsec);
}

bool was_sent(const siginfo_t& info) noexcept { return info.si_code <= 0; }

bool is_deadline(const siginfo_t& info, const ChildRecord& child) noexcept {
  return info.si_code == SI_TIMER && info.si_value.sival_ptr == &child;
}

bool is_request(int signal, const siginfo_t& info) noexcept {
  return std::find(kRequests.begin(), kRequests.end(), signal) != kRequests.end() ||
         (was_sent(info) && info.si_pid != ::getpid());
}

/// The key that the fault came of; 0: it came of something else.
int denied_key(int signal, const siginfo_t& info) noexcept {
  return signal == SIGSEGV && info.si_code == SEGV_PKUERR ? static_cast<int>(info.si_pkey) : 0;
}

/// Gives this handler the rights of the process. True: it was a handler of the node that lacked
/// them, which goes on with them.
bool take_rights(const ChildRecord& child, int signal, const siginfo_t& info,
                 void* context) noexcept {
  const std::uint32_t rights = child.options.key_rights;
  if (rights == 0) {
    return false;
  }
  assume_rights(rights);
  const int key = denied_key(signal, info);
  return key != 0 && restore_rights(rights, key, context);
}

void leave(ChildRecord& child, int signal, const siginfo_t& info) noexcept {
  CrashSlot& slot = *child.slot;
  int none = 0;
  if (slot.stop_signal.compare_exchange_strong(none, signal)) {
    slot.stop_sender = was_sent(info) ? info.si_pid : 0;
    ChildPhase running = ChildPhase::running;
    slot.phase.compare_exchange_strong(running, ChildPhase::leaving);
    signal_self_after(child.options.leave_limit, signal, &child);
  }
  child.program->cancel();
}

/// Without a look at the stack, which may be what is damaged.
void describe(CrashSlot& slot, int signal, const siginfo_t& info, void* context) noexcept {
  slot.report.crash_time_ns = time_ns(CLOCK_MONOTONIC);
  slot.report.crash_wall_time_ns = time_ns(CLOCK_REALTIME);
  slot.report.signal = signal;
  slot.report.code = info.si_code;
  if (was_sent(info)) {
    slot.report.sender = info.si_code == SI_TIMER ? 0 : info.si_pid;
  } else {
    slot.report.fault_address = reinterpret_cast<std::uintptr_t>(info.si_addr);
    slot.report.protection_key = denied_key(signal, info);
  }
  ::prctl(PR_GET_NAME, slot.report.thread_name.data());
  slot.report.program_counter = interrupted_place(context);
  slot.report.frames[0] = slot.report.program_counter;
  slot.report.frame_count = 1;
  slot.thread = ::gettid();
}

void trace(CrashSlot& slot, void* context) noexcept {
  const CallStack stack = interrupted_call_stack(context, is_jump_to_no_code(slot.report));
  std::transform(stack.frames.begin(), stack.frames.begin() + stack.count,
                 slot.report.frames.begin(), [](const Frame& frame) { return frame.address; });
  slot.report.frame_count = static_cast<std::uint32_t>(stack.count);
  if (slot.report.exception_type[0] != '\0') {
    survive([&] { slot.report.thrower = thrower_in(stack); });
  }
  bool harmless = false;
  survive([&] { harmless = judge(stack, Caution::lenient, slot.report.thrower).harmless; });
  slot.report.inside = !harmless;
  slot.traced = true;
}

extern "C" void on_crash_signal(int signal, siginfo_t* info, void* context);

/// But for signals that the process ignores, as after nohup.
template <std::size_t size>
void handle(const std::array<int, size>& signals) noexcept {
  struct sigaction action{};
  action.sa_sigaction = on_crash_signal;
  action.sa_flags = SA_SIGINFO | SA_RESTART | SA_ONSTACK;
  // Whatever is not caused within survive() waits for the end.
  sigfillset(&action.sa_mask);
  for (const int signal : signals) {
    struct sigaction before{};
    if (::sigaction(signal, nullptr, &before) == 0 && before.sa_handler != SIG_IGN) {
      ::sigaction(signal, &action, nullptr);
    }
  }
}

void crash(ChildRecord& child, int signal, const siginfo_t& info, void* context) noexcept {
  // From here on faults are ours, also where the node had handlers of its own.
  handle(kFaults);
  CrashSlot& slot = *child.slot;
  slot.phase = ChildPhase::crashed;
  describe(slot, signal, info, context);
  trace(slot, context);
  survive([&] { child.program->crashed(); });
  quiesce(child);
  if (!slot.report.inside) {
    child.threads.rest();
  }
  slot.phase = ChildPhase::dying;
}

/// As claim_end(), in the process itself.
void claim_own_end() noexcept {
  static std::atomic<bool> is_claimed{false};
  if (is_claimed.exchange(true)) {
    while (true) {
      ::pause();
    }
  }
}

/// The process itself dies, and no other thread comes back from a fault of its own meanwhile.
void crash_of_all(CrashSlot& slot, int signal, const siginfo_t& info, void* context) noexcept {
  describe(slot, signal, info, context);
  trace(slot, context);
  slot.report.inside = false;  // no thread is left that this could harm
  own_described();
}

extern "C" void on_crash_signal(int signal, siginfo_t* info, void* context) {
  const int error = errno;
  ChildRecord* const child = current_child();
  CrashSlot* const own = own_pid == ::getpid() ? own_slot.load() : nullptr;
  if (child != nullptr && take_rights(*child, signal, *info, context)) {
    // Nothing has happened.
  } else if (child == nullptr && own == nullptr) {
    // A process that a node forked; or, see SurvivalOfReports, a container.
    is_surviving(*info);
    die_in_place(signal, *info, context);
  } else if (is_surviving(*info)) {
    // It is dying already.
  } else if (child == nullptr) {
    if (!is_request(signal, *info)) {
      claim_own_end();
      const SelfSignal limit(kHandlerLimit, SIGKILL);
      survive([&] { crash_of_all(*own, signal, *info, context); });
    }
    die_in_place(signal, *info, context);
  } else if (child->options.dies_abruptly || is_deadline(*info, *child) ||
             !is_request(signal, *info)) {
    claim_end(*child);
    // Not for the death itself, in which a core may be dumped.
    const SelfSignal limit(kHandlerLimit + child->options.quiesce_limit * kQuiesceLimits, SIGKILL);
    // Whatever else goes wrong, the process dies of this signal.
    survive([&] { crash(*child, signal, *info, context); });
    child->slot->died_of = signal;
    if (children_end_by_kill()) {
      die_of(signal);
    }
    die_in_place(signal, *info, context);
  } else {
    leave(*child, signal, *info);
  }
  errno = error;
}

template <std::size_t size>
void copy_text(std::array<char, size>& to, const char* from) noexcept {
  const std::size_t length = std::min(std::strlen(from), size - 1);
  std::copy_n(from, length, to.data());
  to[length] = '\0';
}

void note_exception(CrashSlot& slot) {
  const std::type_info* const type = abi::__cxa_current_exception_type();
  if (type == nullptr) {
    return;
  }
  copy_text(slot.report.exception_type, demangled(type->name()).c_str());
  try {
    throw;
  } catch (const std::exception& error) {
    copy_text(slot.report.exception_text, error.what());
  } catch (...) {
  }
}

iovec piece(const char* text) { return {const_cast<char*>(text), std::strlen(text)}; }

/// Instead of the C++ library's handler, which remembers in the memory that all share that it has
/// been called, and from the second death on reports nothing else.
[[noreturn]] void on_terminate() {
  ChildRecord* const child = current_child();
  if (CrashSlot* const own = own_slot; child == nullptr && own != nullptr) {
    note_exception(*own);
  }
  if (child == nullptr && terminate_before != nullptr) {
    terminate_before();
  }
  if (child != nullptr && child->ender == 0) {
    CrashSlot& slot = *child->slot;
    note_exception(slot);
    std::array<char, 16> name{};
    ::prctl(PR_GET_NAME, name.data());
    const bool thrown = slot.report.exception_type[0] != '\0';
    const std::array<iovec, 7> line{
        piece(name.data()),
        piece(": std::terminate() was called"),
        piece(thrown ? " for an exception of type " : ""),
        piece(slot.report.exception_type.data()),
        piece(slot.report.exception_text[0] != '\0' ? ": " : ""),
        piece(slot.report.exception_text.data()),
        piece("\n"),
    };
    [[maybe_unused]] const ssize_t written =
        ::writev(STDERR_FILENO, line.data(), static_cast<int>(line.size()));
  }
  std::abort();
}

}  // namespace

void prepare_crash_handling() {
  static std::once_flag once;
  std::call_once(once, [] {
    prepare_call_stack();
    prepare_code_map();
    terminate_before = std::set_terminate(on_terminate);
  });
}

void install_crash_handlers() noexcept {
  forget_survival();
  handle(kFaults);
  handle(kRequests);
  install_park_handler();
}

void watch_own_crash(CrashSlot* slot, void (*described)() noexcept) noexcept {
  own_pid = ::getpid();
  if (slot != nullptr) {
    own_described = described;
    own_slot = slot;
    handle(kFaults);
  } else {
    own_slot = nullptr;
  }
}

SurvivalOfReports::SurvivalOfReports() noexcept {
  static_assert(kFaults.size() == std::tuple_size_v<decltype(before_)>);
  for (std::size_t i = 0; i < kFaults.size(); ++i) {
    ::sigaction(kFaults[i], nullptr, &before_[i]);
  }
  handle(kFaults);
}

SurvivalOfReports::~SurvivalOfReports() {
  for (std::size_t i = 0; i < kFaults.size(); ++i) {
    ::sigaction(kFaults[i], &before_[i], nullptr);
  }
}

void claim_end(ChildRecord& child) noexcept {
  pid_t none = 0;
  const pid_t self = ::gettid();
  if (!child.ender.compare_exchange_strong(none, self) && none != self) {
    park(child, false);
  }
}

}  // namespace play_launch::isolation
