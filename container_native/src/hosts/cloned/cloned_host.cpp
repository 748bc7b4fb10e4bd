#include "hosts/cloned/cloned_host.hpp"

#include <utility>

#include "components/component_options.hpp"
#include "hosts/cloned/cloned_node.hpp"
#include "isolation/crash/crash_handler.hpp"

namespace play_launch::container {

CloneIsolatedHost::CloneIsolatedHost(BackendList backends, const ExecutorChoice& choice,
                                     bool core_dumps, std::shared_ptr<MemoryDomains> domains)
    : IsolatedHost(std::move(backends)),
      choice_(choice),
      core_dumps_(core_dumps),
      domains_(std::move(domains)) {
  // Before any library of a node is loaded: what is there now belongs to the container.
  isolation::prepare_crash_handling();
}

std::shared_ptr<IsolatedNode> CloneIsolatedHost::start(std::uint64_t unique_id, LoadRequest request,
                                                       NodeResources resources, int doorbell) {
  if (request.lock_memory) {
    throw LoadError("lock_memory is not for a node that shares the memory of its container");
  }
  auto domain = domains_ ? domains_->make(expected_full_name(request).value_or(request.plugin_name))
                         : nullptr;
  return std::make_shared<ClonedNode>(unique_id, backends(), choice_, std::move(request),
                                      std::move(resources), watch_urgency(), doorbell, lock_watch_,
                                      core_dumps_, std::move(domain), domains_.get());
}

}  // namespace play_launch::container
