#include "topic_recorder/measures.hpp"

namespace play_launch::topics {

Measures::Measures(const Options& options, const SessionClock& clock, SupervisorLink& link)
    : options_(options), clock_(clock), link_(link) {
  for (const std::string& topic : options.measured) {
    if (!is_pattern(topic)) {
      add(topic);
    }
  }
}

void Measures::add(const std::string& topic) {
  Measure& added = measures_.emplace_back();
  added.topic = topic;
  added.latest = clock_.now_ns();
}

Measure* Measures::find(const std::string& topic) {
  const auto found = std::ranges::find(measures_, topic, &Measure::topic);
  return found == measures_.end() ? nullptr : &*found;
}

void Measures::forget_publishers() {
  for (Measure& measure : measures_) {
    measure.publishers = measure.reliable = measure.latched = 0;
  }
}

void Measures::note(const GraphTopic& found, const RosNode& node) {
  if (!is_measured(options_, found.name)) {
    return;
  }
  if (find(found.name) == nullptr) {
    add(found.name);
  }
  Measure& measure = *find(found.name);
  const auto offered = node.offered(found.name);
  measure.types = found.types_in_words();
  measure.publishers = static_cast<std::uint32_t>(offered.size());
  measure.reliable = static_cast<std::uint32_t>(std::ranges::count_if(offered, is_reliable));
  measure.latched = static_cast<std::uint32_t>(std::ranges::count_if(offered, is_latched));
}

Measures::Clock::time_point Measures::due() const {
  return measures_.empty() ? Clock::time_point::max() : looked_ + kBetweenLooks;
}

void Measures::report(Clock::time_point now) {
  looked_ = now;
  if (now < reported_ + kBetweenReports) {
    return;
  }
  const auto since = std::chrono::nanoseconds(now - reported_).count();
  reported_ = now;
  const std::uint64_t until = clock_.now_ns();
  for (Measure& measure : measures_) {
    const std::uint64_t silent = until - std::min(until, measure.latest);
    // Without room it is lost, and the next one is as good.
    link_.send(Packet(Kind::measured)
                   .text(measure.topic)
                   .text(measure.types)
                   .number(measure.publishers)
                   .number(measure.reliable)
                   .number(measure.latched)
                   .number(measure.messages)
                   .number(std::max(measure.gap, silent))
                   .number(static_cast<std::uint64_t>(since)));
    measure.messages = measure.gap = 0;
  }
}

}  // namespace play_launch::topics
