#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <play_launch/context.hpp>
#include <string>
#include <thread>
#include <vector>

#include "base/unique_fd.hpp"
#include "main/container.hpp"
#include "main/options.hpp"
#include "main/stop.hpp"
#include "overrides/rcl_context.hpp"

namespace play_launch::container {

/// Environment variable with the number of the socket that containers of a process are requested
/// on, each by one datagram: the descriptor of its control channel, and a text of parts that end
/// with NUL, which are a number and the container's command line without the program. When that
/// container has ended, a datagram back says "NUMBER STATUS STATE": `gone`, `left` (something of it
/// is still there) or `poisoned` (with a lock that the other containers need).
inline constexpr const char* kContainersVariable = "PLAY_LAUNCH_CONTAINERS_FD";

/// The process of one container, or of several isolated ones with one ROS context.
class Process {
 public:
  /// Throws std::exception when something that it needs is not to be had.
  Process(const Options& options, int argc, const char* const* argv);

  /// Runs the container that the command line describes. Returns the exit status once it was asked
  /// to stop and is done; does not return when something cannot be taken apart, but ends the
  /// process with that status.
  int run_one(UniqueFd control_socket);

  /// Runs the containers that are requested on this socket, up to the end of it. Returns as the
  /// other.
  int run_many(UniqueFd requests);

 private:
  /// A container and its thread.
  struct Hosted {
    StopRequests stop;
    std::thread thread;
    std::optional<Container::End> end;  // guarded by mutex_
  };
  struct Request;

  void on_context_shutdown(const std::string& caller);
  void take_requests();
  void begin(Request request);
  void run(Hosted& hosted, Request request);
  bool are_done();
  void stop_all();

  const Options options_;
  StopRequests stop_;
  Watchdog watchdog_;
  std::once_flag shut_down_by_node_;
  SharedParts shared_;
  std::optional<ContextGuard> context_guard_;

  UniqueFd requests_;
  std::mutex mutex_;  // guards what follows
  std::vector<std::unique_ptr<Hosted>> hosted_;
};

}  // namespace play_launch::container
