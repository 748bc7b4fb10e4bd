#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <play_launch/detail/waitable.hpp>

namespace play_launch {

/// Calls back periodically by the steady clock. Periods that were missed because the executor was
/// busy are skipped, the phase is kept. Lives as long as an owner holds it.
class Timer final : public Waitable {
 public:
  /// Use Node::create_timer. A period of zero is always due; a negative one throws
  /// std::invalid_argument.
  Timer(std::chrono::nanoseconds period, std::function<void()> callback,
        std::shared_ptr<CallbackGroup> group, Logger logger);

  /// Stops calling back until reset(). A callback that runs already is not interrupted.
  void cancel();
  [[nodiscard]] bool cancelled() const;
  /// Starts anew: the next call is one period from now.
  void reset();
  /// Changes the period and starts anew.
  void reset(std::chrono::nanoseconds period);
  [[nodiscard]] std::chrono::nanoseconds period() const;

  Work take() override;

 private:
  mutable std::mutex mutex_;
  std::chrono::nanoseconds period_;
  Clock::time_point due_;
  bool cancelled_ = false;
  const std::shared_ptr<const std::function<void()>> callback_;
};

}  // namespace play_launch
