#include "topic_recorder/parameter_survey.hpp"

#include <rcl/error_handling.h>
#include <rmw/rmw.h>

#include <algorithm>
#include <exception>
#include <iterator>
#include <memory>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <rosidl_typesupport_cpp/service_type_support.hpp>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "topic_recorder/chunk.hpp"

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

using play_launch_msgs::msg::NodeParameters;
using rcl_interfaces::msg::Parameter;
using rcl_interfaces::msg::ParameterValue;

namespace {

/// Counts the bytes of values in CDR. What rmw_serialize() calls a message's length is the estimate
/// that it took memory by: with empty lists it is too large, and strict readers refuse the rest.
class CdrSize {
 public:
  std::size_t bytes() const { return kEncapsulation + size_; }

  template <class... Values>
  void add(const Values&... values) {
    (value(values), ...);
  }

 private:
  static constexpr std::size_t kEncapsulation = 4;

  void scalar(std::size_t size) { size_ = (size_ + size - 1) / size * size + size; }

  template <class Number>
    requires std::is_arithmetic_v<Number>
  void value(const Number&) {
    scalar(sizeof(Number));
  }
  void value(const std::string& text) {
    scalar(sizeof(std::uint32_t));
    size_ += text.size() + 1;
  }
  void value(const std::vector<bool>& list) {
    scalar(sizeof(std::uint32_t));
    size_ += list.size();
  }
  template <class Each>
  void value(const std::vector<Each>& list) {
    scalar(sizeof(std::uint32_t));
    for (const Each& each : list) {
      value(each);
    }
  }
  void value(const ParameterValue& of) {
    add(of.type, of.bool_value, of.integer_value, of.double_value, of.string_value,
        of.byte_array_value, of.bool_array_value, of.integer_array_value, of.double_array_value,
        of.string_array_value);
  }
  void value(const Parameter& of) { add(of.name, of.value); }

  std::size_t size_ = 0;
};

}  // namespace

std::optional<std::size_t> put(NodeParameters parameters, std::uint64_t now, ChunkBuilder& chunk) {
  constexpr std::uint64_t kSecond = 1'000'000'000;
  parameters.stamp.sec = static_cast<std::int32_t>(now / kSecond);
  parameters.stamp.nanosec = static_cast<std::uint32_t>(now % kSecond);
  rmw_serialized_message_t message = message_in(chunk);
  const auto* const support =
      rosidl_typesupport_cpp::get_message_type_support_handle<NodeParameters>();
  if (rmw_serialize(&parameters, support, &message) != RMW_RET_OK) {
    rcl_reset_error();
    return std::nullopt;
  }
  CdrSize size;
  size.add(parameters.stamp.sec, parameters.stamp.nanosec, parameters.node, parameters.parameters,
           parameters.error);
  return size.bytes();
}

namespace {

constexpr std::chrono::milliseconds kBetweenQueries{50};
/// How long a node is left alone after it was found.
constexpr std::chrono::seconds kRest{1};
constexpr std::chrono::milliseconds kBetween{50};
constexpr std::size_t kMostAtOnce = 4;
/// After so many failures it is recorded that a node does not answer.
constexpr int kFailures = 2;
/// Limits the pause between two questions, which doubles with each failure.
constexpr int kMostDoublings = 6;

}  // namespace

void ParameterSurvey::follow_graph(Time now) {
  for (auto& [name, entry] : entries_) {
    entry.gone = true;
  }
  for (const AskableNode& node : node_.askable_nodes()) {
    const auto [place, is_new] = entries_.try_emplace(node.name);
    Entry& entry = place->second;
    entry.gone = false;
    if (is_new || !std::ranges::includes(entry.lives, node.lives)) {
      begin(entry, now);
    }
    entry.lives = node.lives;
  }
  std::erase_if(entries_,
                [](const auto& each) { return each.second.gone && !each.second.question; });
}

void ParameterSurvey::begin(Entry& entry, Time now) {
  entry.again = entry.question != nullptr;
  entry.due = now + kRest;
  entry.failures = 0;
}

bool ParameterSurvey::may_ask() const { return asked_ < kMostAtOnce; }

void ParameterSurvey::go_on(Time now, const OnResult& on_result) {
  for (auto place = entries_.begin(); place != entries_.end();) {
    auto& [name, entry] = *place;
    const bool begins = !entry.question && entry.due <= now && may_ask() && now >= not_before_;
    if (begins || entry.question) {
      if (std::optional<Parameters> result = ask(name, entry, now)) {
        settle(entry, std::move(*result), now, on_result);
      }
    }
    place = entry.gone && !entry.question ? entries_.erase(place) : std::next(place);
  }
}

/// Goes on with the question, which it begins if there is none; the result once there is one.
std::optional<ParameterSurvey::Parameters> ParameterSurvey::ask(const std::string& name,
                                                                Entry& entry, Time now) {
  try {
    if (!entry.question) {
      not_before_ = now + kBetween;
      entry.question = std::make_unique<ParameterQuestion>(node_, name, now + answer_timeout_);
      ++asked_;
    }
    return entry.question->go_on(now);
  } catch (const std::exception& error) {
    Parameters failed;
    failed.node = name;
    failed.error = error.what();
    return failed;
  }
}

void ParameterSurvey::settle(Entry& entry, Parameters result, Time now, const OnResult& on_result) {
  asked_ -= entry.question ? 1 : 0;
  entry.question.reset();
  const bool has_failed = !result.error.empty();
  entry.due = Time::max();
  if (has_failed) {
    entry.due = now + answer_timeout_ * (1 << std::min(++entry.failures, kMostDoublings));
  }
  if (!has_failed || entry.failures == kFailures || entry.gone) {
    on_result(std::move(result));
  }
  if (entry.again) {
    begin(entry, now);
  }
}

void ParameterSurvey::add_to(WaitSet& wait_set) const {
  for (const auto& [name, entry] : entries_) {
    if (entry.question) {
      entry.question->add_to(wait_set);
    }
  }
}

ParameterSurvey::Time ParameterSurvey::due(Time now) const {
  Time first = Time::max();
  for (const auto& [name, entry] : entries_) {
    if (entry.question) {
      first = std::min(
          first, entry.question->is_looking() ? now + kBetweenQueries : entry.question->until());
    } else if (may_ask() && entry.due != Time::max()) {
      first = std::min(first, std::max(entry.due, not_before_));
    }
  }
  return first;
}

}  // namespace play_launch::topics
