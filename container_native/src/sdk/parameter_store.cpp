#include "parameter_store.hpp"

#include <rcutils/time.h>
#include <rmw/qos_profiles.h>

#include <algorithm>
#include <array>
#include <play_launch/error.hpp>
#include <play_launch/node.hpp>
#include <play_launch/parameter.hpp>
#include <rcl_interfaces/msg/parameter_type.hpp>
#include <rcl_interfaces/srv/describe_parameters.hpp>
#include <rcl_interfaces/srv/get_parameter_types.hpp>
#include <rcl_interfaces/srv/get_parameters.hpp>
#include <rcl_interfaces/srv/list_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters.hpp>
#include <rcl_interfaces/srv/set_parameters_atomically.hpp>
#include <utility>

namespace play_launch {
namespace {

constexpr char kSeparator = '.';

bool within_depth(const std::string& name, std::size_t from, std::uint64_t depth) {
  if (depth == rcl_interfaces::srv::ListParameters::Request::DEPTH_RECURSIVE) return true;
  const auto below =
      std::count(name.begin() + static_cast<std::ptrdiff_t>(from), name.end(), kSeparator);
  return static_cast<std::uint64_t>(below) < depth;
}

bool listed_under(const std::string& name, const std::string& prefix, std::uint64_t depth) {
  if (!name.starts_with(prefix)) return false;
  if (name.size() == prefix.size()) return true;
  return name[prefix.size()] == kSeparator && within_depth(name, prefix.size() + 1, depth);
}

}  // namespace

ParameterStore::ParameterStore(std::string full_name,
                               std::map<std::string, ParameterValue> overrides)
    : full_name_(std::move(full_name)), overrides_(std::move(overrides)) {}

ParameterValue ParameterStore::declare(const std::string& name, ParameterValue default_value) {
  const std::size_t type = default_value.index();
  return declare(name, std::move(default_value), type);
}

ParameterValue ParameterStore::declare_required(const std::string& name, std::size_t type) {
  return declare(name, ParameterValue(), type);
}

ParameterValue ParameterStore::declare(const std::string& name, ParameterValue default_value,
                                       std::size_t type) {
  if (name.empty()) throw ParameterError("a parameter needs a name");
  {
    const std::lock_guard lock(mutex_);
    if (entries_.contains(name)) throw ParameterAlreadyDeclared(name);
  }
  const auto given = overrides_.find(name);
  ParameterValue value = given == overrides_.end() ? std::move(default_value) : given->second;
  if (type != 0 && value.index() != type) {
    throw ParameterTypeError(name, parameter_type_name(type), parameter_type_name(value));
  }
  if (const auto ask = callback()) {
    const Verdict verdict = (*ask)({{name, value}});
    if (!verdict.ok) throw ParameterRejected(name, verdict.reason);
  }
  {
    const std::lock_guard lock(mutex_);
    if (!entries_.emplace(name, Entry{value, type}).second) throw ParameterAlreadyDeclared(name);
  }
  if (value.index() != 0) {
    rcl_interfaces::msg::ParameterEvent event;
    event.new_parameters.push_back(to_message(Parameter{name, value}));
    announce(std::move(event));
  }
  return value;
}

ParameterStore::Verdict ParameterStore::check_locked(
    const std::vector<Parameter>& parameters) const {
  for (const auto& [name, value] : parameters) {
    const auto entry = entries_.find(name);
    if (entry == entries_.end()) return {false, ParameterNotDeclared(name).what()};
    const std::size_t type = entry->second.type;
    if (type != 0 && type != value.index()) {
      return {
          false,
          ParameterTypeError(name, parameter_type_name(type), parameter_type_name(value)).what()};
    }
  }
  return {};
}

ParameterStore::Verdict ParameterStore::set(const std::vector<Parameter>& parameters) {
  {
    const std::lock_guard lock(mutex_);
    Verdict verdict = check_locked(parameters);
    if (!verdict.ok) return verdict;
  }
  // Parameters are never undeclared and keep their type, so what was checked stays true.
  if (const auto ask = callback()) {
    Verdict verdict = (*ask)(parameters);
    if (!verdict.ok) {
      if (verdict.reason.empty()) verdict.reason = "the node refused the value";
      return verdict;
    }
  }
  rcl_interfaces::msg::ParameterEvent event;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& parameter : parameters) {
      Entry& entry = entries_.at(parameter.name);
      const bool was_set = entry.value.index() != 0;
      const bool is_set = parameter.value.index() != 0;
      entry.value = parameter.value;
      if (is_set) {
        (was_set ? event.changed_parameters : event.new_parameters)
            .push_back(to_message(parameter));
      } else if (was_set) {
        event.deleted_parameters.push_back(to_message(parameter));
      }
    }
  }
  announce(std::move(event));
  return {};
}

