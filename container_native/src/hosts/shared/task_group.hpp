#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>

namespace play_launch::container {

/// Short-lived threads that are joined together at the end.
///
/// A finished thread is joined by the next one that finishes, so that at most one of them is left
/// over however many have run.
class TaskGroup {
 public:
  TaskGroup() = default;
  TaskGroup(const TaskGroup&) = delete;
  TaskGroup& operator=(const TaskGroup&) = delete;
  /// Waits for all tasks.
  ~TaskGroup();

  /// Runs `task` in a thread of its own, named `name` (at most 15 characters).
  /// Throws std::system_error when there is no thread to be had; then `task` does not run.
  void run(const std::string& name, std::function<void()> task);

 private:
  void finish(std::uint64_t number);

  std::mutex mutex_;
  std::map<std::uint64_t, std::thread> running_;
  std::thread finished_;
  std::uint64_t last_number_ = 0;
};

}  // namespace play_launch::container
