#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <play_launch/node.hpp>
#include <play_launch/parameter.hpp>
#include <rcl_interfaces/msg/list_parameters_result.hpp>
#include <rcl_interfaces/msg/parameter_descriptor.hpp>
#include <rcl_interfaces/msg/parameter_event.hpp>
#include <string>
#include <vector>

namespace play_launch {

/// The parameters of one node. Any thread. The node's callback and the publisher of events are
/// called without a lock.
class ParameterStore {
 public:
  using Verdict = SetParametersVerdict;
  using Callback = std::function<Verdict(const std::vector<Parameter>&)>;
  using Events = Publisher<rcl_interfaces::msg::ParameterEvent>;

  ParameterStore(std::string full_name, std::map<std::string, ParameterValue> overrides);

  /// See Node.
  ParameterValue declare(const std::string& name, ParameterValue default_value);
  ParameterValue declare_required(const std::string& name, std::size_t type);
  Verdict set(const std::vector<Parameter>& parameters);
  void set_callback(Callback callback);

  /// Empty when it is not declared.
  [[nodiscard]] std::optional<ParameterValue> get(const std::string& name) const;
  [[nodiscard]] std::optional<rcl_interfaces::msg::ParameterDescriptor> describe(
      const std::string& name) const;

  /// Names that start with one of the prefixes (all without prefixes), at most `depth` levels
  /// below it (0 = no limit), and the prefixes they have themselves.
  [[nodiscard]] rcl_interfaces::msg::ListParametersResult list(
      const std::vector<std::string>& prefixes, std::uint64_t depth) const;

  /// Announces changes there from now on. To be called before the store is used.
  void announce_on(std::shared_ptr<Events> events) { events_ = std::move(events); }

 private:
  struct Entry {
    ParameterValue value;
    std::size_t type;  // 0 = any
  };

  ParameterValue declare(const std::string& name, ParameterValue default_value, std::size_t type);
  [[nodiscard]] Verdict check_locked(const std::vector<Parameter>& parameters) const;
  [[nodiscard]] std::shared_ptr<const Callback> callback() const;
  void announce(rcl_interfaces::msg::ParameterEvent event) const;

  const std::string full_name_;
  const std::map<std::string, ParameterValue> overrides_;
  std::shared_ptr<Events> events_;

  mutable std::mutex mutex_;
  std::map<std::string, Entry> entries_;
  std::shared_ptr<const Callback> callback_;
};

/// The six standard parameter services of a node.
class ParameterServer {
 public:
  ParameterServer(Node& node, const std::shared_ptr<ParameterStore>& store);
  ~ParameterServer();
  ParameterServer(const ParameterServer&) = delete;
  ParameterServer& operator=(const ParameterServer&) = delete;

 private:
  std::vector<std::shared_ptr<ServiceBase>> services_;
};

}  // namespace play_launch
