#pragma once

#include <rcl/client.h>
#include <rcl/error_handling.h>
#include <rcl/graph.h>
#include <rcl/node.h>
#include <rcl/wait.h>

#include <memory>
#include <optional>
#include <rosidl_typesupport_cpp/service_type_support.hpp>

#include "check.hpp"

namespace play_launch::testing {

/// A blocking service client on plain rcl, with a node of its own.
template <class S>
class Client {
 public:
  Client(std::shared_ptr<Context> context, const std::string& service)
      : context_(std::move(context)) {
    const rcl_node_options_t node_options = rcl_node_get_default_options();
    CHECK(rcl_node_init(&node_, "test_client", "", context_->rcl(), &node_options) == RCL_RET_OK);
    const rcl_client_options_t options = rcl_client_get_default_options();
    CHECK(rcl_client_init(&client_, &node_,
                          rosidl_typesupport_cpp::get_service_type_support_handle<S>(),
                          service.c_str(), &options) == RCL_RET_OK);
    CHECK(rcl_wait_set_init(&wait_set_, 0, 0, 0, 1, 0, 0, context_->rcl(),
                            rcl_get_default_allocator()) == RCL_RET_OK);
  }
  ~Client() {
    CHECK(rcl_wait_set_fini(&wait_set_) == RCL_RET_OK);
    CHECK(rcl_client_fini(&client_, &node_) == RCL_RET_OK);
    CHECK(rcl_node_fini(&node_) == RCL_RET_OK);
  }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  /// Sends a request once the service is there; returns its number.
  std::int64_t send(const typename S::Request& request) {
    CHECK(eventually([this] {
      bool available = false;
      return rcl_service_server_is_available(&node_, &client_, &available) == RCL_RET_OK &&
             available;
    }));
    std::int64_t sequence = 0;
    CHECK(rcl_send_request(&client_, &request, &sequence) == RCL_RET_OK);
    return sequence;
  }

  /// The next answer and the number of its request; empty when none came within the limit.
  std::optional<std::pair<std::int64_t, typename S::Response>> receive(
      std::chrono::nanoseconds limit = kLimit) {
    CHECK(rcl_wait_set_clear(&wait_set_) == RCL_RET_OK);
    CHECK(rcl_wait_set_add_client(&wait_set_, &client_, nullptr) == RCL_RET_OK);
    if (rcl_wait(&wait_set_, limit.count()) != RCL_RET_OK) {
      rcl_reset_error();
      return std::nullopt;
    }
    rmw_request_id_t id;
    typename S::Response response;
    if (rcl_take_response(&client_, &id, &response) != RCL_RET_OK) {
      rcl_reset_error();
      return std::nullopt;
    }
    return std::pair(id.sequence_number, std::move(response));
  }

  typename S::Response call(const typename S::Request& request) {
    const auto sequence = send(request);
    auto answer = receive();
    CHECK(answer && answer->first == sequence);
    return std::move(answer->second);
  }

 private:
  const std::shared_ptr<Context> context_;
  rcl_node_t node_ = rcl_get_zero_initialized_node();
  rcl_client_t client_ = rcl_get_zero_initialized_client();
  rcl_wait_set_t wait_set_ = rcl_get_zero_initialized_wait_set();
};

}  // namespace play_launch::testing
