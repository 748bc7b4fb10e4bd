#pragma once

namespace play_launch::isolation {

using ThreadDone = void (*)();

/// mimalloc's function that leaves the calling thread's memory to the surviving threads; null with
/// another allocator. Async-signal-safe.
ThreadDone allocator_thread_done();

}  // namespace play_launch::isolation
