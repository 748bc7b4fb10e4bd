#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <play_launch/context.hpp>
#include <play_launch/node.hpp>
#include <string>
#include <vector>

#include "components/component_backend.hpp"
#include "isolation/crash/own_crash.hpp"
#include "main/control_interface.hpp"
#include "main/options.hpp"
#include "main/ros_interface.hpp"
#include "main/stop.hpp"
#include "manager/component_manager.hpp"
#include "overrides/rcl_context.hpp"

namespace play_launch::container {

/// The whole container: puts its parts together, waits until it is asked to stop, and takes them
/// apart again.
class ContainerProcess {
 public:
  /// Throws std::exception when something that it needs is not to be had.
  ContainerProcess(const Options& options, int argc, const char* const* argv,
                   UniqueFd control_socket);
  ~ContainerProcess();

  /// Returns the exit status once it was asked to stop and is done; does not return when something
  /// cannot be taken apart, but ends the process with that status.
  int run();

 private:
  void start(int argc, const char* const* argv);
  ExecutorChoice choose_executor();
  play_launch_msgs::msg::ControlHello hello(std::size_t threads,
                                            std::vector<std::string> backends) const;
  void on_context_shutdown(const std::string& caller);
  ComponentEvent own_crash(const isolation::CrashSlot& slot) const;
  void stop_nodes();
  void report_remaining() const;

  const Options options_;
  const ProcessIdentity process_;
  StopRequests stop_;
  Watchdog watchdog_;
  std::optional<ControlInterface> control_;
  std::once_flag shut_down_by_node_;
  std::string why_stopping_;  // set before the stop is requested; empty: it was requested
  std::shared_ptr<Context> context_;
  std::optional<ContextGuard> context_guard_;
  std::shared_ptr<Node> node_;
  std::unique_ptr<NodeHost> host_;
  std::unique_ptr<ObservableComponentManager> manager_;
  std::unique_ptr<RosInterface> ros_;
  std::optional<isolation::OwnCrashWatch> crash_watch_;
};

}  // namespace play_launch::container
