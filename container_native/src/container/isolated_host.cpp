#include "container/isolated_host.hpp"

#include <poll.h>
#include <pthread.h>

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include "container/doorbell.hpp"
#include "isolation/crash_handler.hpp"

namespace play_launch::container {

using Clock = std::chrono::steady_clock;

CloneIsolatedHost::CloneIsolatedHost(std::vector<std::unique_ptr<ComponentBackend>> backends,
                                     const ExecutorChoice& choice)
    : backends_(std::move(backends)), choice_(choice), doorbell_(make_doorbell()) {
  isolation::prepare_crash_handling();
  monitor_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "monitor");
    monitor();
  });
}

CloneIsolatedHost::~CloneIsolatedHost() {
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  ring(doorbell_.get());
  monitor_.join();
}

void CloneIsolatedHost::load(std::uint64_t unique_id, LoadRequest request) {
  // The lock is held until the node is in the map: the monitor would miss its first ring.
  const std::lock_guard lock(mutex_);
  nodes_.emplace(unique_id, std::make_shared<IsolatedNode>(unique_id, backends_, choice_,
                                                           std::move(request), doorbell_.get()));
}

void CloneIsolatedHost::unload(std::uint64_t unique_id) {
  const std::lock_guard lock(mutex_);
  const auto found = nodes_.find(unique_id);
  if (found != nodes_.end()) {  // else it has just died
    found->second->leave();
  }
}

void CloneIsolatedHost::stop_spinning() {
  const std::lock_guard lock(mutex_);
  for (const auto& [unique_id, node] : nodes_) {
    node->leave();
  }
}

void CloneIsolatedHost::hurry(std::chrono::steady_clock::time_point deadline) {
  {
    const std::lock_guard lock(mutex_);
    end_ = std::min(end_, deadline);
  }
  ring(doorbell_.get());
}

HostTotals CloneIsolatedHost::totals() const {
  return {totals_.crashes, totals_.undertaken, totals_.leaked, totals_.unquiesced};
}

void CloneIsolatedHost::monitor() {
  while (true) {
    const Time next = look_after_all();
    {
      const std::lock_guard lock(mutex_);
      if (done_ && nodes_.empty()) {
        return;
      }
    }
    wait_until(next);
  }
}

CloneIsolatedHost::Time CloneIsolatedHost::look_after_all() {
  std::vector<std::pair<std::uint64_t, std::shared_ptr<IsolatedNode>>> nodes;
  Time end;
  {
    // Not held during the calls of the observer, which may call back.
    const std::lock_guard lock(mutex_);
    nodes.assign(nodes_.begin(), nodes_.end());
    end = end_;
  }
  Time next = Time::max();
  for (auto& [unique_id, node] : nodes) {
    node->tell(*observer_, totals_);
    next = std::min(next, node->press(Clock::now(), end));
    if (node->is_over()) {
      std::unique_lock lock(mutex_);
      nodes_.erase(unique_id);
      lock.unlock();
      node.reset();  // joins its donor
    }
  }
  return next;
}

void CloneIsolatedHost::wait_until(Time deadline) {
  int timeout_ms = -1;
  if (deadline != Time::max()) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
    timeout_ms = static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, 1'000'000));
  }
  pollfd fd{doorbell_.get(), POLLIN, 0};
  if (::poll(&fd, 1, timeout_ms) > 0) {
    hush(doorbell_.get());
  }
}

}  // namespace play_launch::container
