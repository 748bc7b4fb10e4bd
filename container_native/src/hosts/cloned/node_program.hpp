#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <play_launch/detail/stop_flag.hpp>
#include <string>

#include "components/backend_list.hpp"
#include "components/component_options.hpp"
#include "hosts/isolated/node_life.hpp"
#include "isolation/record/child_record.hpp"
#include "overrides/handle_ledger.hpp"

namespace play_launch::container {

/// The life of one isolated node, from its constructor to its destructor, as run in a child. The
/// child notes how far it is in atomics and notifies an eventfd. The locks of the container that it
/// takes all the same are listed in docs/isolation.md.
class NodeProgram final : public isolation::ChildProgram {
 public:
  /// What is referred to must outlive the child; `event_fd` is an eventfd.
  NodeProgram(const BackendList& backends, const ExecutorChoice& choice, LoadRequest request,
              int event_fd);
  /// What a dead child left is not destroyed here, see NodeCleanup.
  ~NodeProgram() override;

  /// On the donor, before the child: finds the component and waits until its library is open.
  /// False: there is nothing to run; it failed or left.
  bool prepare(std::uint64_t unique_id) noexcept;
  /// On the donor, when there is no child to be had.
  void fail(std::string reason) noexcept;
  /// In the child, or on the donor without a child: this has happened. Notifies.
  void reach(NodeLife part) noexcept;

  int run() override;
  void cancel() noexcept override { stop_->set(); }
  void crashed() noexcept override;
  void end_itself() noexcept override;
  HandleLedger* handles() noexcept override { return &handles_; }

  NodeLife life() const { return life_.so_far(); }
  /// How long its executor has not come round; nothing: before it spins, or when that is not known.
  std::optional<std::chrono::nanoseconds> silence() const;
  /// When the oldest take from the middleware began that is under way; 0: none, or not known.
  std::int64_t oldest_take() const;
  /// Its own code asked for its end.
  bool ends_itself() const { return ends_itself_.load(); }
  /// Name of the node; from NodeLife::spinning on.
  const std::string& full_name() const { return full_name_; }
  /// Why loading failed; with NodeLife::failed.
  const std::string& failure() const { return failure_; }
  const LoadRequest& request() const { return request_; }

  /// Whether there was anything of a node when the child died.
  bool left_remains() const { return partial_ || executor_ != nullptr; }

 private:
  friend class NodeCleanup;

  void live();
  void take_apart();

  const BackendList& backends_;
  const ExecutorChoice choice_;
  const LoadRequest request_;
  const int event_fd_;

  BackendList::Found found_;
  const std::shared_ptr<detail::StopFlag> stop_ = std::make_shared<detail::StopFlag>();
  std::unique_ptr<ComponentExecutor> executor_;
  std::unique_ptr<Component> component_;
  HandleLedger handles_;
  /// Something is being constructed or destroyed: dead now, it could not be destroyed.
  bool partial_ = false;
  std::string full_name_;
  std::string failure_;
  LifeRecord life_;
  std::atomic<bool> ends_itself_{false};
  Beat beat_;
};

/// Destroys what a dead child left of its node. That runs destructors on a state that may be
/// broken: in a child of its own, with a time limit.
class NodeCleanup final : public isolation::ChildProgram {
 public:
  explicit NodeCleanup(NodeProgram& dead) : dead_(dead) {}

  int run() override;
  void cancel() noexcept override {}

 private:
  void give_back_handles();
  void remove_from_executor();

  NodeProgram& dead_;
};

}  // namespace play_launch::container
