#include "hosts/isolated/isolated_host.hpp"

#include <poll.h>
#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <utility>

#include "base/unique_fd.hpp"

namespace play_launch::container {

using Clock = std::chrono::steady_clock;

IsolatedHost::IsolatedHost(BackendList backends)
    : backends_(std::move(backends)), event_fd_(make_eventfd()) {
  monitor_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "monitor");
    {
      const std::lock_guard lock(mutex_);
      monitor_number_ = ::gettid();
      assume(monitor_number_, watch_urgency_);
    }
    monitor();
  });
}

IsolatedHost::~IsolatedHost() {
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  notify_eventfd(event_fd_.get());
  monitor_.join();
}

void IsolatedHost::load(std::uint64_t unique_id, LoadRequest request) {
  // The lock is held until the node is in the map: the monitor would miss its first ring.
  const std::lock_guard lock(mutex_);
  NodeResources resources(request, urgency_);
  rise_above(resources.urgency);
  nodes_.emplace(unique_id,
                 start(unique_id, std::move(request), std::move(resources), event_fd_.get()));
  notify_eventfd(event_fd_.get());
}

/// A node that never leaves its processor must not hold up the threads that report on it and on the
/// others, and clean up after them.
void IsolatedHost::rise_above(Urgency node) {
  if (!is_more_urgent(node, urgency_)) {
    return;
  }
  for (const Urgency wanted : {just_above(node), node}) {
    if (!is_more_urgent(wanted, watch_urgency_)) {
      return;
    }
    // What the monitor may do, the others may, too.
    if (monitor_number_ == 0 || assume(monitor_number_, wanted)) {
      watch_urgency_ = wanted;
      for (const auto& [unique_id, other] : nodes_) {
        other->rise(wanted);
      }
      return;
    }
  }
}

void IsolatedHost::unload(std::uint64_t unique_id) {
  const std::lock_guard lock(mutex_);
  const auto found = nodes_.find(unique_id);
  if (found != nodes_.end()) {  // else it has just died
    found->second->leave();
  }
}

void IsolatedHost::stop_spinning() {
  const std::lock_guard lock(mutex_);
  for (const auto& [unique_id, node] : nodes_) {
    node->leave();
  }
}

void IsolatedHost::end_by(std::chrono::steady_clock::time_point deadline) {
  {
    const std::lock_guard lock(mutex_);
    end_ = std::min(end_, deadline);
  }
  notify_eventfd(event_fd_.get());
}

std::optional<std::chrono::nanoseconds> IsolatedHost::silence(std::uint64_t unique_id) const {
  const std::lock_guard lock(mutex_);
  const auto found = nodes_.find(unique_id);
  return found != nodes_.end() ? found->second->silence() : std::nullopt;
}

std::vector<std::string> IsolatedHost::hangs() const {
  std::vector<std::string> lines;
  const std::lock_guard lock(mutex_);
  for (const auto& [unique_id, node] : nodes_) {
    if (std::string line = node->hang(); !line.empty()) {
      lines.push_back(std::move(line));
    }
  }
  return lines;
}

void IsolatedHost::monitor() {
  while (true) {
    Nodes nodes;
    Time end;
    {
      // Not held during the calls of the observer, which may call back.
      const std::lock_guard lock(mutex_);
      if (done_ && nodes_.empty()) {
        return;
      }
      nodes.assign(nodes_.begin(), nodes_.end());
      end = end_;
    }
    const Time next = look_after(nodes, end);
    wait_until(next, nodes);
  }
}

IsolatedHost::Time IsolatedHost::look_after(Nodes& nodes, Time end) {
  Time next = Time::max();
  for (auto& [unique_id, node] : nodes) {
    node->follow(*observer_);
    next = std::min(next, node->press(Clock::now(), end));
    if (node->is_over()) {
      std::unique_lock lock(mutex_);
      nodes_.erase(unique_id);
      if (done_) {
        next = Time::min();
      }
      lock.unlock();
      node.reset();  // joins its donor, which is over
    }
  }
  return next;
}

void IsolatedHost::wait_until(Time deadline, const Nodes& nodes) const {
  std::vector<pollfd> fds{{event_fd_.get(), POLLIN, 0}};
  for (const auto& [unique_id, node] : nodes) {
    if (node != nullptr && node->watched_fd() >= 0) {
      fds.push_back({node->watched_fd(), POLLIN, 0});
    }
  }
  if (::poll(fds.data(), fds.size(), poll_timeout(deadline)) > 0 && fds[0].revents != 0) {
    clear_eventfd(event_fd_.get());
  }
}

}  // namespace play_launch::container
