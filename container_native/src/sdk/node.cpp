#include <rcl/logging.h>

#include <algorithm>
#include <exception>
#include <play_launch/context.hpp>
#include <play_launch/detail/running_node.hpp>
#include <play_launch/logging.hpp>
#include <play_launch/node.hpp>
#include <rcl_interfaces/msg/log.hpp>
#include <rcl_interfaces/msg/parameter_event.hpp>

#include "arguments.hpp"
#include "handles.hpp"
#include "parameter_store.hpp"
#include "ready_queue.hpp"

namespace play_launch {
namespace {

std::string logger_name(const std::string& full_name) {
  std::string name = full_name.substr(1);
  std::ranges::replace(name, '/', '.');
  return name;
}

}  // namespace

Node::Node(const std::string& default_name, const NodeOptions& options)
    : options_(options),
      logger_(default_name),
      default_group_(std::make_shared<CallbackGroup>(CallbackGroup::Kind::mutually_exclusive)),
      waitables_(std::make_unique<WaitableRegistry>()) {
  const NodeArguments arguments(options_);
  handle_ = std::make_shared<NodeHandle>(options_.context, default_name, "", arguments.rcl());
  name_ = rcl_node_get_name(handle_->rcl());
  name_space_ = rcl_node_get_namespace(handle_->rcl());
  full_name_ = rcl_node_get_fully_qualified_name(handle_->rcl());

  logger_ = Logger(logger_name(full_name_));
  if (const int level = arguments.log_level(logger_.name()); level != 0) logger_.set_level(level);
  if (options_.enable_rosout && rcl_logging_rosout_enabled()) {
    rosout_ = std::make_shared<PublisherHandle>(
        handle_,
        rosidl_typesupport_cpp::get_message_type_support_handle<rcl_interfaces::msg::Log>(),
        "/rosout", QoS::rosout());
    logger_.publish_to(rosout_);
  }

  parameters_ =
      std::make_shared<ParameterStore>(full_name_, arguments.parameter_overrides(full_name_));
  if (options_.start_parameter_services) start_parameter_services();
}

Node::~Node() = default;

void Node::start_parameter_services() {
  if (parameter_server_) return;
  parameters_->announce_on(std::make_shared<ParameterStore::Events>(
      handle_, "/parameter_events", QoS::parameter_events(), false));
  parameter_server_ = std::make_unique<ParameterServer>(*this, parameters_);
}

std::string Node::resolve_topic_name(const std::string& name) const {
  return handle_->resolve(name, false);
}

std::string Node::resolve_service_name(const std::string& name) const {
  return handle_->resolve(name, true);
}

std::shared_ptr<CallbackGroup> Node::create_callback_group(CallbackGroup::Kind kind) {
  return std::make_shared<CallbackGroup>(kind);
}

std::shared_ptr<Timer> Node::create_timer(std::chrono::nanoseconds period,
                                          std::function<void()> callback,
                                          std::shared_ptr<CallbackGroup> group) {
  auto timer = std::make_shared<Timer>(period, std::move(callback),
                                       group_or_default(std::move(group)), logger_);
  add_waitable(timer);
  return timer;
}

ParameterValue Node::get_parameter(const std::string& name) const {
  auto value = parameters_->get(name);
  if (!value) throw ParameterNotDeclared(name);
  return std::move(*value);
}

bool Node::has_parameter(const std::string& name) const {
  return parameters_->get(name).has_value();
}

SetParametersVerdict Node::set_parameters(const std::vector<Parameter>& parameters) {
  return parameters_->set(parameters);
}

void Node::on_set_parameters(
    std::function<SetParametersVerdict(const std::vector<Parameter>&)> callback) {
  parameters_->set_callback(std::move(callback));
}

void Node::add_waitable(const std::shared_ptr<Waitable>& waitable) { waitables_->add(waitable); }

ParameterValue Node::declare_value(const std::string& name, ParameterValue default_value) {
  return parameters_->declare(name, std::move(default_value));
}

ParameterValue Node::declare_required(const std::string& name, std::size_t type) {
  return parameters_->declare_required(name, type);
}

}  // namespace play_launch

namespace play_launch::detail {
namespace {

constinit thread_local const RunningNode* running = nullptr;

/// The logger's name is the node's with dots, which no name of a node has.
std::string node_name(std::string logger) {
  std::ranges::replace(logger, '.', '/');
  return "/" + logger;
}

/// Of the exception that is being handled.
std::string exception_text() {
  try {
    throw;
  } catch (const std::exception& error) {
    return error.what();
  } catch (...) {
    return "something unknown";
  }
}

}  // namespace

RunningNode::RunningNode(const char* name, const Logger* logger) noexcept
    : name_(name), logger_(logger), before_(running) {
  running = this;
}

RunningNode::~RunningNode() { running = before_; }

std::string RunningNode::name() const {
  if (logger_ != nullptr) return node_name(logger_->name());
  return name_ != nullptr ? name_ : "";
}

std::string RunningNode::full_name() { return running != nullptr ? running->name() : ""; }

void RunningNode::log_uncaught_exception() noexcept {
  if (running == nullptr || !std::current_exception()) return;
  try {
    const std::string name = full_name();
    if (name.empty()) return;
    const Logger logger =
        running->logger_ != nullptr ? *running->logger_ : Logger(logger_name(name));
    PLAY_LAUNCH_FATAL(logger, "a callback of node %s threw: %s", name.c_str(),
                      exception_text().c_str());
  } catch (...) {  // out of memory: the line is lost
  }
}

}  // namespace play_launch::detail
