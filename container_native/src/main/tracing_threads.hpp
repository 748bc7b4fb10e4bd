#pragma once

#include <signal.h>

#include <cstddef>

namespace play_launch::container {

/// The threads of LTTng, which ROS's tracepoints bring into every process before main(). They wait
/// for a session daemon; LTTng has functions that put them to rest around a fork and start them
/// anew in the child.
class TracingThreads {
 public:
  static constexpr std::size_t kCount = 2;

  TracingThreads();
  /// Whether that library is loaded.
  bool are_there() const;
  void before_fork();
  /// In the parent.
  void after_fork();
  void in_child();

 private:
  using Function = void (*)(sigset_t*);
  Function before_ = nullptr;
  Function after_ = nullptr;
  Function in_child_ = nullptr;
  sigset_t mask_{};
};

}  // namespace play_launch::container
