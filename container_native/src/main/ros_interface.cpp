#include "main/ros_interface.hpp"

#include <pthread.h>

#include <chrono>
#include <exception>
#include <string>
#include <utility>

#include "base/process.hpp"

namespace play_launch::container {
namespace {

constexpr std::size_t kEventDepth = 100;
/// A supervised container offers its services kOthers after its first loads are over, or after
/// kFirstLoads. Containers that start together load until about the same time.
constexpr std::chrono::seconds kFirstLoads{4};
constexpr std::chrono::seconds kOthers{1};

bool ends_the_load(const ComponentEvent& event) {
  return event.event_type != ComponentEvent::LOADING;
}

bool ends_the_node(const ComponentEvent& event) {
  return ends_the_load(event) && event.event_type != ComponentEvent::LOADED;
}

LoadRequest request_of(const composition_interfaces::srv::LoadNode::Request& message) {
  LoadRequest request;
  request.package_name = message.package_name;
  request.plugin_name = message.plugin_name;
  request.node_name = message.node_name;
  request.node_namespace = message.node_namespace;
  request.log_level = message.log_level;
  request.remap_rules = message.remap_rules;
  request.parameters = message.parameters;
  request.extra_arguments = message.extra_arguments;
  return request;
}

/// A client that went away, or a context that was shut down, must not end the container.
template <class Action>
void try_to(const Logger& logger, const char* what, Action action) {
  try {
    action();
  } catch (const std::exception& error) {
    PLAY_LAUNCH_WARN(logger, "failed to %s: %s", what, error.what());
  }
}

}  // namespace

RosInterface::RosInterface(std::shared_ptr<Node> node, ObservableComponentManager& manager,
                           bool supervised)
    : node_(std::move(node)), manager_(manager), supervised_(supervised) {
  if (!supervised_) {
    offer();
  }
  manager_.add_sink(*this);
  deliverer_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "events");
    grow_heap();
    if (supervised_ && !offer_after_first_loads()) {
      return;
    }
    deliver_loop();
  });
}

void RosInterface::offer() {
  events_ = node_->create_publisher<ComponentEvent>("~/_container/component_events",
                                                    QoS(kEventDepth).reliable().transient_local());
  load_service_ = node_->create_service<LoadNode>(
      "~/_container/load_node", [this](PendingLoad pending) { load(std::move(pending)); });
  unload_service_ = node_->create_service<UnloadNode>(
      "~/_container/unload_node", [this](PendingUnload pending) { unload(std::move(pending)); });
  list_service_ = node_->create_service<ListNodes>(
      "~/_container/list_nodes",
      [this](const ListNodes::Request&, ListNodes::Response& response) { list(response); });
  node_->start_parameter_services();
  executor_.add_node(node_);
  spinner_ = std::thread([this] {
    ::pthread_setname_np(::pthread_self(), "manager");
    executor_.spin();
  });
}

bool RosInterface::offer_after_first_loads() {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, kFirstLoads,
                    [this] { return leaving_ || (has_loaded_ && loading_.empty()); });
  if (changed_.wait_for(lock, kOthers, [this] { return leaving_; })) {
    return false;
  }
  offering_ = true;
  lock.unlock();
  bool offered = true;
  try {
    offer();
  } catch (const std::exception& error) {
    offered = false;
    PLAY_LAUNCH_ERROR(node_->logger(), "this container offers no services: %s", error.what());
  }
  lock.lock();
  offering_ = false;
  changed_.notify_all();
  return offered;
}

RosInterface::~RosInterface() {
  {
    std::unique_lock lock(mutex_);
    leaving_ = true;
    changed_.notify_all();
    changed_.wait(lock, [this] { return !offering_; });
  }
  if (spinner_.joinable()) {
    executor_.cancel();
    spinner_.join();
    executor_.remove_node(node_);
  }
  manager_.remove_sink(*this);
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  changed_.notify_all();
  deliverer_.join();
}

void RosInterface::load(PendingLoad pending) {
  const auto refusal =
      manager_.load(request_of(pending->request()), [this, &pending](std::uint64_t unique_id) {
        const std::lock_guard lock(mutex_);
        loads_.emplace(unique_id, pending);
      });
  if (refusal) {
    LoadNode::Response response;
    response.success = false;
    response.error_message = *refusal;
    try_to(node_->logger(), "answer load_node", [&] { pending->respond(std::move(response)); });
  }
}

void RosInterface::unload(PendingUnload pending) {
  const std::uint64_t unique_id = pending->request().unique_id;
  const auto refusal = manager_.unload(unique_id, [this, &pending](std::uint64_t accepted) {
    const std::lock_guard lock(mutex_);
    unloads_.emplace(accepted, pending);
  });
  if (refusal) {
    UnloadNode::Response response;
    response.success = false;
    response.error_message = *refusal;
    try_to(node_->logger(), "answer unload_node", [&] { pending->respond(std::move(response)); });
  }
}

