#include "topic_recorder/parameter_survey.hpp"

#include <algorithm>
#include <exception>
#include <utility>

namespace play_launch::topics {
namespace {

constexpr std::chrono::milliseconds kBetweenLooks{50};

}  // namespace

void ParameterSurvey::follow_graph(Time now) { plan_.see(node_.askable_nodes(), now); }

void ParameterSurvey::go_on(Time now, const std::function<void(Parameters)>& on_result) {
  while (const auto name = plan_.next(now)) {
    begin(*name, now, on_result);
  }
  for (auto question = questions_.begin(); question != questions_.end();) {
    std::optional<Parameters> result = result_of(*question, now);
    if (!result) {
      ++question;
      continue;
    }
    question = questions_.erase(question);
    settle(std::move(*result), now, on_result);
  }
}

void ParameterSurvey::add_to(WaitSet& wait_set) const {
  for (const ParameterQuestion& question : questions_) {
    question.add_to(wait_set);
  }
}

ParameterSurvey::Time ParameterSurvey::due(Time now) const {
  Time first = plan_.due();
  for (const ParameterQuestion& question : questions_) {
    first = std::min(first, question.is_looking() ? now + kBetweenLooks : question.until());
  }
  return first;
}

std::optional<ParameterSurvey::Parameters> ParameterSurvey::result_of(ParameterQuestion& question,
                                                                      Time now) {
  const std::string name = question.name();
  try {
    return question.go_on(now);
  } catch (const std::exception& error) {
    Parameters failed;
    failed.node = name;
    failed.error = error.what();
    return failed;
  }
}

void ParameterSurvey::begin(const std::string& name, Time now,
                            const std::function<void(Parameters)>& on_result) {
  try {
    questions_.emplace_back(node_, name, now + answer_timeout_);
  } catch (const std::exception& error) {
    Parameters failed;
    failed.node = name;
    failed.error = error.what();
    settle(std::move(failed), now, on_result);
  }
}

void ParameterSurvey::settle(Parameters result, Time now,
                             const std::function<void(Parameters)>& on_result) {
  if (result.error.empty()) {
    plan_.answered(result.node, now);
  } else if (!plan_.failed(result.node, now)) {
    return;
  }
  on_result(std::move(result));
}

}  // namespace play_launch::topics
