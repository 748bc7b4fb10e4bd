#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "base/process.hpp"
#include "base/unique_fd.hpp"

namespace play_launch::container {

using SteadyTime = std::chrono::steady_clock::time_point;

/// Why the container stops.
/// `context`: code of a node shut the ROS context down.
enum class StopCause { none, signal, shutdown, closed, protocol_error, context };

/// Collects what asks a container to stop, and lets one thread wait for it. Signals count for each
/// object of the process, and wake the one that handles them.
class StopRequests {
 public:
  StopRequests();
  StopRequests(const StopRequests&) = delete;
  StopRequests& operator=(const StopRequests&) = delete;

  /// SIGINT, SIGTERM and SIGHUP (unless it is ignored, as under nohup) ask to stop; the third of
  /// them ends the process at once. SIGPIPE does nothing. For one object of the process.
  void handle_signals();

  /// Asks to stop; the first cause stays, and with it `why`, which goes with the end of each node.
  /// Any thread.
  void request(StopCause cause, const std::string& why = "");
  /// Ends the current wait() without asking for anything. Any thread.
  void wake();

  /// Waits for a request, signal or wake(), or until the deadline. Spurious returns are possible.
  void wait(SteadyTime deadline = SteadyTime::max());

  /// Signals count as a cause too.
  StopCause cause() const;
  /// Empty: the stop was requested.
  std::string why() const;
  /// Number of requests: a signal or a request each count 1.
  int times_asked() const;

 private:
  const UniqueFd event_;
  mutable std::mutex mutex_;  // guards why_
  std::string why_;
  std::atomic<StopCause> cause_{StopCause::none};
  std::atomic<int> requests_{0};
};

/// Ends the process when a stop takes too long, whatever its other threads are stuck in.
class Watchdog {
 public:
  Watchdog();
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;
  ~Watchdog();

  /// From `deadline` on the process ends with `exit_code`, after a line on stderr that says `what`
  /// was not done in time. A later deadline than the one in force is ignored.
  void arm(SteadyTime deadline, int exit_code, const std::string& what);

 private:
  void watch();

  std::mutex mutex_;
  std::condition_variable changed_;
  SteadyTime deadline_ = SteadyTime::max();
  int exit_code_ = 0;
  std::string what_;
  bool done_ = false;
  std::thread thread_;
};

/// A supervisor that is gone cannot clean up after us: see kOrphanGrace. For all nodes, and for
/// all.
inline constexpr auto kOrphanStopLimit = kOrphanGrace - std::chrono::milliseconds(250);
inline constexpr auto kOrphanLifeLimit = kOrphanGrace - std::chrono::milliseconds(100);
/// For taking a container itself apart, after its nodes.
inline constexpr std::chrono::seconds kTeardownLimit{1};

/// Ends the process at once with this status, without destructors and handlers, but not without
/// taking its shared memory segments out of the file system, which would stay there.
/// Async-signal-safe.
[[noreturn]] void leave_now(int exit_code) noexcept;

/// Exit statuses of the container (sysexits.h where it has one).
inline constexpr int kExitOk = 0;
inline constexpr int kExitFailed = 1;
inline constexpr int kExitUsage = 64;
inline constexpr int kExitProtocol = 70;
/// A node shut down the ROS context that it shares with the others.
inline constexpr int kExitContext = 79;

}  // namespace play_launch::container
