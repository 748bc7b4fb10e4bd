#include "components/library_loader.hpp"

#include <dlfcn.h>
#include <pthread.h>

#include <algorithm>

#include "components/open_library.hpp"
#include "components/opening_guard.hpp"
#include "overrides/type_supports.hpp"

namespace play_launch::container {

LibraryLoader::~LibraryLoader() {
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) {
    thread_.join();
  }
}

std::shared_ptr<LibraryLoader::Order> LibraryLoader::order(ComponentBackend& backend,
                                                           const std::string& path,
                                                           const std::string& node) {
  const auto found = std::ranges::find_if(orders_, [&](const std::shared_ptr<Order>& order) {
    return &order->backend == &backend && order->path == path;
  });
  if (found != orders_.end()) {
    return *found;
  }
  if (!thread_.joinable()) {
    thread_ = std::thread([this] { work(); });
  }
  return orders_.emplace_back(std::make_shared<Order>(Order{backend, path, node, false, {}}));
}

const ComponentLibrary& LibraryLoader::open(ComponentBackend& backend, const std::string& path,
                                            std::uint64_t unique_id, const std::string& node) {
  const Key key(&backend, path);
  std::unique_lock lock(mutex_);
  if (const auto found = open_.find(key); found != open_.end()) {
    return *found->second;
  }
  const std::shared_ptr<Order> order = this->order(backend, path, node);
  waiting_.emplace(unique_id, order);
  changed_.notify_all();
  changed_.wait(lock, [&] { return order->done; });
  waiting_.erase(unique_id);
  if (!order->failure.empty()) {
    throw LoadError(order->failure);
  }
  return *open_.at(key);
}

std::string LibraryLoader::opening_for(std::uint64_t unique_id) const {
  const std::lock_guard lock(mutex_);
  return waiting_.contains(unique_id) && !orders_.empty() ? orders_.front()->path : "";
}

void LibraryLoader::work() {
  ::pthread_setname_np(::pthread_self(), "loader");
  const OpeningGuard::Thread guarded;
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return done_ || !orders_.empty(); });
    if (orders_.empty()) {
      return;
    }
    const std::shared_ptr<Order> order = orders_.front();
    lock.unlock();
    carry_out(*order);
    lock.lock();
    orders_.pop_front();
    order->done = true;
    changed_.notify_all();
  }
}

void LibraryLoader::carry_out(Order& order) {
  try {
    const OpeningGuard guard(order.node, order.path);
    std::unique_ptr<ComponentLibrary> library = open_library(order.backend, order.path);
    if (void* const handle = ::dlopen(order.path.c_str(), RTLD_LAZY | RTLD_NOLOAD)) {
      isolation::look_up_type_supports(handle);
      ::dlclose(handle);
    }
    const std::lock_guard lock(mutex_);
    open_.emplace(Key(&order.backend, order.path), std::move(library));
  } catch (...) {
    order.failure = describe_current_exception();
  }
}

}  // namespace play_launch::container
