#include "overrides/handle_ledger.hpp"

#include <rcl/client.h>
#include <rcl/error_handling.h>
#include <rcl/logging_rosout.h>
#include <rcl/publisher.h>
#include <rcl/service.h>
#include <rcl/subscription.h>

#include <exception>
#include <new>

namespace play_launch {
namespace {

void forget_error(rcl_ret_t result) noexcept {
  if (result != RCL_RET_OK) {
    rcl_reset_error();  // it stays on the network; there is no channel to report it
  }
}

}  // namespace

struct HandleLedger::Entry {
  const HandleKind kind;
  void* const handle;
  rcl_node_t* const node;
  std::atomic<Entry*> older;
  bool logs = false;

  void give_back(const WithLoggingLock& with_logging_lock) const noexcept;
  void give_back_node(const WithLoggingLock& with_logging_lock) const noexcept;
};

void HandleLedger::Entry::give_back(const WithLoggingLock& with_logging_lock) const noexcept {
  switch (kind) {
    case HandleKind::publisher:
      forget_error(rcl_publisher_fini(static_cast<rcl_publisher_t*>(handle), node));
      break;
    case HandleKind::subscription:
      forget_error(rcl_subscription_fini(static_cast<rcl_subscription_t*>(handle), node));
      break;
    case HandleKind::service:
      forget_error(rcl_service_fini(static_cast<rcl_service_t*>(handle), node));
      break;
    case HandleKind::client:
      forget_error(rcl_client_fini(static_cast<rcl_client_t*>(handle), node));
      break;
    case HandleKind::node:
      give_back_node(with_logging_lock);
      break;
  }
}

void HandleLedger::Entry::give_back_node(const WithLoggingLock& with_logging_lock) const noexcept {
  if (logs) {
    // The table has pointers into the node: that must not go before its place there is given up.
    const auto leave_table = [this] {
      forget_error(rcl_logging_rosout_fini_publisher_for_node(node));
    };
    try {
      if (!with_logging_lock(leave_table)) {
        return;
      }
    } catch (const std::exception&) {
      return;
    }
  }
  forget_error(rcl_node_fini(node));
}

HandleLedger::~HandleLedger() { clear(); }

void HandleLedger::clear() noexcept {
  const Entry* entry = newest_.exchange(nullptr);
  while (entry != nullptr) {
    const Entry* const older = entry->older;
    delete entry;
    entry = older;
  }
}

HandleLedger::Watch::Watch(HandleLedger& ledger) : ledger_(ledger) {
  const std::lock_guard lock(ledger_.mutex_);
  ledger_.watching_ = true;
}

HandleLedger::Watch::~Watch() {
  const std::lock_guard lock(ledger_.mutex_);
  ledger_.watching_ = false;
  ledger_.clear();
}

void HandleLedger::opened(HandleKind kind, void* handle, const rcl_node_t* node) noexcept {
  const std::lock_guard lock(mutex_);
  if (!watching_) {
    return;
  }
  auto* const node_of_it = const_cast<rcl_node_t*>(node);
  Entry* const entry = new (std::nothrow) Entry{kind, handle, node_of_it, newest_.load()};
  if (entry != nullptr) {  // else this one stays, should the process die
    newest_ = entry;
  }
}

void HandleLedger::logs(const rcl_node_t* node) noexcept {
  const std::lock_guard lock(mutex_);
  for (Entry* entry = newest_; entry != nullptr; entry = entry->older) {
    if (entry->handle == node) {
      entry->logs = true;
    }
  }
}

void HandleLedger::closed(const void* handle) noexcept {
  const std::lock_guard lock(mutex_);
  std::atomic<Entry*>* place = &newest_;
  while (Entry* const entry = *place) {
    if (entry->handle == handle) {
      *place = entry->older.load();
      delete entry;
      return;
    }
    place = &entry->older;
  }
}

void HandleLedger::for_each_node(const std::function<void(rcl_node_t&)>& visit) const {
  for (const Entry* entry = newest_; entry != nullptr; entry = entry->older) {
    if (entry->kind == HandleKind::node) {
      visit(*entry->node);
    }
  }
}

void HandleLedger::give_back(const WithLoggingLock& with_logging_lock) noexcept {
  for (const Entry* entry = newest_; entry != nullptr; entry = entry->older) {
    entry->give_back(with_logging_lock);
  }
  clear();
}

}  // namespace play_launch
