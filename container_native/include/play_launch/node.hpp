#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <play_launch/callback_group.hpp>
#include <play_launch/error.hpp>
#include <play_launch/logging.hpp>
#include <play_launch/node_options.hpp>
#include <play_launch/parameter.hpp>
#include <play_launch/publisher.hpp>
#include <play_launch/qos.hpp>
#include <play_launch/service.hpp>
#include <play_launch/subscription.hpp>
#include <play_launch/timer.hpp>
#include <string>
#include <utility>
#include <vector>

namespace play_launch {

class Executor;
class NodeHandle;
class ParameterServer;
class ParameterStore;
class WaitableRegistry;

/// A node's answer to a request to set parameters.
struct SetParametersVerdict {
  bool ok = true;
  /// Reason of a refusal; part of the service's answer.
  std::string reason;
};

/// A node of the ROS graph, and the base of every component. May be constructed and destroyed in
/// any thread while others are; callbacks run in the executor that holds it.
class Node {
 public:
  /// Creates the node with its logger, parameters and parameter services. Arguments and
  /// options.name / options.name_space may change `default_name` and the root namespace.
  /// Throws RclError, std::invalid_argument (no context, bad arguments).
  Node(const std::string& default_name, const NodeOptions& options);
  virtual ~Node();
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  /// Name, namespace ("/" or "/a/b") and both together, after remapping.
  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[nodiscard]] const std::string& name_space() const noexcept { return name_space_; }
  [[nodiscard]] const std::string& full_name() const noexcept { return full_name_; }
  [[nodiscard]] const Logger& logger() const noexcept { return logger_; }
  [[nodiscard]] const std::shared_ptr<Context>& context() const noexcept {
    return options_.context;
  }
  /// The options as they were given.
  [[nodiscard]] const NodeOptions& options() const noexcept { return options_; }

  /// The name expanded (`~`, relative) and remapped. Throws RclError.
  [[nodiscard]] std::string resolve_topic_name(const std::string& name) const;
  [[nodiscard]] std::string resolve_service_name(const std::string& name) const;

  /// The group of everything that is created without naming one; mutually exclusive.
  [[nodiscard]] const std::shared_ptr<CallbackGroup>& default_callback_group() const noexcept {
    return default_group_;
  }
  std::shared_ptr<CallbackGroup> create_callback_group(CallbackGroup::Kind kind);

  /// Creates a publisher of M. Throws RclError.
  template <class M>
  std::shared_ptr<Publisher<M>> create_publisher(const std::string& topic, const QoS& qos = {}) {
    return std::make_shared<Publisher<M>>(handle_, topic, qos, options_.use_intra_process_comms);
  }

  /// Calls `callback` for each message: void(const M&), void(std::shared_ptr<const M>) or
  /// void(std::unique_ptr<M>). The subscription ends with its last owner. Throws RclError.
  template <class M, class F>
  std::shared_ptr<Subscription<M>> create_subscription(
      const std::string& topic, const QoS& qos, F callback,
      std::shared_ptr<CallbackGroup> group = nullptr) {
    auto subscription = std::make_shared<CallbackSubscription<M, F>>(
        handle_, topic, qos, std::move(callback), options_.use_intra_process_comms,
        group_or_default(std::move(group)), logger_);
    add_waitable(subscription);
    return subscription;
  }

  /// Calls `callback` every `period` of the steady clock until the last owner releases the timer
  /// or cancels it. Throws std::invalid_argument for a negative period.
  std::shared_ptr<Timer> create_timer(std::chrono::nanoseconds period,
                                      std::function<void()> callback,
                                      std::shared_ptr<CallbackGroup> group = nullptr);

  /// Calls `callback` for each request: void(const S::Request&, S::Response&), or
  /// void(std::shared_ptr<PendingRequest<S>>) to answer later. Throws RclError.
  template <class S, class F>
  std::shared_ptr<Service<S>> create_service(const std::string& name, F callback,
                                             std::shared_ptr<CallbackGroup> group = nullptr,
                                             const QoS& qos = QoS::services()) {
    auto service = std::make_shared<CallbackService<S, F>>(
        handle_, name, qos, std::move(callback), group_or_default(std::move(group)), logger_);
    add_waitable(service);
    return service;
  }

