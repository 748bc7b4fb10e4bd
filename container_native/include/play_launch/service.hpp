#pragma once

#include <rmw/types.h>
#include <rosidl_runtime_c/service_type_support_struct.h>

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <play_launch/detail/waitable.hpp>
#include <play_launch/qos.hpp>
#include <rosidl_typesupport_cpp/service_type_support.hpp>
#include <string>
#include <type_traits>
#include <utility>

namespace play_launch {

class NodeHandle;
class ServiceHandle;

/// The part of a request that does not depend on the service type.
class PendingRequestBase {
 public:
  PendingRequestBase(std::weak_ptr<ServiceHandle> service, const rmw_request_id_t& id,
                     Logger logger);
  /// Warns when a request got no answer: the client waits in vain.
  ~PendingRequestBase();
  PendingRequestBase(const PendingRequestBase&) = delete;
  PendingRequestBase& operator=(const PendingRequestBase&) = delete;

 protected:
  /// False when the service is gone or the client does not listen any more. Throws
  /// std::logic_error when called twice, RclError when sending fails.
  bool send(void* response);

 private:
  const std::weak_ptr<ServiceHandle> service_;
  rmw_request_id_t id_;
  const Logger logger_;
  std::atomic<bool> answered_{false};
};

/// A request that is answered when the owner likes, from any thread, at most once.
template <class S>
class PendingRequest final : public PendingRequestBase {
 public:
  PendingRequest(std::weak_ptr<ServiceHandle> service, const rmw_request_id_t& id, Logger logger,
                 typename S::Request request)
      : PendingRequestBase(std::move(service), id, std::move(logger)),
        request_(std::move(request)) {}

  [[nodiscard]] const typename S::Request& request() const noexcept { return request_; }

  /// Sends the answer. False when the service is gone or the client does not listen any more.
  /// Throws std::logic_error when called twice, RclError when sending fails.
  bool respond(typename S::Response response) { return send(&response); }

 private:
  const typename S::Request request_;
};

/// The part of a service that does not depend on its type. Lives as long as an owner holds it.
class ServiceBase : public Waitable {
 public:
  ~ServiceBase() override;

  /// Fully qualified service name after remapping.
  [[nodiscard]] const std::string& service_name() const noexcept { return service_name_; }

 protected:
  ServiceBase(std::shared_ptr<CallbackGroup> group, Logger logger);

  /// Second part of construction.
  void open(const std::shared_ptr<NodeHandle>& node,
            const rosidl_service_type_support_t* type_support, const std::string& name,
            const QoS& qos);

  /// Takes one request; false if none is pending. Throws RclError.
  bool take_request(rmw_request_id_t& id, void* request);
  [[nodiscard]] const std::shared_ptr<ServiceHandle>& handle() const noexcept { return handle_; }

 private:
  std::string service_name_;
  std::shared_ptr<ServiceHandle> handle_;
};

namespace detail {

template <class F, class S>
inline constexpr bool answers_later = std::is_invocable_v<F&, std::shared_ptr<PendingRequest<S>>>;
template <class F, class S>
inline constexpr bool answers_at_once =
    std::is_invocable_v<F&, const typename S::Request&, typename S::Response&>;

}  // namespace detail

/// What users hold; see CallbackService.
template <class S>
class Service : public ServiceBase {
 protected:
  using ServiceBase::ServiceBase;
};

/// Calls `F` for each request: void(const Request&, Response&) answers when it returns,
/// void(std::shared_ptr<PendingRequest<S>>) when it likes.
template <class S, class F>
class CallbackService final : public Service<S> {
  static_assert(detail::answers_at_once<F, S> || detail::answers_later<F, S>,
                "the callback must take (const Request&, Response&) or "
                "(std::shared_ptr<PendingRequest<S>>)");

 public:
  /// Use Node::create_service.
  CallbackService(const std::shared_ptr<NodeHandle>& node, const std::string& name, const QoS& qos,
                  F callback, std::shared_ptr<CallbackGroup> group, Logger logger)
      : Service<S>(std::move(group), std::move(logger)),
        callback_(std::make_shared<F>(std::move(callback))) {
    this->open(node, rosidl_typesupport_cpp::get_service_type_support_handle<S>(), name, qos);
  }

  Work take() override {
    const std::lock_guard lock(take_mutex_);
    rmw_request_id_t id;
    typename S::Request request;
    if (!this->take_request(id, &request)) return Work();
    auto pending =
        std::make_shared<PendingRequest<S>>(this->handle(), id, this->logger(), std::move(request));
    return Work([callback = callback_, pending = std::move(pending)]() mutable {
      if constexpr (detail::answers_at_once<F, S>) {
        typename S::Response response;
        (*callback)(pending->request(), response);
        pending->respond(std::move(response));
      } else {
        (*callback)(std::move(pending));
      }
    });
  }

 private:
  const std::shared_ptr<F> callback_;
  std::mutex take_mutex_;
};

}  // namespace play_launch