void ParameterStore::set_callback(Callback callback) {
  auto shared = callback ? std::make_shared<const Callback>(std::move(callback)) : nullptr;
  const std::lock_guard lock(mutex_);
  callback_.swap(shared);
}

std::shared_ptr<const ParameterStore::Callback> ParameterStore::callback() const {
  const std::lock_guard lock(mutex_);
  return callback_;
}

std::optional<ParameterValue> ParameterStore::get(const std::string& name) const {
  const std::lock_guard lock(mutex_);
  const auto entry = entries_.find(name);
  if (entry == entries_.end()) return std::nullopt;
  return entry->second.value;
}

std::optional<rcl_interfaces::msg::ParameterDescriptor> ParameterStore::describe(
    const std::string& name) const {
  const std::lock_guard lock(mutex_);
  const auto entry = entries_.find(name);
  if (entry == entries_.end()) return std::nullopt;
  rcl_interfaces::msg::ParameterDescriptor descriptor;
  descriptor.name = name;
  descriptor.type = static_cast<std::uint8_t>(entry->second.value.index());
  descriptor.dynamic_typing = entry->second.type == 0;
  return descriptor;
}

rcl_interfaces::msg::ListParametersResult ParameterStore::list(
    const std::vector<std::string>& prefixes, std::uint64_t depth) const {
  rcl_interfaces::msg::ListParametersResult result;
  const std::lock_guard lock(mutex_);
  for (const auto& [name, entry] : entries_) {
    const bool listed = prefixes.empty()
                            ? within_depth(name, 0, depth)
                            : std::any_of(prefixes.begin(), prefixes.end(),
                                          [&, &name = name](const std::string& prefix) {
                                            return listed_under(name, prefix, depth);
                                          });
    if (!listed) continue;
    result.names.push_back(name);
    const auto last = name.rfind(kSeparator);
    if (last == std::string::npos) continue;
    auto own_prefix = name.substr(0, last);
    if (std::find(result.prefixes.begin(), result.prefixes.end(), own_prefix) ==
        result.prefixes.end()) {
      result.prefixes.push_back(std::move(own_prefix));
    }
  }
  return result;
}

