#include "hosts/shared/shared_executor_host.hpp"

#include <pthread.h>
#include <unistd.h>

#include <chrono>
#include <play_launch/detail/running_node.hpp>
#include <string>
#include <utility>

#include "base/failpoints.hpp"
#include "base/process.hpp"
#include "components/component_options.hpp"

namespace play_launch::container {

SharedExecutorHost::SharedExecutorHost(BackendList backends, const ExecutorChoice& choice)
    : process_(identity_of(::getpid())), backends_(std::move(backends)) {
  spinners_.reserve(backends_.size());
  for (std::size_t i = 0; i < backends_.size(); ++i) {
    auto stop = std::make_shared<detail::StopFlag>();
    std::unique_ptr<ComponentExecutor> executor = backends_[i].create_executor(choice, stop);
    ComponentExecutor* const spinning = executor.get();
    std::thread thread([spinning] {
      ::pthread_setname_np(::pthread_self(), "executor");
      spinning->spin();
    });
    spinners_.push_back({std::move(stop), std::move(executor), std::move(thread)});
  }
}

SharedExecutorHost::~SharedExecutorHost() {
  stop_spinning();
  for (Spinner& spinner : spinners_) {
    spinner.thread.join();
  }
}

void SharedExecutorHost::load(std::uint64_t unique_id, LoadRequest request) {
  if (!request.resources.empty() || request.lock_memory) {
    throw LoadError(
        "resources are for isolated nodes: the nodes of this container share a process");
  }
  run("load-" + std::to_string(unique_id),
      [this, unique_id, request = std::move(request)] { construct(unique_id, request); });
}

void SharedExecutorHost::unload(std::uint64_t unique_id) {
  run("unload-" + std::to_string(unique_id), [this, unique_id] { destroy(unique_id); });
}

void SharedExecutorHost::run(const std::string& name, std::function<void()> task) {
  const std::lock_guard lock(tasks_mutex_);
  std::erase_if(tasks_, [](const std::future<void>& known) {
    return known.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  });
  tasks_.push_back(std::async(std::launch::async, [name, task = std::move(task)]() noexcept {
    ::pthread_setname_np(::pthread_self(), name.c_str());
    grow_heap();
    task();
  }));
}

void SharedExecutorHost::stop_spinning() {
  for (Spinner& spinner : spinners_) {
    spinner.stop->set();
  }
}

void SharedExecutorHost::construct(std::uint64_t unique_id, const LoadRequest& request) {
  clockid_t cpu_clock = CLOCK_THREAD_CPUTIME_ID;
  // Another thread reads it, for which the generic id of "this thread" would be its own.
  ::pthread_getcpuclockid(::pthread_self(), &cpu_clock);
  observer_->on_constructing(unique_id, process_, cpu_clock);
  hit(Failpoint::before_construct);
  Node node;
  try {
    const std::optional<std::string> name = expected_full_name(request);
    const detail::RunningNode running(name ? name->c_str() : nullptr);
    const BackendList::Found found = backends_.find(unique_id, request);
    node.executor = spinners_[found.backend].executor.get();
    node.component = found.component_class->create(request);
  } catch (...) {
    observer_->on_load_failed(unique_id, describe_current_exception());
    return;
  }
  hit(Failpoint::after_construct);
  try {
    node.executor->add(*node.component);
  } catch (...) {  // the constructor gave its node to an executor of its own
    const std::string reason = describe_current_exception();
    node.component.reset();
    observer_->on_load_failed(unique_id, reason);
    return;
  }
  const std::string full_name = node.component->full_name();
  {
    // In the map before an unload can be requested.
    const std::lock_guard lock(mutex_);
    nodes_.emplace(unique_id, std::move(node));
  }
  if (!observer_->on_loaded(unique_id, full_name)) {
    destroy(unique_id);
  }
}

void SharedExecutorHost::destroy(std::uint64_t unique_id) {
  hit(Failpoint::before_unload);
  Node node;
  {
    const std::lock_guard lock(mutex_);
    auto handle = nodes_.extract(unique_id);
    if (handle.empty()) {
      return;
    }
    node = std::move(handle.mapped());
  }
  const std::string name = node.component->full_name();
  const detail::RunningNode running(name.c_str());
  node.executor->remove(*node.component);
  node.component.reset();
  observer_->on_gone(unique_id, "");
}

}  // namespace play_launch::container
