// An executor whose thread was killed at any place where it held a lock holds up neither
// its notifiers nor the cleanup.
#include <dlfcn.h>
#include <pthread.h>
#include <unistd.h>

#include <atomic>

#include <play_launch/detail/context_access.hpp>
#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;

namespace {

/// After how many more locks a thread that takes some vanishes; 0: never.
thread_local int locks_to_live = 0;
std::atomic<bool> vanished{false};

}  // namespace

/// Instead of the C library's, for the whole program: what the SDK locks arrives here.
extern "C" int pthread_mutex_lock(pthread_mutex_t* mutex) {
  static const auto next =
      reinterpret_cast<int (*)(pthread_mutex_t*)>(::dlsym(RTLD_NEXT, "pthread_mutex_lock"));
  const int result = next(mutex);
  if (locks_to_live > 0 && --locks_to_live == 0) {
    vanished = true;
    while (true) pause();
  }
  return result;
}

namespace {

void test_vanishing(const std::shared_ptr<Context>& context, int locks) {
  // Never destroyed: the vanished thread refers to them.
  auto* executor = new SingleThreadedExecutor();
  auto node = std::make_shared<Node>("vanishing", options_in(context));
  auto timer = node->create_timer(std::chrono::milliseconds(1), [locks] {
    if (locks_to_live == 0) locks_to_live = locks;
  });
  executor->add_node(node);
  std::thread([executor] { executor->spin(); }).detach();
  CHECK(eventually([] { return vanished.load(); }));

  // A producer of news for the node, like a thread of the middleware.
  std::atomic<bool> notified{false};
  std::thread([&notified, timer] {
    timer->notify(0);
    notified = true;
  }).detach();
  CHECK(eventually([&notified] { return notified.load(); }));

  // The cleanup.
  executor->cancel();
  play_launch::detail::ExecutorAccess::abandon(*executor);
  executor->remove_node(node);
  const std::weak_ptr<Timer> gone = timer;
  timer.reset();
  node.reset();
  CHECK(eventually([&gone] { return gone.expired(); }));
  delete executor;
  vanished = false;
}

}  // namespace

int main() {
  const auto context = make_context();
  constexpr int kLocksOfSomeTurns = 12;
  for (int locks = 1; locks <= kLocksOfSomeTurns; ++locks) test_vanishing(context, locks);
  std::fflush(nullptr);
  std::_Exit(0);
}
