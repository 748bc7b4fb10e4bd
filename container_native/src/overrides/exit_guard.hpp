#pragma once

namespace play_launch::isolation {

/// exit_guard.cpp defines exit(), quick_exit(), abort(), pthread_exit() and pthread_cancel() for
/// the whole program: the executable exports its symbols, so libraries find these before the C
/// library's. In a child, exit() and quick_exit() note the status in the slot, quiesce its threads
/// and end the child alone, without the container's atexit handlers and destructors. What would end
/// a child's first thread does the same with status 0: pthread_exit() in it, and pthread_cancel()
/// of it in any thread of the child. Everywhere else they do what they always do.

/// What exit() and quick_exit() call first where they end the container itself, with their name;
/// null: nothing.
void set_exit_hook(void (*hook)(const char* call)) noexcept;

}  // namespace play_launch::isolation