void ParameterStore::announce(rcl_interfaces::msg::ParameterEvent event) const {
  // Nothing is kept for late joiners, so without a subscription there is nothing to publish to.
  if (!events_ || events_->subscription_count() == 0) return;
  rcutils_time_point_value_t now = 0;
  if (rcutils_system_time_now(&now) != RCUTILS_RET_OK) rcutils_reset_error();
  event.stamp.sec = static_cast<std::int32_t>(now / 1'000'000'000);
  event.stamp.nanosec = static_cast<std::uint32_t>(now % 1'000'000'000);
  event.node = full_name_;
  events_->publish(event);
}

namespace {

using Type = rcl_interfaces::msg::ParameterType;
using Message = rcl_interfaces::msg::ParameterValue;

constexpr std::array<const char*, 10> kTypeNames = {
    "not set",    "bool",       "integer",       "double",       "string",
    "byte_array", "bool_array", "integer_array", "double_array", "string_array"};
static_assert(kTypeNames.size() == std::variant_size_v<ParameterValue>);
static_assert(Type::PARAMETER_STRING_ARRAY == kTypeNames.size() - 1);

struct Fill {
  Message& message;
  void operator()(std::monostate) const {}
  void operator()(bool value) const { message.bool_value = value; }
  void operator()(std::int64_t value) const { message.integer_value = value; }
  void operator()(double value) const { message.double_value = value; }
  void operator()(const std::string& value) const { message.string_value = value; }
  void operator()(const std::vector<std::uint8_t>& value) const {
    message.byte_array_value = value;
  }
  void operator()(const std::vector<bool>& value) const { message.bool_array_value = value; }
  void operator()(const std::vector<std::int64_t>& value) const {
    message.integer_array_value = value;
  }
  void operator()(const std::vector<double>& value) const { message.double_array_value = value; }
  void operator()(const std::vector<std::string>& value) const {
    message.string_array_value = value;
  }
};

}  // namespace

const char* parameter_type_name(std::size_t type) noexcept {
  return type < kTypeNames.size() ? kTypeNames[type] : "unknown";
}

Message to_message(const ParameterValue& value) {
  Message message;
  message.type = static_cast<std::uint8_t>(value.index());
  std::visit(Fill{message}, value);
  return message;
}

rcl_interfaces::msg::Parameter to_message(const Parameter& parameter) {
  rcl_interfaces::msg::Parameter message;
  message.name = parameter.name;
  message.value = to_message(parameter.value);
  return message;
}

ParameterValue from_message(const Message& message) {
  switch (message.type) {
    case Type::PARAMETER_BOOL:
      return message.bool_value;
    case Type::PARAMETER_INTEGER:
      return message.integer_value;
    case Type::PARAMETER_DOUBLE:
      return message.double_value;
    case Type::PARAMETER_STRING:
      return message.string_value;
    case Type::PARAMETER_BYTE_ARRAY:
      return message.byte_array_value;
    case Type::PARAMETER_BOOL_ARRAY:
      return message.bool_array_value;
    case Type::PARAMETER_INTEGER_ARRAY:
      return message.integer_array_value;
    case Type::PARAMETER_DOUBLE_ARRAY:
      return message.double_array_value;
    case Type::PARAMETER_STRING_ARRAY:
      return message.string_array_value;
    default:
      return std::monostate();
  }
}

Parameter from_message(const rcl_interfaces::msg::Parameter& message) {
  return {message.name, from_message(message.value)};
}

std::vector<Parameter> from_messages(const std::vector<rcl_interfaces::msg::Parameter>& messages) {
  std::vector<Parameter> parameters;
  parameters.reserve(messages.size());
  for (const auto& message : messages) parameters.push_back(from_message(message));
  return parameters;
}

namespace {

using namespace rcl_interfaces::srv;  // NOLINT(google-build-using-namespace)
using Store = std::shared_ptr<ParameterStore>;

rcl_interfaces::msg::SetParametersResult to_result(SetParametersVerdict verdict) {
  rcl_interfaces::msg::SetParametersResult result;
  result.successful = verdict.ok;
  result.reason = std::move(verdict.reason);
  return result;
}

// The answers have one element per name asked for; "not set" stands for undeclared.

auto describe(const Store& store) {
  return
      [store](const DescribeParameters::Request& request, DescribeParameters::Response& response) {
        for (const auto& name : request.names) {
          auto descriptor = store->describe(name);
          if (!descriptor) descriptor.emplace().name = name;
          response.descriptors.push_back(std::move(*descriptor));
        }
      };
}

auto get(const Store& store) {
  return [store](const GetParameters::Request& request, GetParameters::Response& response) {
    for (const auto& name : request.names) {
      response.values.push_back(to_message(store->get(name).value_or(ParameterValue())));
    }
  };
}

auto get_types(const Store& store) {
  return [store](const GetParameterTypes::Request& request, GetParameterTypes::Response& response) {
    for (const auto& name : request.names) {
      const auto value = store->get(name).value_or(ParameterValue());
      response.types.push_back(static_cast<std::uint8_t>(value.index()));
    }
  };
}

auto list(const Store& store) {
  return [store](const ListParameters::Request& request, ListParameters::Response& response) {
    response.result = store->list(request.prefixes, request.depth);
  };
}

auto set(const Store& store) {
  return [store](const SetParameters::Request& request, SetParameters::Response& response) {
    for (const auto& parameter : request.parameters) {
      response.results.push_back(to_result(store->set({from_message(parameter)})));
    }
  };
}

auto set_atomically(const Store& store) {
  return [store](const SetParametersAtomically::Request& request,
                 SetParametersAtomically::Response& response) {
    response.result = to_result(store->set(from_messages(request.parameters)));
  };
}

}  // namespace

ParameterServer::ParameterServer(Node& node, const std::shared_ptr<ParameterStore>& store) {
  const QoS qos(rmw_qos_profile_parameters);
  services_ = {
      node.create_service<DescribeParameters>("~/describe_parameters", describe(store), nullptr,
                                              qos),
      node.create_service<GetParameterTypes>("~/get_parameter_types", get_types(store), nullptr,
                                             qos),
      node.create_service<GetParameters>("~/get_parameters", get(store), nullptr, qos),
      node.create_service<ListParameters>("~/list_parameters", list(store), nullptr, qos),
      node.create_service<SetParameters>("~/set_parameters", set(store), nullptr, qos),
      node.create_service<SetParametersAtomically>("~/set_parameters_atomically",
                                                   set_atomically(store), nullptr, qos),
  };
}

ParameterServer::~ParameterServer() = default;

}  // namespace play_launch
