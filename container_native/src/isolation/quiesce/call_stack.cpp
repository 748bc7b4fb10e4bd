#include "isolation/quiesce/call_stack.hpp"

#include <dlfcn.h>
#include <linux/futex.h>
#include <signal.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unwind.h>

#include "isolation/quiesce/quiesce.hpp"

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

struct Registers {
  std::uintptr_t program_counter;
  std::uintptr_t caller;  // the return address right after a call, when nothing else is known
};

Registers registers_of(void* context) noexcept {
  const mcontext_t& registers = static_cast<ucontext_t*>(context)->uc_mcontext;
#if defined(__x86_64__)
  const auto pc = static_cast<std::uintptr_t>(registers.gregs[REG_RIP]);
  dl_find_object object{};
  if (::_dl_find_object(reinterpret_cast<void*>(pc), &object) == 0) {
    return {pc, 0};
  }
  // A call to no code: the return address lies on top of the stack.
  return {pc, *reinterpret_cast<const std::uintptr_t*>(registers.gregs[REG_RSP])};
#else
  return {static_cast<std::uintptr_t>(registers.pc),
          static_cast<std::uintptr_t>(registers.regs[30])};
#endif
}

bool has_registers_of_a_wake(void* context) noexcept {
  const mcontext_t& registers = static_cast<ucontext_t*>(context)->uc_mcontext;
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
  std::size_t skipped = 0;
};

_Unwind_Reason_Code collect(_Unwind_Context* context, void* argument) noexcept {
  constexpr std::size_t kMostSkipped = 32;
  auto& collection = *static_cast<Collection*>(argument);
  CallStack& stack = collection.stack;
  const std::uintptr_t address = _Unwind_GetIP(context);
  if (stack.count == 0 && address != collection.begin) {
    return ++collection.skipped < kMostSkipped ? _URC_NO_REASON : _URC_END_OF_STACK;
  }
  if (stack.count == CallStack::kMaxFrames || address == 0) {
    return _URC_END_OF_STACK;
  }
  const std::uintptr_t pointer = stack.count == 0 ? 0 : _Unwind_GetCFA(context);
  stack.frames[stack.count++] = {address, pointer};
  return _URC_NO_REASON;
}

}  // namespace

CallStack interrupted_call_stack(void* context) noexcept {
  CallStack stack;
  stack.wakes_others = has_registers_of_a_wake(context);
  const Registers registers = registers_of(context);
  Collection collection{stack, registers.program_counter};
  _Unwind_Backtrace(collect, &collection);
  if (stack.count == 0) {
    stack.frames[stack.count++] = {registers.program_counter, 0};
  }
  if (stack.count == 1 && registers.caller != 0) {
    stack.frames[stack.count++] = {registers.caller, 0};
  }
  return stack;
}

void prepare_call_stack() {
  CallStack stack;
  Collection collection{stack, 0};
  _Unwind_Backtrace(collect, &collection);
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
