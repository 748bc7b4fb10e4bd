#pragma once

#include <fcntl.h>

#include <atomic>
#include <vector>

#include "base/resource_setting.hpp"
#include "base/unique_fd.hpp"
#include "base/urgency.hpp"
#include "components/load_request.hpp"

namespace play_launch::container {

/// What an isolated node's process asks of the kernel.
struct NodeResources {
  /// `container`: what the process has without asking. Throws std::invalid_argument.
  NodeResources(const LoadRequest& request, Urgency container)
      : settings(parse_resource_settings(request.resources)),
        urgency(urgency_after(container, settings)) {}

  std::vector<ResourceSetting> settings;
  Urgency urgency;

  /// The control group among the settings, open for a process to be born in; none, or it is not
  /// there.
  UniqueFd open_group() const {
    for (const ResourceSetting& setting : settings) {
      if (setting.kind == ResourceSetting::Kind::cgroup) {
        return UniqueFd(::open(setting.folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
      }
    }
    return UniqueFd();
  }
};

/// How urgently the threads of the container run that report on its nodes and clean up after them:
/// more so than any of these. It only ever rises.
using WatchUrgency = std::atomic<Urgency>;
static_assert(WatchUrgency::is_always_lock_free);

}  // namespace play_launch::container
