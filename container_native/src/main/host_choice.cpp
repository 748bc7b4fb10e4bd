#include "main/host_choice.hpp"

#include <utility>

#include "base/report.hpp"
#include "components/native_backend.hpp"
#include "hosts/cloned/cloned_host.hpp"
#include "hosts/shared/shared_executor_host.hpp"
#include "hosts/spawned/process_host.hpp"
#include "isolation/clone/gate.hpp"
#include "isolation/memory/protection_keys.hpp"
#ifdef PLAY_LAUNCH_RCLCPP
#include "components/rclcpp/backend.hpp"
#include "components/rclcpp/runtime.hpp"
#endif

namespace play_launch::container {

namespace {

/// Null: private memory is ordinary memory.
std::shared_ptr<MemoryDomains> choose_domains(DomainChoice choice,
                                              std::vector<std::string>& notes) {
  if (choice == DomainChoice::off) {
    return nullptr;
  }
  if (isolation::has_protection_keys()) {
    notes.emplace_back("private memory has protection keys");
    return std::make_shared<MemoryDomains>(choice);
  }
  const std::string why =
      "this processor, or this kernel, has no memory protection keys (PKU; \"ospke\" among the "
      "flags "
      "in /proc/cpuinfo)";
  if (choice == DomainChoice::required) {
    throw isolation::MechanismUnavailable("memory_domains: required, but " + why +
                                          "; use memory_domains: auto, or isolation: process");
  }
  notes.push_back(why + ": private memory of nodes is ordinary memory (memory_domains: auto)");
  report(notes.back());
  return nullptr;
}

}  // namespace

HostChoice choose_host(const Options& options, const ExecutorChoice& executor,
                       BackendList backends) {
  HostChoice choice;
  if (!options.isolated) {
    choice.host = std::make_unique<SharedExecutorHost>(std::move(backends), executor);
    return choice;
  }
  // Once for all containers of the process: trials at the same time would wait for each other.
  static const isolation::Facts machine = isolation::look_at_machine();
  isolation::Gate gate = isolation::choose_mechanism(options.isolation, machine);
  for (const std::string& note : gate.notes) {
    report(note);
  }
  choice.mechanism = isolation::mechanism_name(gate.mechanism);
  choice.notes = std::move(gate.notes);
  if (!gate.limit.empty()) {
    choice.notes.push_back(gate.limit);
    if (options.core_dumps) {
      report("core_dumps: no effect; " + gate.limit);
    }
  }
  if (gate.mechanism == isolation::Mechanism::shared_memory) {
    auto domains = choose_domains(options.memory_domains, choice.notes);
    choice.host = std::make_unique<CloneIsolatedHost>(std::move(backends), executor,
                                                      options.core_dumps, std::move(domains));
  } else {
    choice.host = std::make_unique<ProcessHost>(std::move(backends), executor, options.core_dumps,
                                                options.ros_arguments);
  }
  return choice;
}

BackendList make_backends(int argc, const char* const* argv) {
#ifdef PLAY_LAUNCH_RCLCPP
  return make_backends(rclcpp_backend::initialise(argc, argv));
#else
  return make_backends(Context::create(argc, argv));
#endif
}

BackendList make_backends(const std::shared_ptr<Context>& context) {
  std::vector<std::unique_ptr<ComponentBackend>> backends;
  backends.push_back(std::make_unique<NativeBackend>(context));
#ifdef PLAY_LAUNCH_RCLCPP
  backends.push_back(std::make_unique<rclcpp_backend::RclcppBackend>(context));
#endif
  return BackendList(std::move(backends));
}

std::vector<std::string> backend_names() {
#ifdef PLAY_LAUNCH_RCLCPP
  return {"native", "rclcpp"};
#else
  return {"native"};
#endif
}

}  // namespace play_launch::container
