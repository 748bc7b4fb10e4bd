#include <rcl/error_handling.h>
#include <rcl/init.h>
#include <rcl/init_options.h>
#include <rcl/logging.h>

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

/// Options for rcl_init, finalised in every case.
class InitOptions {
 public:
  InitOptions() {
    throw_unless_ok(rcl_init_options_init(&options_, rcl_get_default_allocator()),
                    "prepare the options of a context");
  }
  ~InitOptions() {
    if (rcl_init_options_fini(&options_) != RCL_RET_OK) rcl_reset_error();
  }
  InitOptions(const InitOptions&) = delete;
  InitOptions& operator=(const InitOptions&) = delete;
  [[nodiscard]] const rcl_init_options_t* rcl() const noexcept { return &options_; }

 private:
  rcl_init_options_t options_ = rcl_get_zero_initialized_init_options();
};

}  // namespace

Context::Context()
    : own_(rcl_get_zero_initialized_context()), hub_(std::make_unique<IntraProcessHub>()) {}

std::shared_ptr<Context> Context::create(int argc, const char* const* argv) {
  std::shared_ptr<Context> context(new Context());
  const InitOptions options;
  throw_unless_ok(rcl_init(argc, argv, options.rcl(), &context->own_), "initialise a context");
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

}  // namespace play_launch
