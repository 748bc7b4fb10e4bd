#include <play_launch/detail/waitable.hpp>
#include <utility>

#include "ready_queue.hpp"

namespace play_launch {

Waitable::Waitable(Readiness readiness, std::shared_ptr<CallbackGroup> group, Logger logger)
    : group_(std::move(group)),
      logger_(std::move(logger)),
      token_(std::make_shared<WakeToken>(readiness == Readiness::timed, group_)) {}

Waitable::~Waitable() {
  token_->retired.store(true);
  if (token_->timed) token_->notify(0);  // it may be among an executor's timers
}

void Waitable::notify(std::size_t events) noexcept { token_->notify(events); }

void Waitable::set_due(Clock::time_point due) noexcept {
  token_->due.store(
      due == Clock::time_point::max()
          ? kNever
          : std::chrono::duration_cast<std::chrono::nanoseconds>(due.time_since_epoch()).count());
}

}  // namespace play_launch
