#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "topic_recorder/chunk.hpp"
#include "topic_recorder/measures.hpp"
#include "topic_recorder/outbox.hpp"
#include "topic_recorder/parameter_survey.hpp"
#include "topic_recorder/recorded_topic.hpp"
#include "topic_recorder/ros.hpp"
#include "topic_recorder/selection.hpp"
#include "topic_recorder/supervisor_link.hpp"

namespace play_launch::topics {

/// Follows the graph, subscribes to what is asked for, makes chunks of what comes and hands them to
/// the supervisor. One thread does all of it.
class Recorder {
 public:
  /// Throws std::runtime_error.
  explicit Recorder(const Options& options);

  /// Until the supervisor asks for the end, or has gone. Returns whether it is still there.
  bool run();

 private:
  using Clock = std::chrono::steady_clock;

  void wait();
  void send();
  [[nodiscard]] std::int64_t timeout() const;
  void handle_requests();
  void give_channel(std::uint32_t request, std::uint16_t channel);
  void subscribe(RecordedTopic& topic);
  void unsubscribe(RecordedTopic& topic, const std::string& reason);
  void hand_over(std::uint32_t number);
  void follow_graph();
  void meet(const GraphTopic& found, Treatment treatment);
  void reconsider(RecordedTopic& topic, const GraphTopic& found);
  void warn_once(const std::string& topic, Treatment wanted, const std::string& text);
  /// Takes what waits by now for topics that are treated like that, as far as time permits.
  void take_rest(Treatment treatment);
  /// Takes some; whether more may wait.
  bool take_some(RecordedTopic& topic);
  bool take_one(RecordedTopic& topic);
  void ask_for_parameters();
  void record(const ParameterSurvey::Parameters& parameters);
  [[nodiscard]] bool has_room() const;
  void append(OpenChunk& open, const MessageHead& head, std::size_t size);
  void finish(OpenChunk& open);
  void report_drops(Clock::time_point now);

  const Options options_;
  SessionClock clock_;
  RosNode node_;
  GuardCondition arrival_;
  WaitSet wait_set_;
  SupervisorLink link_;
  SpareFiles spare_;
  Outbox outbox_;
  Ring ring_;
  OpenChunk live_;
  OpenChunk held_;
  /// For messages that are not kept.
  ChunkBuilder scratch_;
  ParameterSurvey survey_;
  /// For what nodes answer; 0 when they are not asked.
  std::uint16_t parameters_channel_ = 0;
  std::uint32_t parameters_sequence_ = 0;
  /// By the number of their request for a channel, from 1 on.
  std::vector<std::unique_ptr<RecordedTopic>> topics_;
  Measures measures_;
  /// Topics that were complained of.
  std::set<std::string> warned_;
  bool graph_changed_ = true;
  Clock::time_point looked_{};
  Clock::time_point drops_reported_{};
  /// Sent after the chunks that it is about.
  std::optional<Packet> snapshot_report_;
  bool has_drops_ = false;
  bool stopping_ = false;
  bool gone_ = false;
};

}  // namespace play_launch::topics
