#pragma once

#include <unistd.h>

#include <memory>
#include <mutex>
#include <optional>
#include <play_launch/node.hpp>
#include <string>
#include <utility>
#include <vector>

#include "base/process.hpp"
#include "components/backend_list.hpp"
#include "isolation/crash/own_crash.hpp"
#include "main/control_interface.hpp"
#include "main/options.hpp"
#include "main/ros_interface.hpp"
#include "main/stop.hpp"
#include "manager/component_manager.hpp"

namespace play_launch::container {

/// What the containers of one process have in common.
struct SharedParts {
  explicit SharedParts(BackendList list) : backends(std::move(list)) {}

  const ProcessIdentity process = identity_of(::getpid());
  /// The context of all nodes, and the libraries that are open.
  const BackendList backends;
  /// Ends the process; null where the process has more containers, which must survive.
  Watchdog* watchdog = nullptr;
  std::once_flag type_supports_known;
};

/// One container: puts its parts together, waits until it is asked to stop, and takes them apart
/// again.
class Container {
 public:
  /// `arguments`: ROS arguments of its own node, besides those of the process. Throws
  /// std::exception when something that it needs is not to be had.
  Container(const Options& options, SharedParts& shared, StopRequests& stop,
            UniqueFd control_socket, const std::vector<std::string>& arguments);
  ~Container();
  Container(const Container&) = delete;
  Container& operator=(const Container&) = delete;

  struct End {
    int status = 0;
    /// False: something of it is still used, or holds a lock that exit handlers wait for. Then the
    /// process may end with leave_now() only.
    bool in_order = true;
    /// A node died with a lock that others wait for.
    bool is_poisoned = false;
  };
  /// Returns once it was asked to stop and is done. Nodes that do not leave are left behind.
  End run();

 private:
  ExecutorChoice choose_executor();
  play_launch_msgs::msg::ControlHello hello(std::size_t threads,
                                            std::vector<std::string> backends) const;
  ComponentEvent own_crash(const isolation::CrashSlot& slot) const;
  void end_process_by(SteadyTime deadline, int status, const std::string& what);
  void stop_nodes();
  void report_remaining() const;

  const Options options_;
  SharedParts& shared_;
  StopRequests& stop_;
  std::optional<ControlInterface> control_;
  std::shared_ptr<Node> node_;
  std::unique_ptr<NodeHost> host_;
  std::unique_ptr<ObservableComponentManager> manager_;
  std::unique_ptr<RosInterface> ros_;
  std::optional<isolation::OwnCrashWatch> crash_watch_;
};

}  // namespace play_launch::container
