#pragma once

#include <memory>
#include <string>
#include <vector>

#include "components/backend_list.hpp"
#include "hosts/node_host.hpp"
#include "main/options.hpp"

namespace play_launch::container {

/// The host that was chosen, and why.
struct HostChoice {
  std::unique_ptr<NodeHost> host;
  std::string mechanism;           // see play_launch_msgs/ControlHello
  std::vector<std::string> notes;  // "
};

/// The host for the mode that `options` ask for, with executors as `executor` says. Notes are
/// reported too. Throws isolation::MechanismUnavailable when a mechanism was demanded that does not
/// work here.
HostChoice choose_host(const Options& options, const ExecutorChoice& executor,
                       BackendList backends);

/// Every backend that this program was built with, and one context for all of them. `argv` is the
/// command line. Throws std::exception. Once per process.
BackendList make_backends(int argc, const char* const* argv);

/// Every backend, with a context from the other function, or null: then they can find libraries and
/// open them, but make no nodes.
BackendList make_backends(const std::shared_ptr<Context>& context);

/// Their names, for people and for the hello.
std::vector<std::string> backend_names();

}  // namespace play_launch::container