  /// Declares a parameter whose type is T's: bool, an integer, a floating point number, string or
  /// a vector of uint8_t, bool, int64_t, double, string. Returns the override if there is one,
  /// else the default. Throws ParameterTypeError (override of another type, or an integer that
  /// does not fit T), ParameterAlreadyDeclared, ParameterRejected.
  template <class T>
  T declare_parameter(const std::string& name, T default_value) {
    using Storage = detail::parameter_storage_t<T>;
    const ParameterValue value =
        declare_value(name, ParameterValue(static_cast<Storage>(std::move(default_value))));
    return convert<T>(name, value);
  }
  /// Declares a parameter of the default's type; "not set" leaves the type open: any override is
  /// accepted, and any type may be set later. Returns the value; throws as above.
  ParameterValue declare_parameter(const std::string& name, ParameterValue default_value) {
    return declare_value(name, std::move(default_value));
  }
  std::string declare_parameter(const std::string& name, const char* default_value) {
    return declare_parameter(name, std::string(default_value));
  }
  /// Declares a parameter that must be given from outside. Throws ParameterTypeError when it is
  /// not, and as above.
  template <class T>
  T declare_required_parameter(const std::string& name) {
    using Storage = detail::parameter_storage_t<T>;
    return convert<T>(name, declare_required(name, ParameterValue(Storage{}).index()));
  }

  /// The current value. Throws ParameterNotDeclared, ParameterTypeError.
  template <class T>
  [[nodiscard]] T get_parameter(const std::string& name) const {
    return convert<T>(name, get_parameter(name));
  }
  [[nodiscard]] ParameterValue get_parameter(const std::string& name) const;
  [[nodiscard]] bool has_parameter(const std::string& name) const;

  /// Sets all or none. Never throws for a refused value: the verdict has the reason (undeclared,
  /// other type, the node's own callback). On success it is published on /parameter_events.
  SetParametersVerdict set_parameters(const std::vector<Parameter>& parameters);

  /// Offers the parameter services and publishes changes on /parameter_events from now on; for
  /// nodes whose options do not start them. What was declared before is not published. Not for two
  /// threads at once. Throws RclError.
  void start_parameter_services();

  /// Has `callback` asked before values are declared or set, in the thread that sets; replaces an
  /// earlier one. It may not set parameters itself.
  void on_set_parameters(
      std::function<SetParametersVerdict(const std::vector<Parameter>&)> callback);

 private:
  friend class Executor;

  template <class T>
  static T convert(const std::string& name, const ParameterValue& value) {
    using Storage = detail::parameter_storage_t<T>;
    const auto* stored = std::get_if<Storage>(&value);
    if (stored == nullptr) {
      throw ParameterTypeError(name, parameter_type_name(ParameterValue(Storage{})),
                               parameter_type_name(value));
    }
    if constexpr (std::is_integral_v<T> && !std::is_same_v<T, bool>) {
      if (!std::in_range<T>(*stored)) {
        throw ParameterTypeError(name, "integer within the range of the variable",
                                 "integer " + std::to_string(*stored));
      }
    }
    return static_cast<T>(*stored);
  }

  [[nodiscard]] std::shared_ptr<CallbackGroup> group_or_default(
      std::shared_ptr<CallbackGroup> group) const {
    return group ? std::move(group) : default_group_;
  }
  void add_waitable(const std::shared_ptr<Waitable>& waitable);
  ParameterValue declare_value(const std::string& name, ParameterValue default_value);
  ParameterValue declare_required(const std::string& name, std::size_t type);

  const NodeOptions options_;
  std::shared_ptr<NodeHandle> handle_;
  std::string name_;
  std::string name_space_;
  std::string full_name_;
  Logger logger_;
  std::shared_ptr<CallbackGroup> default_group_;
  std::unique_ptr<WaitableRegistry> waitables_;
  std::shared_ptr<PublisherHandle> rosout_;
  std::shared_ptr<ParameterStore> parameters_;
  std::unique_ptr<ParameterServer> parameter_server_;
};

}  // namespace play_launch
