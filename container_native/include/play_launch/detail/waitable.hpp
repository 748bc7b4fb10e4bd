#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <play_launch/callback_group.hpp>
#include <play_launch/logging.hpp>
#include <utility>

namespace play_launch {

class WakeToken;

/// Something taken and ready to be handed to the user's callback: a callable that is run at most
/// once. Empty when there was nothing to take.
class Work {
 public:
  Work() = default;
  template <class F>
  explicit Work(F&& function)
      : callable_(std::make_unique<Holder<std::decay_t<F>>>(std::forward<F>(function))) {}

  explicit operator bool() const noexcept { return callable_ != nullptr; }
  void operator()() { callable_->call(); }

 private:
  struct Callable {
    virtual ~Callable() = default;
    virtual void call() = 0;
  };
  template <class F>
  struct Holder final : Callable {
    explicit Holder(F&& f) : function(std::move(f)) {}
    explicit Holder(const F& f) : function(f) {}
    void call() override { function(); }
    F function;
  };
  std::unique_ptr<Callable> callable_;
};

/// Base of all that an executor runs callbacks for. A producer of data for it (a thread of the
/// middleware, a publisher of the same process) calls notify(), which costs a few atomic
/// operations; the executor then calls take().
class Waitable {
 public:
  using Clock = std::chrono::steady_clock;

  virtual ~Waitable();
  Waitable(const Waitable&) = delete;
  Waitable& operator=(const Waitable&) = delete;

  /// Takes one message, request or tick, without running user code. Calls for one waitable never
  /// overlap. Throws RclError.
  virtual Work take() = 0;

  [[nodiscard]] const std::shared_ptr<CallbackGroup>& group() const noexcept { return group_; }
  /// The node's logger, for what goes wrong while executing.
  [[nodiscard]] const Logger& logger() const noexcept { return logger_; }
  [[nodiscard]] const std::shared_ptr<WakeToken>& token() const noexcept { return token_; }

  /// Has the executor look; `events` is how many messages are new, as far as known. Any
  /// thread; does not block.
  void notify(std::size_t events = 1) noexcept;

 protected:
  /// When take() may have something without a notification.
  enum class Readiness { notified, timed };
  Waitable(Readiness readiness, std::shared_ptr<CallbackGroup> group, Logger logger);

  /// For timed ones: from when on take() has something; Clock::time_point::max() = never. Takes
  /// effect with the next notification or when take() returns.
  void set_due(Clock::time_point due) noexcept;

 private:
  std::shared_ptr<CallbackGroup> group_;
  Logger logger_;
  std::shared_ptr<WakeToken> token_;
};

}  // namespace play_launch
