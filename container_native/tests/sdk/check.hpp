#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <memory>
#include <mutex>
#include <play_launch/component.hpp>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "../isolation/check.hpp"

namespace play_launch::testing {

/// Far longer than anything takes; only a failing test waits that long.
inline constexpr std::chrono::seconds kLimit{20};

/// A value that other threads change and the test waits for.
template <class T>
class Watched {
 public:
  explicit Watched(T value = {}) : value_(std::move(value)) {}

  /// Changes the value.
  template <class F>
  void change(F&& function) {
    {
      const std::lock_guard lock(mutex_);
      function(value_);
    }
    changed_.notify_all();
  }
  void set(T value) {
    change([&value](T& mine) { mine = std::move(value); });
  }
  [[nodiscard]] T get() const {
    const std::lock_guard lock(mutex_);
    return value_;
  }
  /// Waits until the predicate holds; false when it did not within the limit.
  template <class F>
  [[nodiscard]] bool reaches(F&& predicate, std::chrono::nanoseconds limit = kLimit) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, limit, [&] { return predicate(value_); });
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  T value_;
};

class Counter : public Watched<int> {
 public:
  void increment() {
    change([](int& value) { ++value; });
  }
  [[nodiscard]] bool reaches_at_least(int wanted) {
    return reaches([wanted](int value) { return value >= wanted; });
  }
};

/// Spins an executor in a thread of its own for as long as the object lives. To be declared after
/// everything that callbacks touch.
class Spinner {
 public:
  explicit Spinner(Executor& executor)
      : executor_(executor), thread_([&executor] { executor.spin(); }) {}
  ~Spinner() {
    executor_.cancel();
    thread_.join();
  }
  Spinner(const Spinner&) = delete;
  Spinner& operator=(const Spinner&) = delete;

 private:
  Executor& executor_;
  std::thread thread_;
};

inline std::shared_ptr<Context> make_context(std::vector<std::string> arguments = {}) {
  setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", 0);
  std::vector<const char*> argv{"test"};
  for (const auto& argument : arguments) argv.push_back(argument.c_str());
  return Context::create(static_cast<int>(argv.size()), argv.data());
}

inline NodeOptions options_in(std::shared_ptr<Context> context) {
  NodeOptions options;
  options.context = std::move(context);
  options.start_parameter_services = false;
  return options;
}

/// For conditions of the middleware that no event announces: asks again every millisecond.
inline bool eventually(const std::function<bool()>& condition) {
  const auto deadline = std::chrono::steady_clock::now() + kLimit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace play_launch::testing
