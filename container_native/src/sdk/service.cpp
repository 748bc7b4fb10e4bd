#include <rcl/error_handling.h>

#include <play_launch/context.hpp>
#include <play_launch/error.hpp>
#include <play_launch/service.hpp>
#include <stdexcept>

#include "handles.hpp"

namespace play_launch {

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

}  // namespace play_launch
