#pragma once

namespace play_launch::isolation {

using ThreadDone = void (*)();

/// mimalloc's function that gives the calling thread's memory to those who live on; null with
/// another allocator. Async-signal-safe.
ThreadDone allocator_thread_done();

}  // namespace play_launch::isolation
