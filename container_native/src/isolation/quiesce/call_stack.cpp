#include "isolation/quiesce/call_stack.hpp"

#include <dlfcn.h>
#include <linux/futex.h>
#include <signal.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unwind.h>

#include "isolation/quiesce/quiesce.hpp"
#include "isolation/record/own_signals.hpp"

// The unwinder looks for a return address in what is before it: nop.
#if defined(__x86_64__)
#define RETURN_ADDRESS "rip"
#define PARK "and $-16, %rsp\n call play_launch_park_current_thread\n hlt\n"
#else
#define RETURN_ADDRESS "x30"
#define PARK "bl play_launch_park_current_thread\n brk #1\n"
#endif
// Returned to, not called: there is no caller any more.
asm(".text\n"
    ".p2align 4\n"
    ".hidden play_launch_park_here\n"
    ".globl play_launch_park_here\n"
    ".type play_launch_park_here, %function\n"
    ".cfi_startproc\n"
    ".cfi_undefined " RETURN_ADDRESS
    "\n"
    "nop\n"
    "play_launch_park_here:\n" PARK
    ".cfi_endproc\n"
    ".size play_launch_park_here, . - play_launch_park_here\n");

extern "C" void play_launch_park_here();
extern "C" [[gnu::used, gnu::visibility("hidden")]] void play_launch_park_current_thread() {
  play_launch::isolation::park_if_dying();
}

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

#if defined(__aarch64__)
constexpr int kFramePointer = 29;
constexpr int kReturnAddress = 30;

/// Without the signature of pointer authentication.
std::uintptr_t without_signature(std::uintptr_t address) noexcept {
  register std::uintptr_t result asm("x30") = address;
  asm("hint #7" : "+r"(result));  // xpaclri
  return result;
}

/// Signed with one of both keys, as functions do with their return address: by the stack pointer.
std::uintptr_t with_signature(std::uintptr_t address, std::uintptr_t stack, bool first) noexcept {
  register std::uintptr_t result asm("x17") = address;
  register std::uintptr_t modifier asm("x16") = stack;
  if (first) {
    asm("hint #8" : "+r"(result) : "r"(modifier));  // pacia1716
  } else {
    asm("hint #10" : "+r"(result) : "r"(modifier));  // pacib1716
  }
  return result;
}
#endif

/// Replaces the return address to a frame, if that is it.
void replace_return(std::uintptr_t& address, const Frame& frame) noexcept {
  const auto parking = reinterpret_cast<std::uintptr_t>(&play_launch_park_here);
  if (address == frame.address) {
    address = parking;
    return;
  }
#if defined(__aarch64__)
  if (without_signature(address) == frame.address) {
    for (const bool first : {true, false}) {
      if (with_signature(frame.address, frame.stack, first) == address) {
        address = with_signature(parking, frame.stack, first);
        return;
      }
    }
  }
#endif
}

struct Collection {
  CallStack& stack;
  std::uintptr_t begin;  // the interrupted place; the handler's own frames come before it
  bool began = false;
  std::size_t skipped = 0;
  std::uintptr_t frame_pointer = 0;  // in the function before
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
  const bool is_innermost = stack.count == 0;
  Frame& frame = stack.frames[stack.count++];
  frame = {address, is_innermost ? 0 : _Unwind_GetCFA(context)};
#if defined(__x86_64__)
  frame.kept = is_innermost ? nullptr : reinterpret_cast<std::uintptr_t*>(frame.stack) - 1;
#else
  // The frame pointer of a function points to that of its caller, and the return address.
  frame.kept =
      is_innermost ? nullptr : reinterpret_cast<std::uintptr_t*>(collection.frame_pointer) + 1;
  collection.frame_pointer = _Unwind_GetGR(context, kFramePointer);
#endif
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

void park_on_return_to(const CallStack& stack, std::size_t number, void* context) noexcept {
  const Frame& frame = stack.frames[number];
#if defined(__aarch64__)
  if (number == 1) {
    // A function that calls no other keeps it in its register, others at their beginning and end.
    std::uintptr_t address = registers_of(context).regs[kReturnAddress];
    replace_return(address, frame);
    registers_of(context).regs[kReturnAddress] = address;
  }
#else
  static_cast<void>(context);
#endif
  if (frame.kept != nullptr) {
    replace_return(*frame.kept, frame);
  }
}

}  // namespace play_launch::isolation
