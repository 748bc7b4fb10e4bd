// Judging a call stack that was made up: what a thread in these functions may hold.

#include "isolation/quiesce/code_map.hpp"

#include <dlfcn.h>
#include <pthread.h>

#include <cstdint>
#include <cstdlib>
#include <initializer_list>

#include "../container/check.hpp"
#include "base/early_code.hpp"
#include "base/elf.hpp"
#include "node_stand_in.hpp"
#include "rcl_stand_in.hpp"

// Named as a function of the C++ library's headers that was compiled into this program.
extern "C" void play_launch_test_header_function() __asm__("_ZNSt5mutex16play_launch_testEv");
void play_launch_test_header_function() { __asm__ volatile("nop"); }

extern "C" void play_launch_test_function_of_a_node();
void play_launch_test_function_of_a_node() { __asm__ volatile("nop"); }

namespace {

using namespace play_launch::isolation;
using play_launch::DynamicSymbols;
using play_launch::library_at;

[[gnu::noinline]] void unnamed() { __asm__ volatile("nop"); }
[[gnu::noinline]] void also_unnamed() { __asm__ volatile("nop; nop"); }

/// A byte into a function, as the frames of a stack are: none here is empty, as it would end there.
std::uintptr_t within(void (*function)()) { return reinterpret_cast<std::uintptr_t>(function) + 1; }

CallStack stack_of(std::initializer_list<void (*)()> functions) {
  CallStack stack;
  for (const auto function : functions) {
    stack.frames[stack.count++] = {within(function), 1};
  }
  return stack;
}

/// The address of a system call in the C library.
std::uintptr_t a_system_call() {
  auto* const begin = reinterpret_cast<const unsigned char*>(::dlsym(RTLD_DEFAULT, "getppid"));
  for (int i = 0; i < 64; ++i) {
#if defined(__x86_64__)
    if (begin[i] == 0x0f && begin[i + 1] == 0x05) {
      return reinterpret_cast<std::uintptr_t>(begin + i);
    }
#else
    if (i % 4 == 0 && begin[i] == 0x01 && begin[i + 1] == 0 && begin[i + 2] == 0 &&
        begin[i + 3] == 0xd4) {
      return reinterpret_cast<std::uintptr_t>(begin + i);
    }
#endif
  }
  CHECK(!"a system call in getppid()");
  return 0;
}

/// Whatever its name is: what counts is what was loaded first.
void test_libraries_of_nodes() {
  void* const library = ::dlopen(NODE_STAND_IN, RTLD_NOW | RTLD_LOCAL);
  CHECK(library != nullptr);
  const void* const found = ::dlsym(library, "play_launch_test_node");
  CHECK(found != nullptr);
  const auto& node = *static_cast<const stand_in::NodeLibrary*>(found);
  CHECK(judge(stack_of({node.compute_for_ever, stand_in::publish}), Caution::lenient).harmless);
  CHECK(!judge(stack_of({stand_in::publish, node.compute_for_ever}), Caution::lenient).harmless);
  play_launch::note_early_code();
  CHECK(!judge(stack_of({node.compute_for_ever, stand_in::publish}), Caution::lenient).harmless);
}

/// They stand between the C library's and the code that locks or unlocks a mutex.
void test_our_own_locks() {
  const auto lock = reinterpret_cast<void (*)()>(&::pthread_mutex_timedlock);
  const auto unlock = reinterpret_cast<void (*)()>(&::pthread_mutex_unlock);
  for (const Caution caution : {Caution::careful, Caution::lenient}) {
    for (const auto function : {lock, unlock}) {
      CHECK(!judge(stack_of({function, play_launch_test_function_of_a_node}), caution).harmless);
    }
    // The first stands for the place where the C library waits.
    CallStack waiting = stack_of({unnamed, lock, stand_in::publish});
    CallStack of_a_node = stack_of({unnamed, lock, play_launch_test_function_of_a_node});
    waiting.frames[0].address = of_a_node.frames[0].address = a_system_call();
    CHECK(!judge(waiting, caution).harmless);
    CHECK(judge(of_a_node, caution).harmless);
  }
}

void test_who_called_decides() {
  for (const Caution caution : {Caution::careful, Caution::lenient}) {
    CHECK(judge(stack_of({play_launch_test_function_of_a_node}), caution).harmless);
    const Judgement below =
        judge(stack_of({stand_in::publish, play_launch_test_function_of_a_node}), caution);
    CHECK(!below.harmless && below.way_out == 1);
    const Judgement nowhere = judge(stack_of({stand_in::publish}), caution);
    CHECK(!nowhere.harmless && nowhere.way_out == 1);
    CHECK(
        !judge(stack_of({play_launch_test_header_function, stand_in::publish}), caution).harmless);
  }
}

/// Without optimisation, and with the program's copy of the headers' functions in use, unlocking in
/// the middleware ends so.
void test_functions_without_a_name_at_the_end_of_unlocking() {
  const CallStack unlocking = stack_of({unnamed, also_unnamed, play_launch_test_header_function,
                                        play_launch_test_header_function, stand_in::publish});
  for (const Caution caution : {Caution::careful, Caution::lenient}) {
    CHECK(!judge(unlocking, caution).harmless);
  }
}

void test_functions_without_a_name_of_a_node() {
  const CallStack callback = stack_of({unnamed, also_unnamed, stand_in::publish});
  CHECK(!judge(callback, Caution::careful).harmless);
  const Judgement judgement = judge(callback, Caution::lenient);
  CHECK(judgement.harmless && judgement.way_out == 0);
  const CallStack below = stack_of({stand_in::publish, unnamed, also_unnamed});
  const Judgement way_out = judge(below, Caution::lenient);
  CHECK(!way_out.harmless && way_out.way_out == 1);
}

/// Whatever called them.
void test_functions_of_the_c_library_that_take_locks() {
  void* const library = ::dlopen("libc.so.6", RTLD_NOW | RTLD_NOLOAD);
  const auto at = [library](const char* name) {
    return reinterpret_cast<void (*)()>(::dlsym(library, name));
  };
  for (const char* const name :
       {"malloc", "free", "realloc", "posix_memalign", "malloc_info", "printf", "fopen", "fflush",
        "fwrite", "pthread_create", "pthread_mutex_lock", "pthread_mutex_unlock",
        "pthread_rwlock_rdlock", "pthread_rwlock_unlock"}) {
    CHECK(!judge(stack_of({at(name), play_launch_test_function_of_a_node}), Caution::lenient)
               .harmless);
  }
  CHECK(judge(stack_of({at("strlen"), play_launch_test_function_of_a_node}), Caution::lenient)
            .harmless);
}

/// A thread that released a lock and has not yet woken its waiter.
void test_before_a_wake() {
  CallStack stack = stack_of({nullptr, play_launch_test_function_of_a_node});
  stack.frames[0].address = a_system_call();
  for (const Caution caution : {Caution::careful, Caution::lenient}) {
    stack.wakes_others = false;
    CHECK(judge(stack, caution).harmless);
    stack.wakes_others = true;
    const Judgement judgement = judge(stack, caution);
    CHECK(!judgement.harmless && judgement.way_out == 1);
  }
}

void (*in_the_cpp_library(const char* name))() {
  void* const found = ::dlsym(RTLD_DEFAULT, name);
  CHECK(found != nullptr);
  return reinterpret_cast<void (*)()>(found);
}

/// Code that no exported function has, as a part that the compiler set apart.
void (*nameless_in_the_cpp_library())() {
  std::uintptr_t address = within(in_the_cpp_library("_ZSt9terminatev"));
  const link_map* const library = library_at(address);
  CHECK(library != nullptr);
  while (!DynamicSymbols(*library).function_at(address).name.empty()) {
    ++address;
  }
  CHECK(library_at(address) == library);
  return reinterpret_cast<void (*)()>(address);
}

void test_which_frame_threw() {
  void (*const node)() = play_launch_test_function_of_a_node;
  void (*const nameless)() = nameless_in_the_cpp_library();
  void (*const terminate)() = in_the_cpp_library("_ZSt9terminatev");
  void (*const thrown)() = in_the_cpp_library("__cxa_throw");
  void (*const thrown_on)() = in_the_cpp_library("__cxa_rethrow");
  void (*const noexcept_met)() = in_the_cpp_library("__gxx_personality_v0");
  const auto thrower = [&](std::initializer_list<void (*)()> callers) {
    CallStack stack = stack_of({std::abort, unnamed, nameless, terminate});
    for (const auto caller : callers) {
      stack.frames[stack.count++] = {within(caller), 1};
    }
    return thrower_in(stack);
  };
  CHECK(thrower({thrown, node, stand_in::publish}) == 5);
  CHECK(thrower({thrown_on, node, stand_in::publish}) == 5);
  // GCC 14's __cxa_rethrow() calls std::terminate() in a part of it that was set apart.
  CHECK(thrower({nameless, node, stand_in::publish}) == 5);
  CHECK(thrower({nameless, noexcept_met, thrown, node, stand_in::publish}) == 7);
  CHECK(thrower({nameless, noexcept_met, node, stand_in::publish}) == 0);
  CHECK(thrower({node, stand_in::publish}) == 0);
  CHECK(thrower({nameless}) == 0);
}

}  // namespace

int main() {
  prepare_code_map();
  test_our_own_locks();
  test_who_called_decides();
  test_functions_without_a_name_at_the_end_of_unlocking();
  test_functions_without_a_name_of_a_node();
  test_functions_of_the_c_library_that_take_locks();
  test_before_a_wake();
  test_which_frame_threw();
  test_libraries_of_nodes();
  return 0;
}
