#include "isolation/quiesce/call_stack.hpp"

#include <dlfcn.h>
#include <linux/futex.h>
#include <signal.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unwind.h>

#include "isolation/quiesce/quiesce.hpp"
#include "isolation/record/own_signals.hpp"

#if defined(__x86_64__)
// Returned to, not called: there is no caller any more.
asm(R"(
    .text
    .p2align 4
    .hidden play_launch_park_here
    .globl play_launch_park_here
    .type play_launch_park_here, @function
    .cfi_startproc
    .cfi_undefined rip
    nop # the unwinder looks for a return address in what is before it
play_launch_park_here:
    and $-16, %rsp
    call play_launch_park_current_thread
    hlt
    .cfi_endproc
    .size play_launch_park_here, . - play_launch_park_here
)");

extern "C" void play_launch_park_here();
extern "C" [[gnu::used, gnu::visibility("hidden")]] void play_launch_park_current_thread() {
  play_launch::isolation::park_if_dying();
}
#endif

namespace play_launch::isolation {
namespace {

mcontext_t& registers_of(void* context) noexcept {
  return static_cast<ucontext_t*>(context)->uc_mcontext;
}

bool is_code(std::uintptr_t address) noexcept {
  dl_find_object object{};
  return ::_dl_find_object(reinterpret_cast<void*>(address), &object) == 0;
}

/// The return address right after a call, when nothing else is known about the stack; 0 if what is
/// in its place is not an address. Faults without a stack.
std::uintptr_t caller_of(const mcontext_t& registers) noexcept {
#if defined(__x86_64__)
  const std::uintptr_t caller = *reinterpret_cast<const std::uintptr_t*>(registers.gregs[REG_RSP]);
#else
  const auto caller = static_cast<std::uintptr_t>(registers.regs[30]);
#endif
  return is_code(caller) ? caller : 0;
}

/// As if the interrupted place had been called and returned: the unwinder takes it from there.
void return_to(std::uintptr_t caller, mcontext_t& registers) noexcept {
#if defined(__x86_64__)
  registers.gregs[REG_RIP] = static_cast<greg_t>(caller);
  registers.gregs[REG_RSP] += sizeof caller;
#else
  registers.pc = caller;
#endif
}

bool has_registers_of_a_wake(void* context) noexcept {
  const mcontext_t& registers = registers_of(context);
#if defined(__x86_64__)
  const auto number = registers.gregs[REG_RAX];
  const auto operation = registers.gregs[REG_RSI];
#else
  const auto number = registers.regs[8];
  const auto operation = registers.regs[1];
#endif
  if (number != SYS_futex) {
    return false;
  }
  switch (operation & FUTEX_CMD_MASK) {
    case FUTEX_WAKE:
    case FUTEX_WAKE_OP:
    case FUTEX_WAKE_BITSET:
    case FUTEX_REQUEUE:
    case FUTEX_CMP_REQUEUE:
    case FUTEX_UNLOCK_PI:
      return true;
    default:
      return false;
  }
}

struct Collection {
  CallStack& stack;
  std::uintptr_t begin;  // the interrupted place; the handler's own frames come before it
  bool began = false;
  std::size_t skipped = 0;
};

_Unwind_Reason_Code collect(_Unwind_Context* context, void* argument) noexcept {
  constexpr std::size_t kMostSkipped = 32;
  auto& collection = *static_cast<Collection*>(argument);
  CallStack& stack = collection.stack;
  const std::uintptr_t address = _Unwind_GetIP(context);
  if (!collection.began && address != collection.begin) {
    return ++collection.skipped < kMostSkipped ? _URC_NO_REASON : _URC_END_OF_STACK;
  }
  collection.began = true;
  if (stack.count == CallStack::kMaxFrames || address == 0) {
    return _URC_END_OF_STACK;
  }
  const std::uintptr_t pointer = stack.count == 0 ? 0 : _Unwind_GetCFA(context);
  stack.frames[stack.count++] = {address, pointer};
  return _URC_NO_REASON;
}

/// Adds what can be found to the stack, bit by bit: it may end in a fault.
void unwind(CallStack& stack, std::uintptr_t begin) noexcept {
  Collection collection{stack, begin};
  _Unwind_Backtrace(collect, &collection);
}

void unwind_from_caller(CallStack& stack, mcontext_t& registers) noexcept {
  if (const std::uintptr_t caller = caller_of(registers)) {
    return_to(caller, registers);
    unwind(stack, caller);
    if (stack.count == 1) {
      stack.frames[stack.count++] = {caller, 0};
    }
  }
}

}  // namespace

std::uintptr_t interrupted_place(void* context) noexcept {
  const mcontext_t& registers = registers_of(context);
#if defined(__x86_64__)
  return static_cast<std::uintptr_t>(registers.gregs[REG_RIP]);
#else
  return static_cast<std::uintptr_t>(registers.pc);
#endif
}

CallStack interrupted_call_stack(void* context, bool jumped_to_no_code) noexcept {
  CallStack stack;
  stack.wakes_others = has_registers_of_a_wake(context);
  const std::uintptr_t place = interrupted_place(context);
  if (!jumped_to_no_code) {
    survive([&] { unwind(stack, place); });
  }
  if (stack.count == 0) {
    stack.frames[stack.count++] = {place, 0};
  }
  if (stack.count == 1 && (jumped_to_no_code || !is_code(place))) {
    const mcontext_t before = registers_of(context);
    survive([&] { unwind_from_caller(stack, registers_of(context)); });
    registers_of(context) = before;
  }
  return stack;
}

void prepare_call_stack() {
  CallStack stack;
  unwind(stack, 0);
}

bool park_on_return_to(const Frame& frame) noexcept {
#if defined(__x86_64__)
  if (frame.stack == 0) {
    return false;
  }
  auto* const slot = reinterpret_cast<std::uintptr_t*>(frame.stack) - 1;
  if (*slot != frame.address) {
    return false;
  }
  *slot = reinterpret_cast<std::uintptr_t>(&play_launch_park_here);
  return true;
#else
  static_cast<void>(frame);
  return false;
#endif
}

}  // namespace play_launch::isolation
