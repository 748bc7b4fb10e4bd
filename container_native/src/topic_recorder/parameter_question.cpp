#include "topic_recorder/parameter_question.hpp"

#include <rosidl_typesupport_cpp/service_type_support.hpp>
#include <utility>

namespace play_launch::topics {
namespace {

using rcl_interfaces::srv::GetParameters;
using rcl_interfaces::srv::ListParameters;
using rosidl_typesupport_cpp::get_service_type_support_handle;

}  // namespace

ParameterQuestion::ParameterQuestion(RosNode& node, const std::string& name, Time until)
    : list_(node, get_service_type_support_handle<ListParameters>(), name + "/list_parameters"),
      get_(node, get_service_type_support_handle<GetParameters>(), name + "/get_parameters"),
      until_(until) {
  result_.node = name;
}

void ParameterQuestion::add_to(WaitSet& wait_set) const {
  wait_set.add(list_);
  wait_set.add(get_);
}

std::optional<ParameterQuestion::Parameters> ParameterQuestion::go_on(Time now) {
  if (step_ == Step::find && list_.is_available() && get_.is_available()) {
    request_ = list_.send(ListParameters::Request());
    step_ = Step::list;
  }
  if (ListParameters::Response listed; step_ == Step::list && list_.take(request_, listed)) {
    GetParameters::Request request;
    request.names = names_ = std::move(listed.result.names);
    if (names_.empty()) {
      return std::move(result_);
    }
    request_ = get_.send(request);
    step_ = Step::get;
  }
  if (GetParameters::Response got; step_ == Step::get && get_.take(request_, got)) {
    answer(got.values);
    return std::move(result_);
  }
  if (now >= until_) {
    result_.error = "it did not answer in time";
    return std::move(result_);
  }
  return std::nullopt;
}

void ParameterQuestion::answer(const std::vector<rcl_interfaces::msg::ParameterValue>& values) {
  if (values.size() != names_.size()) {
    // One of them is not declared any more.
    result_.error = "asked for " + std::to_string(names_.size()) + " parameters, it gave " +
                    std::to_string(values.size());
    return;
  }
  result_.parameters.resize(names_.size());
  for (std::size_t i = 0; i < names_.size(); ++i) {
    result_.parameters[i].name = std::move(names_[i]);
    result_.parameters[i].value = values[i];
  }
}

}  // namespace play_launch::topics
