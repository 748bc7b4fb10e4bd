#include <rcl/error_handling.h>
#include <rcl/logging_rosout.h>
#include <rmw/qos_profiles.h>
#include <rmw/rmw.h>

#include <play_launch/context.hpp>
#include <play_launch/detail/context_access.hpp>
#include <play_launch/detail/waitable.hpp>
#include <play_launch/error.hpp>
#include <play_launch/publisher.hpp>
#include <play_launch/qos.hpp>
#include <play_launch/service.hpp>
#include <play_launch/subscription.hpp>
#include <play_launch/timer.hpp>
#include <stdexcept>
#include <utility>

#include "handles.hpp"
#include "ready_queue.hpp"

namespace play_launch {

Waitable::Waitable(Readiness readiness, std::shared_ptr<CallbackGroup> group, Logger logger)
    : group_(std::move(group)),
      logger_(std::move(logger)),
      token_(std::make_shared<WakeToken>(readiness == Readiness::timed, group_)) {}

Waitable::~Waitable() {
  token_->retired.store(true);
  if (token_->timed) token_->notify(0);  // it may be among an executor's timers
}

void Waitable::notify(std::size_t events) noexcept { token_->notify(events); }

void Waitable::set_due(Clock::time_point due) noexcept {
  token_->due.store(
      due == Clock::time_point::max()
          ? kNever
          : std::chrono::duration_cast<std::chrono::nanoseconds>(due.time_since_epoch()).count());
}

PublisherBase::PublisherBase(const std::shared_ptr<NodeHandle>& node,
                             const rosidl_message_type_support_t* type_support,
                             std::type_index type, const std::string& topic, const QoS& qos,
                             bool intra_process)
    : handle_(std::make_shared<PublisherHandle>(node, type_support, topic, qos)),
      topic_(rcl_publisher_get_topic_name(handle_->rcl())) {
  if (!intra_process || !IntraProcessHub::suits(qos.profile())) return;
  rmw_gid_t gid;
  throw_unless_ok(rmw_get_gid_for_publisher(rcl_publisher_get_rmw_handle(handle_->rcl()), &gid),
                  "identify the publisher of topic '" + topic_ + "'");
  intra_process_ = detail::ContextAccess::intra_process(node->context())
                       .add_publisher(topic_, type, qos.profile(), gid, *node->rcl());
}

PublisherBase::~PublisherBase() = default;

std::size_t PublisherBase::subscription_count() const {
  if (!handle_->context().ok()) return 0;
  std::size_t count = 0;
  throw_unless_ok(rcl_publisher_get_subscription_count(handle_->rcl(), &count),
                  "count the subscriptions of topic '" + topic_ + "'");
  return count;
}

void PublisherBase::send(const void* message) const {
  const rcl_ret_t sent = rcl_publish(handle_->rcl(), message, nullptr);
  if (sent == RCL_RET_OK) return;
  if (!handle_->context().ok()) {
    rcl_reset_error();
    return;
  }
  throw RclError("publish on topic '" + topic_ + "'", sent);
}

SubscriptionBase::SubscriptionBase(std::shared_ptr<CallbackGroup> group, Logger logger)
    : Waitable(Readiness::notified, std::move(group), std::move(logger)) {}

SubscriptionBase::~SubscriptionBase() = default;

void SubscriptionBase::open(const std::shared_ptr<NodeHandle>& node,
                            const rosidl_message_type_support_t* type_support, std::type_index type,
                            const std::string& topic, const QoS& qos,
                            std::shared_ptr<IntraProcessInbox> inbox) {
  inbox_ = std::move(inbox);
  if (inbox_) {
    intra_process_ = detail::ContextAccess::intra_process(node->context())
                         .add_subscription(node->resolve(topic, false), type, qos.profile(), inbox_,
                                           *node->rcl());
  }
  handle_ = std::make_shared<SubscriptionHandle>(node, type_support, topic, qos, token());
  topic_ = rcl_subscription_get_topic_name(handle_->rcl());
  if (intra_process_) intra_process_->settle();
}

std::size_t SubscriptionBase::publisher_count() const {
  std::size_t count = 0;
  throw_unless_ok(rcl_subscription_get_publisher_count(handle_->rcl(), &count),
                  "count the publishers of topic '" + topic_ + "'");
  return count;
}

std::uint64_t SubscriptionBase::dropped() const noexcept { return inbox_ ? inbox_->dropped() : 0; }

bool SubscriptionBase::take_from_middleware(void* message) {
  while (true) {
    rmw_message_info_t info = rmw_get_zero_initialized_message_info();
    const rcl_ret_t taken = rcl_take(handle_->rcl(), message, &info, nullptr);
    if (taken == RCL_RET_SUBSCRIPTION_TAKE_FAILED) {
      rcl_reset_error();
      return false;
    }
    throw_unless_ok(taken, "take a message of topic '" + topic_ + "'");
    if (!intra_process_ || !intra_process_->delivered_by_pointer(info.publisher_gid)) return true;
  }
}

PendingRequestBase::PendingRequestBase(std::weak_ptr<ServiceHandle> service,
                                       const rmw_request_id_t& id, Logger logger)
    : service_(std::move(service)), id_(id), logger_(std::move(logger)) {}

PendingRequestBase::~PendingRequestBase() {
  if (answered_.load()) return;
  const auto service = service_.lock();
  if (!service || !service->context().ok()) return;
  PLAY_LAUNCH_WARN(logger_, "a request to service %s was dropped without an answer",
                   rcl_service_get_service_name(service->rcl()));
}

bool PendingRequestBase::send(void* response) {
  if (answered_.exchange(true)) throw std::logic_error("respond: the request is answered already");
  const auto service = service_.lock();
  if (!service || !service->context().ok()) return false;
  const rcl_ret_t sent = rcl_send_response(service->rcl(), &id_, response);
  if (sent == RCL_RET_TIMEOUT || (sent != RCL_RET_OK && !service->context().ok())) {
    rcl_reset_error();
    return false;
  }
  throw_unless_ok(sent, "answer a request to service '" +
                            std::string(rcl_service_get_service_name(service->rcl())) + "'");
  return true;
}

ServiceBase::ServiceBase(std::shared_ptr<CallbackGroup> group, Logger logger)
    : Waitable(Readiness::notified, std::move(group), std::move(logger)) {}

ServiceBase::~ServiceBase() = default;

void ServiceBase::open(const std::shared_ptr<NodeHandle>& node,
                       const rosidl_service_type_support_t* type_support, const std::string& name,
                       const QoS& qos) {
  handle_ = std::make_shared<ServiceHandle>(node, type_support, name, qos, token());
  service_name_ = rcl_service_get_service_name(handle_->rcl());
}

bool ServiceBase::take_request(rmw_request_id_t& id, void* request) {
  const rcl_ret_t taken = rcl_take_request(handle_->rcl(), &id, request);
  if (taken == RCL_RET_SERVICE_TAKE_FAILED) {
    rcl_reset_error();
    return false;
  }
  throw_unless_ok(taken, "take a request to service '" + service_name_ + "'");
  return true;
}

Timer::Timer(std::chrono::nanoseconds period, std::function<void()> callback,
             std::shared_ptr<CallbackGroup> group, Logger logger)
    : Waitable(Readiness::timed, std::move(group), std::move(logger)),
      period_(period),
      due_(Clock::now() + period),
      callback_(std::make_shared<const std::function<void()>>(std::move(callback))) {
  if (period < std::chrono::nanoseconds::zero()) {
    throw std::invalid_argument("timer: the period is negative");
  }
  set_due(due_);
}

void Timer::cancel() {
  const std::lock_guard lock(mutex_);
  cancelled_ = true;
  set_due(Clock::time_point::max());
}

bool Timer::cancelled() const {
  const std::lock_guard lock(mutex_);
  return cancelled_;
}

void Timer::reset() { reset(period()); }

void Timer::reset(std::chrono::nanoseconds period) {
  if (period < std::chrono::nanoseconds::zero()) {
    throw std::invalid_argument("timer: the period is negative");
  }
  {
    const std::lock_guard lock(mutex_);
    cancelled_ = false;
    period_ = period;
    due_ = Clock::now() + period;
    set_due(due_);
  }
  notify(0);
}

std::chrono::nanoseconds Timer::period() const {
  const std::lock_guard lock(mutex_);
  return period_;
}

Work Timer::take() {
  const std::lock_guard lock(mutex_);
  const auto now = Clock::now();
  if (cancelled_ || now < due_) return Work();
  if (period_ == std::chrono::nanoseconds::zero()) {
    due_ = now;
  } else {
    due_ += ((now - due_) / period_ + 1) * period_;
  }
  set_due(due_);
  return Work([callback = callback_] { (*callback)(); });
}

namespace {

rmw_time_t to_rmw_time(std::chrono::nanoseconds duration) {
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(duration);
  return {static_cast<std::uint64_t>(seconds.count()),
          static_cast<std::uint64_t>((duration - seconds).count())};
}

}  // namespace

QoS::QoS() : profile_(rmw_qos_profile_default) {}
QoS::QoS(std::size_t depth) : QoS() { keep_last(depth); }

QoS QoS::sensor_data() { return QoS(rmw_qos_profile_sensor_data); }
QoS QoS::services() { return QoS(rmw_qos_profile_services_default); }
QoS QoS::parameter_events() { return QoS(rmw_qos_profile_parameter_events); }
QoS QoS::rosout() { return QoS(rcl_qos_profile_rosout_default); }

QoS& QoS::keep_last(std::size_t depth) {
  profile_.history = RMW_QOS_POLICY_HISTORY_KEEP_LAST;
  profile_.depth = depth;
  return *this;
}

QoS& QoS::keep_all() {
  profile_.history = RMW_QOS_POLICY_HISTORY_KEEP_ALL;
  profile_.depth = 0;
  return *this;
}

QoS& QoS::reliable() {
  profile_.reliability = RMW_QOS_POLICY_RELIABILITY_RELIABLE;
  return *this;
}

QoS& QoS::best_effort() {
  profile_.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  return *this;
}

QoS& QoS::durability_volatile() {
  profile_.durability = RMW_QOS_POLICY_DURABILITY_VOLATILE;
  return *this;
}

QoS& QoS::transient_local() {
  profile_.durability = RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL;
  return *this;
}

QoS& QoS::deadline(std::chrono::nanoseconds period) {
  profile_.deadline = to_rmw_time(period);
  return *this;
}

QoS& QoS::lifespan(std::chrono::nanoseconds duration) {
  profile_.lifespan = to_rmw_time(duration);
  return *this;
}

QoS& QoS::liveliness_lease(std::chrono::nanoseconds duration) {
  profile_.liveliness_lease_duration = to_rmw_time(duration);
  return *this;
}

}  // namespace play_launch
