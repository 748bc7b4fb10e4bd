#pragma once

#include <composition_interfaces/srv/list_nodes.hpp>
#include <composition_interfaces/srv/load_node.hpp>
#include <composition_interfaces/srv/unload_node.hpp>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <play_launch/executor.hpp>
#include <play_launch/node.hpp>
#include <set>
#include <thread>
#include <vector>

#include "manager/component_manager.hpp"

namespace play_launch::container {

/// The public side of the container: the composition services and the topic of events, on the
/// container's own node. It has an executor of its own, so that no component can keep it busy, and
/// a thread that publishes and answers, so that the middleware cannot keep the manager busy.
class RosInterface final : public EventSink {
 public:
  /// Events that wait to be published. More are dropped and counted; a caller that waits for a
  /// service's answer still gets it.
  static constexpr std::size_t kQueueCapacity = 4096;

  /// `supervised`: a supervisor gets the events over the control channel and reports them, so that
  /// the log need not. Then everything is offered some time after the first loads: a topic and nine
  /// services in each container, which all others must discover, would compete with the nodes for
  /// which all callers wait. Events since the start are published nevertheless.
  RosInterface(std::shared_ptr<Node> node, ObservableComponentManager& manager, bool supervised);
  /// Publishes what is queued.
  ~RosInterface() override;

  void on_event(const ComponentEvent& event) override;

 private:
  using LoadNode = composition_interfaces::srv::LoadNode;
  using UnloadNode = composition_interfaces::srv::UnloadNode;
  using ListNodes = composition_interfaces::srv::ListNodes;
  using PendingLoad = std::shared_ptr<PendingRequest<LoadNode>>;
  using PendingUnload = std::shared_ptr<PendingRequest<UnloadNode>>;

  void offer();
  /// Returns false when there is nothing to publish on.
  bool offer_after_first_loads();
  void load(PendingLoad pending);
  void unload(PendingUnload pending);
  void list(ListNodes::Response& response);
  void deliver_loop();
  void deliver(const ComponentEvent& event);
  void log(const ComponentEvent& event) const;
  void answer_load(const ComponentEvent& event);
  void answer_unloads(const ComponentEvent& event);

  const std::shared_ptr<Node> node_;
  ObservableComponentManager& manager_;
  const bool supervised_;
  std::shared_ptr<Publisher<ComponentEvent>> events_;
  std::shared_ptr<Service<LoadNode>> load_service_;
  std::shared_ptr<Service<UnloadNode>> unload_service_;
  std::shared_ptr<Service<ListNodes>> list_service_;

  std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  std::deque<ComponentEvent> queue_;
  std::uint64_t dropped_ = 0;
  std::set<std::uint64_t> loading_;
  bool has_loaded_ = false;
  bool offering_ = false;
  bool leaving_ = false;
  bool done_ = false;
  std::map<std::uint64_t, PendingLoad> loads_;  // by unique_id
  std::multimap<std::uint64_t, PendingUnload> unloads_;

  SingleThreadedExecutor executor_;
  std::thread spinner_;
  std::thread deliverer_;
};

}  // namespace play_launch::container
