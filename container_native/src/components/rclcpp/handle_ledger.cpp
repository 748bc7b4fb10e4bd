#include "components/rclcpp/handle_ledger.hpp"

#include <rcl/client.h>
#include <rcl/error_handling.h>
#include <rcl/logging_rosout.h>
#include <rcl/publisher.h>
#include <rcl/service.h>
#include <rcl/subscription.h>

#include <algorithm>
#include <mutex>
#include <rclcpp/node_interfaces/node_base.hpp>
#include <rclcpp/node_options.hpp>
#include <utility>

namespace play_launch::rclcpp_backend {
namespace {

// Without a destructor, which would not be run when the thread dies.
constinit thread_local HandleLedger* current_ledger = nullptr;

std::mutex discarded_mutex;
std::vector<rcl_node_t*> discarded_nodes;  // whose process died in the constructor

void forget_error(rcl_ret_t result) noexcept {
  if (result != RCL_RET_OK) {
    rcl_reset_error();  // it stays on the network; nobody is there to be told
  }
}

/// Has finalise_discarded_nodes() called by somebody who holds the lock for logging: only rclcpp
/// itself can take it, and does so for the logger of a new node.
void borrow_logging_lock() noexcept {
  try {
    const rclcpp::NodeOptions options = rclcpp::NodeOptions().use_global_arguments(false);
    const rclcpp::node_interfaces::NodeBase node("_undertaker", "", options.context(),
                                                 *options.get_rcl_node_options(), false, false,
                                                 nullptr);
  } catch (const std::exception&) {
    // The next node that is made does it.
  }
}

}  // namespace

class HandleLedger::Entry final : public Discardable {
 public:
  Entry(HandleKind kind, void* handle, const rcl_node_t* node)
      : kind_(kind), handle_(handle), node_(const_cast<rcl_node_t*>(node)) {
    enter_ledger();
  }
  ~Entry() { leave_ledger(); }

  const void* handle() const { return handle_; }

 private:
  void discard() noexcept override {
    switch (kind_) {
      case HandleKind::publisher:
        forget_error(rcl_publisher_fini(static_cast<rcl_publisher_t*>(handle_), node_));
        break;
      case HandleKind::subscription:
        forget_error(rcl_subscription_fini(static_cast<rcl_subscription_t*>(handle_), node_));
        break;
      case HandleKind::service:
        forget_error(rcl_service_fini(static_cast<rcl_service_t*>(handle_), node_));
        break;
      case HandleKind::client:
        forget_error(rcl_client_fini(static_cast<rcl_client_t*>(handle_), node_));
        break;
      case HandleKind::node: {
        {
          const std::lock_guard lock(discarded_mutex);
          discarded_nodes.push_back(node_);
        }
        borrow_logging_lock();
        break;
      }
    }
  }

  const HandleKind kind_;
  void* const handle_;
  rcl_node_t* const node_;
};

HandleLedger::HandleLedger() { current_ledger = this; }

HandleLedger::~HandleLedger() { current_ledger = nullptr; }

// The ledger is on the stack of the constructor. Should the process die there, nobody takes its
// address back, but Construction::discard() has ended the watch before it finalises anything.
HandleLedger* HandleLedger::current() noexcept {
  return Construction::is_watched() ? current_ledger : nullptr;
}

void HandleLedger::opened(HandleKind kind, void* handle, const rcl_node_t* node) {
  closed(handle);  // some of rcl's functions call others of them
  entries_.push_back(std::make_unique<Entry>(kind, handle, node));
}

void HandleLedger::closed(const void* handle) noexcept {
  std::erase_if(entries_, [handle](const auto& entry) { return entry->handle() == handle; });
}

HandleLedger::Pause::Pause() noexcept : before_(current_ledger) { current_ledger = nullptr; }

HandleLedger::Pause::~Pause() { current_ledger = before_; }

void finalise_discarded_nodes() noexcept {
  std::vector<rcl_node_t*> nodes;
  {
    const std::lock_guard lock(discarded_mutex);
    nodes.swap(discarded_nodes);
  }
  for (rcl_node_t* const node : nodes) {
    const rcl_node_options_t* const options = rcl_node_get_options(node);
    if (options != nullptr && options->enable_rosout) {
      forget_error(rcl_logging_rosout_fini_publisher_for_node(node));
    }
    forget_error(rcl_node_fini(node));
  }
}

}  // namespace play_launch::rclcpp_backend
