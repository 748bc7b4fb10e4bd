#include "main/host_choice.hpp"

#include <utility>

#include "base/report.hpp"
#include "hosts/cloned/cloned_host.hpp"
#include "hosts/shared/shared_executor_host.hpp"
#include "hosts/spawned/process_host.hpp"
#include "isolation/clone/gate.hpp"

namespace play_launch::container {

HostChoice choose_host(const Options& options, const ExecutorChoice& executor,
                       BackendList backends) {
  HostChoice choice;
  if (!options.isolated) {
    choice.host = std::make_unique<SharedExecutorHost>(std::move(backends), executor);
    return choice;
  }
  isolation::Gate gate =
      isolation::choose_mechanism(options.isolation, isolation::look_at_machine());
  for (const std::string& note : gate.notes) {
    report(note);
  }
  choice.mechanism = isolation::mechanism_name(gate.mechanism);
  choice.notes = std::move(gate.notes);
  if (gate.mechanism == isolation::Mechanism::shared_memory) {
    choice.host =
        std::make_unique<CloneIsolatedHost>(std::move(backends), executor, options.core_dumps);
  } else {
    choice.host = std::make_unique<ProcessHost>(std::move(backends), executor, options.core_dumps,
                                                options.ros_arguments);
  }
  return choice;
}

}  // namespace play_launch::container
