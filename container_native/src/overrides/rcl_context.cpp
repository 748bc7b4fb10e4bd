#include "overrides/rcl_context.hpp"

#include <link.h>
#include <rcl/init.h>
#include <unistd.h>

#include <atomic>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/detail/running_node.hpp>
#include <utility>

#include "base/elf.hpp"
#include "base/next_function.hpp"
#include "isolation/record/child_record.hpp"

namespace play_launch {
namespace {

/// The context that is guarded; null: none is.
std::atomic<Context*> guarded{nullptr};

const NextFunction<"rcl_shutdown", rcl_ret_t(rcl_context_t*)> next_rcl_shutdown;

/// The library that the code belongs to, without the loader's lock.
std::string library_of(const void* code) {
  const link_map* const library = library_at(reinterpret_cast<std::uintptr_t>(code));
  const std::string path = library != nullptr ? library->l_name : "";
  // The last call of a function leaves nothing of it on the stack: then it is the function that
  // starts threads.
  const bool is_known = !path.empty() && path.find("/libstdc++.so") == std::string::npos &&
                        path.find("/libc.so") == std::string::npos;
  return is_known ? "a thread in " + path : "a thread that no executor knows";
}

bool decide(pid_t container, const ContextGuard::OnShutdown& on_shutdown, const void* caller) {
  if (const isolation::ChildRecord* const child = isolation::current_child()) {
    child->program->end_itself();
    return false;
  }
  if (::getpid() != container) {
    return true;  // forked: the context is a copy of its own
  }
  const std::string node = detail::RunningNode::full_name();
  on_shutdown(node.empty() ? library_of(caller) : node);
  return false;
}

}  // namespace

ContextGuard::ContextGuard(std::shared_ptr<Context> context, OnShutdown on_shutdown)
    : context_(std::move(context)) {
  detail::ContextAccess::guard_shutdown(
      *context_, [container = ::getpid(), on_shutdown = std::move(on_shutdown)](
                     const void* caller) { return decide(container, on_shutdown, caller); });
  guarded = context_.get();
}

ContextGuard::~ContextGuard() {
  guarded = nullptr;
  detail::ContextAccess::guard_shutdown(*context_, nullptr);
}

}  // namespace play_launch

/// Instead of librcl's, for the whole program: the executable exports its symbols, so libraries
/// find this one first.
extern "C" [[gnu::visibility("default")]] rcl_ret_t rcl_shutdown(rcl_context_t* context) {
  play_launch::Context* const ours = play_launch::guarded;
  if (ours != nullptr && ours->rcl() == context &&
      !play_launch::detail::ContextAccess::may_shut_down(*ours, __builtin_return_address(0))) {
    return RCL_RET_OK;
  }
  return play_launch::next_rcl_shutdown.get()(context);
}
