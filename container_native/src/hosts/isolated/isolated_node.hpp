#pragma once

#include <fcntl.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "base/process.hpp"
#include "base/resource_setting.hpp"
#include "base/scheduling.hpp"
#include "base/unique_fd.hpp"
#include "components/component_options.hpp"
#include "hosts/isolated/node_life.hpp"
#include "hosts/node_host.hpp"

namespace play_launch::container {

/// How a node's process is made to leave: it is asked, then gets SIGTERM, then SIGKILL. Pure: whose
/// process it is and how it is asked is the caller's business.
class LeavePressure {
 public:
  using Time = std::chrono::steady_clock::time_point;
  enum class Action { none, ask, terminate, kill };

  /// From being asked to SIGTERM, and from there to SIGKILL, unless all must end earlier.
  static constexpr std::chrono::seconds kTerminateAfter{1};
  static constexpr std::chrono::seconds kKillAfter{2};

  /// It is to leave, from `now` on. Only the first call counts.
  void begin(Time now);
  bool begun() const { return since_ != Time::max(); }

  /// What is to be done now, once each; `end` is when it must be gone (max: whenever).
  Action next(Time now, Time end);

  /// When to call next() again; max: never.
  Time due(Time end) const;

 private:
  struct Limits {
    Time terminate;
    Time kill;
  };
  Limits limits(Time end) const;

  Time since_ = Time::max();
  Action last_ = Action::none;
};

/// One node in a process of its own, and what remains to be done about it. All but leave() and
/// silence() is for one thread, the monitor's.
class IsolatedNode {
 public:
  using Time = LeavePressure::Time;

  /// `event_fd` is an eventfd that is notified when there is something new to report.
  IsolatedNode(std::uint64_t unique_id, int event_fd)
      : unique_id_(unique_id), event_fd_(event_fd) {}
  IsolatedNode(const IsolatedNode&) = delete;
  IsolatedNode& operator=(const IsolatedNode&) = delete;
  virtual ~IsolatedNode() = default;

  /// Asks the node to leave. Any thread.
  void leave() noexcept;

  /// Reports what has happened since the last call.
  void follow(NodeHostObserver& observer);

  /// Does what is due for a node that should leave, and returns when to come again (max: not by
  /// itself). `end`: when it must be gone (max: whenever).
  Time press(Time now, Time end);

  /// Whether the node's processes are gone for good, and everything is reported.
  bool is_over() const { return has_all(seen_, NodeLife::finished); }

  /// How long its executor has not come round; nothing: that is not known. Any thread.
  virtual std::optional<std::chrono::nanoseconds> silence() const { return std::nullopt; }

  /// What hangs in the middleware, in words; empty: nothing that is known. By one thread at a time.
  virtual std::string hang() { return ""; }

  /// Has the container's threads that belong to this node alone run that urgently. Any thread.
  virtual void rise(Urgency urgency) noexcept { static_cast<void>(urgency); }

  /// Becomes readable when follow() should be called, besides the event_fd; -1 without one.
  virtual int watched_fd() const { return -1; }

 protected:
  /// What has happened so far. Does what is to be done between two calls of the observer.
  virtual NodeLife look() = 0;
  virtual const LoadRequest& request() const = 0;
  /// From NodeLife::constructing on.
  virtual ProcessIdentity process() const = 0;
  /// Full name; empty before NodeLife::spinning.
  virtual std::string full_name() const = 0;
  /// Why loading failed; with NodeLife::failed.
  virtual std::string failure() const = 0;
  /// Why it left, if that was not requested; with NodeLife::left.
  virtual std::string why_it_left() const = 0;
  /// Once, with NodeLife::died.
  virtual NodeDeath death() = 0;
  /// Once, with NodeLife::died and NodeLife::finished: whether nothing of the node is left.
  virtual bool is_cleaned_up() = 0;
  /// The death is reported: what is done about it may begin.
  virtual void on_death_reported() {}
  virtual void ask_to_leave() = 0;
  /// False: it has no process, as long as its library is being opened.
  virtual bool signal(int number) = 0;
  /// It is dead, and there is no time left for what is done about it.
  virtual void abandon() {}

  std::uint64_t unique_id() const { return unique_id_; }
  int event_fd() const { return event_fd_; }
  /// For messages to people.
  std::string label() const;

 private:
  void make(LifeCall call, NodeHostObserver& observer);

  const std::uint64_t unique_id_;
  const int event_fd_;
  std::atomic<bool> leaving_{false};
  LeavePressure pressure_;
  NodeLife seen_ = NodeLife::preparing;  // when follow() last looked
  LifeCalls calls_;
};

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
