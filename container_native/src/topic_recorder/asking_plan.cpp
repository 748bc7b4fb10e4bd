#include "topic_recorder/asking_plan.hpp"

#include <algorithm>

namespace play_launch::topics {

void AskingPlan::see(const std::vector<AskableNode>& nodes, Time now) {
  for (auto& [name, entry] : entries_) {
    entry.gone = true;
  }
  for (const AskableNode& node : nodes) {
    const auto [place, is_new] = entries_.try_emplace(node.name);
    Entry& entry = place->second;
    entry.gone = false;
    if (is_new || !std::ranges::includes(entry.lives, node.lives)) {
      begin(entry, now);
    }
    entry.lives = node.lives;
  }
  std::erase_if(entries_, [](const auto& each) {
    return each.second.gone && each.second.state != State::asked;
  });
}

std::optional<std::string> AskingPlan::next(Time now) {
  if (now < due()) {
    return std::nullopt;
  }
  const auto place = std::ranges::find_if(entries_, [&](const auto& each) {
    return each.second.state == State::waiting && each.second.due <= now;
  });
  if (place == entries_.end()) {
    return std::nullopt;
  }
  place->second.state = State::asked;
  ++asked_;
  not_before_ = now + kBetween;
  return place->first;
}

void AskingPlan::answered(const std::string& name, Time now) { settle(name, State::done, now); }

bool AskingPlan::failed(const std::string& name, Time now) {
  Entry& entry = entries_.at(name);
  const bool is_given_up = ++entry.failures >= kMostFailures || entry.gone;
  entry.due = now + before_another_;
  settle(name, is_given_up ? State::done : State::waiting, now);
  return is_given_up;
}

AskingPlan::Time AskingPlan::due() const {
  Time first = Time::max();
  if (asked_ < kMostAtOnce) {
    for (const auto& [name, entry] : entries_) {
      if (entry.state == State::waiting) {
        first = std::min(first, entry.due);
      }
    }
  }
  return first == Time::max() ? first : std::max(first, not_before_);
}

void AskingPlan::begin(Entry& entry, Time now) {
  if (entry.state == State::asked) {
    entry.again = true;
    return;
  }
  entry.state = State::waiting;
  entry.due = now + kRest;
  entry.failures = 0;
}

void AskingPlan::settle(const std::string& name, State state, Time now) {
  --asked_;
  const auto place = entries_.find(name);
  Entry& entry = place->second;
  entry.state = state;
  if (entry.gone) {
    entries_.erase(place);
  } else if (entry.again) {
    entry.again = false;
    begin(entry, now);
  }
}

}  // namespace play_launch::topics