void RosInterface::list(ListNodes::Response& response) {
  for (const NodeSnapshot& snapshot : manager_.nodes()) {
    if (snapshot.entry.state == NodeState::loaded) {
      response.full_node_names.push_back(snapshot.entry.full_name);
      response.unique_ids.push_back(snapshot.entry.unique_id);
    }
  }
}

void RosInterface::on_event(const ComponentEvent& event) {
  {
    const std::lock_guard lock(mutex_);
    if (ends_the_load(event)) {
      loading_.erase(event.unique_id);
    } else {
      has_loaded_ = true;
      loading_.insert(event.unique_id);
    }
    // An event that an answer depends on is never dropped; there are at most as many as
    // requests that wait.
    const bool awaited = loads_.contains(event.unique_id) || unloads_.contains(event.unique_id);
    if (queue_.size() >= kQueueCapacity && !awaited) {
      ++dropped_;
      return;
    }
    queue_.push_back(event);
  }
  changed_.notify_all();
}

void RosInterface::deliver_loop() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return done_ || !queue_.empty(); });
    if (queue_.empty()) {
      return;
    }
    const ComponentEvent event = std::move(queue_.front());
    queue_.pop_front();
    const std::uint64_t dropped = std::exchange(dropped_, 0);
    lock.unlock();
    if (dropped > 0) {
      PLAY_LAUNCH_WARN(node_->logger(), "%lu events were too many for %s",
                       static_cast<unsigned long>(dropped), events_->topic().c_str());
    }
    deliver(event);
    lock.lock();
  }
}

void RosInterface::deliver(const ComponentEvent& event) {
  if (!supervised_) {
    log(event);
  }
  try_to(node_->logger(), "publish an event", [&] { events_->publish(event); });
  if (ends_the_load(event)) {
    answer_load(event);
  }
  if (ends_the_node(event)) {
    answer_unloads(event);
  }
}

void RosInterface::log(const ComponentEvent& event) const {
  const char* const name =
      event.full_node_name.empty() ? "a node without a name yet" : event.full_node_name.c_str();
  const auto unique_id = static_cast<unsigned long>(event.unique_id);
  const char* const plugin = event.plugin_name.c_str();
  const char* const why = event.error_message.c_str();
  switch (event.event_type) {
    case ComponentEvent::LOADING:
      PLAY_LAUNCH_DEBUG(node_->logger(), "loading %s (%s, unique_id %lu)", name, plugin, unique_id);
      return;
    case ComponentEvent::LOADED:
      PLAY_LAUNCH_INFO(node_->logger(), "loaded %s (%s, unique_id %lu)", name, plugin, unique_id);
      return;
    case ComponentEvent::UNLOADED:
      PLAY_LAUNCH_INFO(node_->logger(), "unloaded %s (%s, unique_id %lu)%s%s", name, plugin,
                       unique_id, *why == '\0' ? "" : ": ", why);
      return;
    case ComponentEvent::LOAD_FAILED:
      PLAY_LAUNCH_ERROR(node_->logger(), "failed to load %s (%s, unique_id %lu): %s", name, plugin,
                        unique_id, why);
      return;
    default:
      PLAY_LAUNCH_ERROR(node_->logger(), "%s (%s, unique_id %lu) died: %s", name, plugin, unique_id,
                        why);
  }
}

void RosInterface::answer_load(const ComponentEvent& event) {
  PendingLoad pending;
  {
    const std::lock_guard lock(mutex_);
    auto found = loads_.extract(event.unique_id);
    if (found.empty()) {
      return;
    }
    pending = std::move(found.mapped());
  }
  LoadNode::Response response;
  response.success = event.event_type == ComponentEvent::LOADED;
  if (response.success) {
    response.full_node_name = event.full_node_name;
    response.unique_id = event.unique_id;
  } else {
    response.error_message = event.error_message;
  }
  try_to(node_->logger(), "answer load_node", [&] { pending->respond(std::move(response)); });
}

void RosInterface::answer_unloads(const ComponentEvent& event) {
  std::vector<PendingUnload> waiting;
  {
    const std::lock_guard lock(mutex_);
    const auto [first, last] = unloads_.equal_range(event.unique_id);
    for (auto each = first; each != last; ++each) {
      waiting.push_back(std::move(each->second));
    }
    unloads_.erase(first, last);
  }
  for (const PendingUnload& pending : waiting) {
    UnloadNode::Response response;
    response.success = true;
    try_to(node_->logger(), "answer unload_node", [&] { pending->respond(std::move(response)); });
  }
}

}  // namespace play_launch::container
