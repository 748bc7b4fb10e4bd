#include <linux/futex.h>
#include <rcl/error_handling.h>
#include <rcl/init.h>
#include <rcl/init_options.h>
#include <rcl/logging.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <ctime>
#include <play_launch/context.hpp>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/detail/intra_process.hpp>
#include <play_launch/detail/stop_flag.hpp>
#include <play_launch/error.hpp>
#include <utility>

namespace play_launch {
namespace {

/// Logging belongs to the process: the first context configures it, the last one ends it.
std::mutex logging_mutex;
std::size_t logging_users = 0;

void begin_logging(const rcl_context_t& context) {
  const std::lock_guard lock(logging_mutex);
  if (logging_users == 0) {
    const rcl_allocator_t allocator = rcl_get_default_allocator();
    throw_unless_ok(rcl_logging_configure(&context.global_arguments, &allocator),
                    "configure logging");
  }
  ++logging_users;
}

void end_logging() noexcept {
  const std::lock_guard lock(logging_mutex);
  if (--logging_users == 0 && rcl_logging_fini() != RCL_RET_OK) rcl_reset_error();
}

}  // namespace

Context::Context()
    : own_(rcl_get_zero_initialized_context()), hub_(std::make_unique<IntraProcessHub>()) {}

std::shared_ptr<Context> Context::create(int argc, const char* const* argv) {
  std::shared_ptr<Context> context(new Context());
  rcl_init_options_t options = rcl_get_zero_initialized_init_options();
  throw_unless_ok(rcl_init_options_init(&options, rcl_get_default_allocator()),
                  "prepare the options of a context");
  const rcl_ret_t initialised = rcl_init(argc, argv, &options, &context->own_);
  if (initialised != RCL_RET_OK) {
    // What it says is of interest, not what follows.
    const RclError error("initialise a context", initialised);
    if (rcl_init_options_fini(&options) != RCL_RET_OK) rcl_reset_error();
    throw error;
  }
  if (rcl_init_options_fini(&options) != RCL_RET_OK) rcl_reset_error();
  context->context_ = &context->own_;
  begin_logging(context->own_);
  context->owns_logging_ = true;
  return context;
}

std::shared_ptr<Context> detail::ContextAccess::borrow(rcl_context_t* context) {
  if (context == nullptr || !rcl_context_is_valid(context)) {
    throw RclError("borrow a context that is not initialised", RCL_RET_INVALID_ARGUMENT);
  }
  std::shared_ptr<Context> borrower(new Context());
  borrower->context_ = context;
  return borrower;
}

Context::~Context() {
  end();
  if (context_ == &own_ && rcl_context_fini(&own_) != RCL_RET_OK) rcl_reset_error();
  if (owns_logging_) end_logging();
}

bool Context::ok() const noexcept { return context_ != nullptr && rcl_context_is_valid(context_); }

void Context::shutdown() {
  if (detail::ContextAccess::may_shut_down(*this, __builtin_return_address(0))) end();
}

void detail::ContextAccess::guard_shutdown(Context& context, ShutdownGuard guard) {
  const std::lock_guard lock(context.mutex_);
  context.guard_ = std::move(guard);
}

bool detail::ContextAccess::may_shut_down(Context& context, const void* caller) {
  ShutdownGuard guard;
  {
    const std::lock_guard lock(context.mutex_);
    guard = context.guard_;
  }
  return !guard || guard(caller);
}

void Context::end() {
  std::vector<std::weak_ptr<detail::StopFlag>> stops;
  {
    const std::lock_guard lock(mutex_);
    if (shut_down_) return;
    shut_down_ = true;
    stops.swap(stops_);
  }
  if (context_ == &own_ && rcl_shutdown(&own_) != RCL_RET_OK) rcl_reset_error();
  for (const auto& weak : stops) {
    if (const auto stop = weak.lock()) stop->set();
  }
}

IntraProcessHub& detail::ContextAccess::intra_process(Context& context) noexcept {
  return *context.hub_;
}

void detail::ContextAccess::stop_on_shutdown(Context& context,
                                             const std::shared_ptr<StopFlag>& stop) {
  {
    const std::lock_guard lock(context.mutex_);
    if (!context.shut_down_) {
      std::erase_if(context.stops_, [&stop](const auto& known) {
        const auto alive = known.lock();
        return alive == nullptr || alive == stop;
      });
      context.stops_.push_back(stop);
      return;
    }
  }
  stop->set();
}

namespace {

std::string explain(const std::string& doing) {
  std::string text = "failed to " + doing;
  if (rcl_error_is_set()) {
    text += ": ";
    text += rcl_get_error_string().str;
    rcl_reset_error();
  }
  return text;
}

}  // namespace

RclError::RclError(const std::string& doing, rcl_ret_t code)
    : std::runtime_error(explain(doing)), code_(code) {}

void throw_unless_ok(rcl_ret_t code, const std::string& doing) {
  if (code != RCL_RET_OK) throw RclError(doing, code);
}

ParameterTypeError::ParameterTypeError(const std::string& name, const std::string& expected,
                                       const std::string& given)
    : ParameterError("parameter '" + name + "' has the wrong type: expected " + expected +
                     ", given " + given) {}

ParameterNotDeclared::ParameterNotDeclared(const std::string& name)
    : ParameterError("parameter '" + name + "' has not been declared") {}

ParameterAlreadyDeclared::ParameterAlreadyDeclared(const std::string& name)
    : ParameterError("parameter '" + name + "' has been declared already") {}

ParameterRejected::ParameterRejected(const std::string& name, const std::string& reason)
    : ParameterError("the node refused the value of parameter '" + name + "': " + reason) {}

}  // namespace play_launch

namespace play_launch::detail {

static_assert(std::atomic<std::uint32_t>::is_always_lock_free &&
              sizeof(std::atomic<std::uint32_t>) == sizeof(std::uint32_t));

void Doorbell::ring(int waiters) noexcept {
  rings_.fetch_add(1);
  if (waiters_.load() == 0) return;
  const int error = errno;  // of what a signal handler that rings interrupted
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&rings_), FUTEX_WAKE_PRIVATE, waiters,
          nullptr, nullptr, 0);
  errno = error;
}

void Doorbell::wait(std::uint32_t seen, Nanoseconds deadline) noexcept {
  constexpr Nanoseconds kSecond = 1'000'000'000;
  timespec until{};
  const timespec* timeout = nullptr;
  if (deadline != kNever) {
    const Nanoseconds at = deadline < 0 ? 0 : deadline;
    until.tv_sec = at / kSecond;
    until.tv_nsec = at % kSecond;
    timeout = &until;
  }
  waiters_.fetch_add(1);
  // The bitset form takes an absolute time, by CLOCK_MONOTONIC.
  syscall(SYS_futex, reinterpret_cast<std::uint32_t*>(&rings_), FUTEX_WAIT_BITSET_PRIVATE, seen,
          timeout, nullptr, FUTEX_BITSET_MATCH_ANY);
  waiters_.fetch_sub(1);
}

void StopFlag::wait() noexcept {
  while (true) {
    const auto seen = doorbell_.rings();
    if (is_set()) return;
    doorbell_.wait(seen);
  }
}

}  // namespace play_launch::detail
