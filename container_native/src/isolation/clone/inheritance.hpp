#pragma once

#include "isolation/record/crash_slot.hpp"

namespace play_launch::isolation {

/// On a donor, after the death of the child that wrote the slot: gives back what the allocator
/// keeps for its threads that were at rest, where it has a function for that
/// (allocator_thread_done()). Without this, each thread that dies leaves its heap behind. And
/// forgets their values of pthread_key_create()'s keys: the C library gives the stack of a joined
/// thread, with these, to another one, whose end would give the same heap back once more. Done in a
/// child of its own with a time limit, which speaks for one dead thread after the other; before
/// the threads' stacks are freed, in which the C library keeps their thread-local storage.
/// True: all that could be was given back. Neither allocates nor takes a lock.
bool give_back_heaps(const CrashSlot& slot) noexcept;

using ThreadDone = void (*)();

/// mimalloc's function that leaves the calling thread's memory to the surviving threads; null with
/// another allocator. Async-signal-safe.
ThreadDone allocator_thread_done();

}  // namespace play_launch::isolation
