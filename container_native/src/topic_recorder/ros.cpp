#include "topic_recorder/ros.hpp"

#include <dlfcn.h>
#include <rcl/error_handling.h>
#include <rcl/graph.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <iterator>
#include <map>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string_view>

#include "fastdds/waits.hpp"
#include "topic_recorder/selection.hpp"

namespace play_launch::topics {
namespace {

/// In a destructor no caller can handle it.
void ignore(rcl_ret_t result) {
  if (result != RCL_RET_OK) {
    rcl_reset_error();
  }
}

using Lives = std::map<std::string, std::set<AskableNode::Life>>;

/// By full name, those that publish changes of their parameters.
Lives lives(const rcl_node_t& node) {
  rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_topic_endpoint_info_array_t found = rcl_get_zero_initialized_topic_endpoint_info_array();
  check(rcl_get_publishers_info_by_topic(&node, &allocator, "/parameter_events", false, &found),
        "list the publishers of /parameter_events");
  Lives all;
  for (std::size_t i = 0; i < found.size; ++i) {
    const rmw_topic_endpoint_info_t& info = found.info_array[i];
    const std::string space = info.node_namespace;
    AskableNode::Life life{};
    std::ranges::copy(info.endpoint_gid, life.begin());
    all[(space == "/" ? space : space + "/") + info.node_name].insert(life);
  }
  ignore(rcl_topic_endpoint_info_array_fini(&found, &allocator));
  return all;
}

}  // namespace

void check(rcl_ret_t result, const std::string& action) {
  if (result == RCL_RET_OK) {
    return;
  }
  const std::string reason = rcl_get_error_string().str;
  rcl_reset_error();
  throw std::runtime_error("failed to " + action + ": " + reason);
}

RosNode::RosNode() {
  rcl_init_options_t init = rcl_get_zero_initialized_init_options();
  check(rcl_init_options_init(&init, rcl_get_default_allocator()),
        "prepare the options of a context");
  const rcl_ret_t initialised = rcl_init(0, nullptr, &init, &context_);
  ignore(rcl_init_options_fini(&init));
  check(initialised, "initialise a context");
  fastdds::replace_waits();
  rcl_node_options_t options = rcl_node_get_default_options();
  options.enable_rosout = false;
  const std::string name = "_play_launch_recorder_" + std::to_string(::getpid());
  const fastdds::Withholding until_it_listens;
  check(rcl_node_init(&node_, name.c_str(), "/", &context_, &options), "make a node");
}

RosNode::~RosNode() {
  ignore(rcl_node_fini(&node_));
  ignore(rcl_shutdown(&context_));
  ignore(rcl_context_fini(&context_));
}

std::string GraphTopic::types_in_words() const {
  std::string all;
  for (const std::string& type : types) {
    all += (all.empty() ? "" : ", ") + type;
  }
  return all;
}

std::vector<GraphTopic> RosNode::topics() const {
  rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_names_and_types_t found = rcl_get_zero_initialized_names_and_types();
  check(rcl_get_topic_names_and_types(&node_, &allocator, false, &found), "list the topics");
  std::vector<GraphTopic> topics;
  topics.reserve(found.names.size);
  for (std::size_t i = 0; i < found.names.size; ++i) {
    const rcutils_string_array_t& types = found.types[i];
    topics.push_back({found.names.data[i], {types.data, types.data + types.size}});
  }
  ignore(rcl_names_and_types_fini(&found));
  return topics;
}

std::vector<rmw_qos_profile_t> RosNode::offered(const std::string& topic) const {
  rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_topic_endpoint_info_array_t found = rcl_get_zero_initialized_topic_endpoint_info_array();
  check(rcl_get_publishers_info_by_topic(&node_, &allocator, topic.c_str(), false, &found),
        "list the publishers of " + topic);
  std::vector<rmw_qos_profile_t> profiles;
  profiles.reserve(found.size);
  for (std::size_t i = 0; i < found.size; ++i) {
    profiles.push_back(found.info_array[i].qos_profile);
  }
  ignore(rcl_topic_endpoint_info_array_fini(&found, &allocator));
  return profiles;
}

std::vector<AskableNode> RosNode::askable_nodes() const {
  constexpr std::string_view kService = "/list_parameters";
  rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_names_and_types_t found = rcl_get_zero_initialized_names_and_types();
  check(rcl_get_service_names_and_types(&node_, &allocator, &found), "list the services");
  const Lives known = lives(node_);
  std::vector<AskableNode> nodes;
  for (std::size_t i = 0; i < found.names.size; ++i) {
    std::string name = found.names.data[i];
    const rcutils_string_array_t& types = found.types[i];
    if (!name.ends_with(kService) || is_hidden(name) || types.size != 1 ||
        types.data[0] != std::string_view("rcl_interfaces/srv/ListParameters")) {
      continue;
    }
    name.resize(name.size() - kService.size());
    const auto place = known.find(name);
    nodes.push_back({name, place == known.end() ? std::set<AskableNode::Life>() : place->second});
  }
  ignore(rcl_names_and_types_fini(&found));
  return nodes;
}

GuardCondition::GuardCondition(RosNode& node) {
  check(
      rcl_guard_condition_init(&guard_, node.context(), rcl_guard_condition_get_default_options()),
      "make a guard condition");
}

GuardCondition::~GuardCondition() { ignore(rcl_guard_condition_fini(&guard_)); }

void GuardCondition::trigger() noexcept { ignore(rcl_trigger_guard_condition(&guard_)); }

SerializedSubscription::SerializedSubscription(RosNode& node,
                                               const rosidl_message_type_support_t* type_support,
                                               const std::string& topic,
                                               const rmw_qos_profile_t& qos)
    : node_(node), qos_(qos) {
  rcl_subscription_options_t options = rcl_subscription_get_default_options();
  options.qos = qos;
  const rcl_ret_t result =
      rcl_subscription_init(&subscription_, node.rcl(), type_support, topic.c_str(), &options);
  ignore(rcl_subscription_options_fini(&options));
  check(result, "subscribe to " + topic);
}

SerializedSubscription::~SerializedSubscription() {
  ignore(rcl_subscription_fini(&subscription_, const_cast<rcl_node_t*>(node_.rcl())));
}

bool SerializedSubscription::take(rcl_serialized_message_t& message, rmw_message_info_t& info) {
  const rcl_ret_t taken = rcl_take_serialized_message(&subscription_, &message, &info, nullptr);
  if (taken == RCL_RET_SUBSCRIPTION_TAKE_FAILED) {
    rcl_reset_error();
    return false;
  }
  check(taken, "take a message");
  return true;
}

ServiceClient::ServiceClient(RosNode& node, const rosidl_service_type_support_t* type_support,
                             const std::string& service)
    : node_(node) {
  rcl_client_options_t options = rcl_client_get_default_options();
  options.qos = rmw_qos_profile_parameters;
  check(rcl_client_init(&client_, node.rcl(), type_support, service.c_str(), &options),
        "make a client of " + service);
}

ServiceClient::~ServiceClient() {
  ignore(rcl_client_fini(&client_, const_cast<rcl_node_t*>(node_.rcl())));
}

bool ServiceClient::is_available() const {
  bool available = false;
  check(rcl_service_server_is_available(node_.rcl(), &client_, &available), "look for a service");
  return available;
}

std::int64_t ServiceClient::send_any(const void* request) {
  std::int64_t number = 0;
  check(rcl_send_request(&client_, request, &number), "send a request");
  return number;
}

bool ServiceClient::take_any(std::int64_t request, void* response) {
  rmw_request_id_t header{};
  const rcl_ret_t taken = rcl_take_response(&client_, &header, response);
  if (taken == RCL_RET_CLIENT_TAKE_FAILED) {
    rcl_reset_error();
    return false;
  }
  check(taken, "take an answer");
  return header.sequence_number == request;
}

WaitSet::WaitSet(RosNode& node) {
  check(rcl_wait_set_init(&set_, 0, 2, 0, 0, 0, 0, node.context(), rcl_get_default_allocator()),
        "make a wait set");
}

WaitSet::~WaitSet() { ignore(rcl_wait_set_fini(&set_)); }

void WaitSet::begin(std::size_t subscriptions, std::size_t guards, std::size_t clients) {
  if (set_.size_of_subscriptions == subscriptions && set_.size_of_guard_conditions == guards &&
      set_.size_of_clients == clients) {
    check(rcl_wait_set_clear(&set_), "empty a wait set");
  } else {
    check(rcl_wait_set_resize(&set_, subscriptions, guards, 0, clients, 0, 0), "resize a wait set");
  }
}

void WaitSet::add(const SerializedSubscription& subscription) {
  check(rcl_wait_set_add_subscription(&set_, subscription.rcl(), nullptr), "wait for a topic");
}

void WaitSet::add(const rcl_guard_condition_t* guard) {
  check(rcl_wait_set_add_guard_condition(&set_, guard, nullptr), "wait for a notice");
}

void WaitSet::add(const ServiceClient& client) {
  check(rcl_wait_set_add_client(&set_, client.rcl(), nullptr), "wait for an answer");
}

void WaitSet::wait(std::int64_t timeout) {
  const rcl_ret_t result = rcl_wait(&set_, timeout);
  if (result == RCL_RET_TIMEOUT) {
    rcl_reset_error();
    return;
  }
  check(result, "wait");
}

bool WaitSet::is_subscription_ready(std::size_t index) const {
  return set_.subscriptions[index] != nullptr;
}

bool WaitSet::is_guard_ready(std::size_t index) const {
  return set_.guard_conditions[index] != nullptr;
}

namespace {

/// The type comes from another process.
bool is_identifier(std::string_view text) {
  return !text.empty() && std::ranges::all_of(text, [](unsigned char each) {
    return std::isalnum(each) != 0 || each == '_';
  });
}

std::string installed(const std::string& library) {
  const char* const prefixes = std::getenv("AMENT_PREFIX_PATH");
  std::istringstream listed(prefixes == nullptr ? "" : prefixes);
  for (std::string prefix; std::getline(listed, prefix, ':');) {
    std::string path = prefix + "/lib/" + library;
    if (!prefix.empty() && ::access(path.c_str(), R_OK) == 0) {
      return path;
    }
  }
  return library;
}

}  // namespace

const rosidl_message_type_support_t* message_type_support(const std::string& type) {
  const std::size_t first = type.find('/');
  const std::size_t last = type.rfind('/');
  if (first == std::string::npos || first == last) {
    throw std::runtime_error("it is not the name of a type");
  }
  const std::string package = type.substr(0, first);
  const std::string folder = type.substr(first + 1, last - first - 1);
  const std::string name = type.substr(last + 1);
  if (!is_identifier(package) || !is_identifier(folder) || !is_identifier(name)) {
    throw std::runtime_error("it is not the name of a type");
  }
  const std::string path = installed("lib" + package + "__rosidl_typesupport_c.so");
  void* const library = ::dlopen(path.c_str(), RTLD_LAZY | RTLD_LOCAL);
  if (library == nullptr) {
    throw std::runtime_error(::dlerror());
  }
  const std::string symbol = "rosidl_typesupport_c__get_message_type_support_handle__" + package +
                             "__" + folder + "__" + name;
  using Function = const rosidl_message_type_support_t* (*)();
  const auto function = reinterpret_cast<Function>(::dlsym(library, symbol.c_str()));
  if (function == nullptr) {
    throw std::runtime_error("it is not in " + path);
  }
  const rosidl_message_type_support_t* const found = function();
  if (found == nullptr) {
    throw std::runtime_error(path + " has no type support for it");
  }
  return found;
}

}  // namespace play_launch::topics
