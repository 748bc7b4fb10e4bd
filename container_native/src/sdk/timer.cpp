#include <play_launch/timer.hpp>
#include <stdexcept>
#include <utility>

namespace play_launch {

Timer::Timer(std::chrono::nanoseconds period, std::function<void()> callback,
             std::shared_ptr<CallbackGroup> group, Logger logger)
    : Waitable(Readiness::timed, std::move(group), std::move(logger)),
      period_(period),
      due_(Clock::now() + period),
      callback_(std::make_shared<const std::function<void()>>(std::move(callback))) {
  if (period < std::chrono::nanoseconds::zero()) {
    throw std::invalid_argument("timer: the period is negative");
  }
  set_due(due_);
}

void Timer::cancel() {
  const std::lock_guard lock(mutex_);
  cancelled_ = true;
  set_due(Clock::time_point::max());
}

bool Timer::cancelled() const {
  const std::lock_guard lock(mutex_);
  return cancelled_;
}

void Timer::reset() { reset(period()); }

void Timer::reset(std::chrono::nanoseconds period) {
  if (period < std::chrono::nanoseconds::zero()) {
    throw std::invalid_argument("timer: the period is negative");
  }
  {
    const std::lock_guard lock(mutex_);
    cancelled_ = false;
    period_ = period;
    due_ = Clock::now() + period;
    set_due(due_);
  }
  notify(0);
}

std::chrono::nanoseconds Timer::period() const {
  const std::lock_guard lock(mutex_);
  return period_;
}

Work Timer::take() {
  const std::lock_guard lock(mutex_);
  const auto now = Clock::now();
  if (cancelled_ || now < due_) return Work();
  if (period_ == std::chrono::nanoseconds::zero()) {
    due_ = now;
  } else {
    due_ += ((now - due_) / period_ + 1) * period_;
  }
  set_due(due_);
  return Work([callback = callback_] { (*callback)(); });
}

}  // namespace play_launch
