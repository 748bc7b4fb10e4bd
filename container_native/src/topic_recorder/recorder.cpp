#include "topic_recorder/recorder.hpp"

#include <algorithm>
#include <exception>
#include <limits>
#include <utility>

#include "topic_recorder/chunk.hpp"
#include "topic_recorder/parameter_survey.hpp"
#include "topic_recorder/ros.hpp"
#include "topic_recorder/selection.hpp"

namespace play_launch::topics {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::seconds;

/// Until a chunk ends; a SIGKILL costs that, and the time in which the supervisor writes it.
constexpr milliseconds kLongestLive{150};
/// The grain in which held messages get too old.
constexpr milliseconds kLongestHeld{500};
/// Least time between two looks at the graph: while a system starts it changes all the time.
constexpr milliseconds kBetweenLooks{200};
constexpr milliseconds kBetweenSends{50};
constexpr seconds kBetweenReports{1};
/// How long the supervisor may take to write the last chunks, and we to take what has arrived.
constexpr seconds kLongestEnd{5};
/// Messages of one topic before the next one's turn.
constexpr std::size_t kAtOnce = 100;
/// Number of the request for the channel of parameters, which come from no topic.
constexpr auto kParametersRequest = std::numeric_limits<std::uint32_t>::max();

}  // namespace

Recorder::Recorder(const Options& options)
    : options_(options),
      clock_(options.clock_offset),
      arrival_(node_),
      wait_set_(node_),
      link_(UniqueFd(options.socket), [this] { arrival_.trigger(); }),
      outbox_(link_, spare_),
      ring_(spare_, options.hold_time, options.hold_size),
      live_(Treatment::recorded, kLongestLive, spare_),
      held_(Treatment::held, kLongestHeld, spare_),
      scratch_(MemoryFile()),
      survey_(node_, std::chrono::nanoseconds(options.answer_timeout)),
      measures_(options_, clock_, link_) {
  if (asks_for_parameters(options)) {
    link_.post(Packet(Kind::channel)
                   .number(kParametersRequest)
                   .text(kParametersTopic)
                   .text("play_launch_msgs/msg/NodeParameters")
                   .text(""));
  }
}

bool Recorder::run() {
  while (!stopping_) {
    wait();
    const auto now = Clock::now();
    for (OpenChunk* const open : {&live_, &held_}) {
      if (now >= open->due()) {
        finish(*open);
      }
    }
    send();
    report_drops(now);
    if (now >= measures_.due()) {
      take_rest(Treatment::measured);
      measures_.report(now);
    }
  }
  if (gone_) {
    return false;
  }
  // What has arrived by now belongs to the recording.
  take_rest(Treatment::recorded);
  finish(live_);
  drops_reported_ = {};
  report_drops(Clock::now());
  const auto end = Clock::now() + kLongestEnd;
  while (!outbox_.is_empty() && Clock::now() < end) {
    wait_set_.begin(0, 1);
    wait_set_.add(arrival_.rcl());
    wait_set_.wait(nanoseconds(kBetweenSends).count());
    for (const Request& request : link_.requests()) {
      if (request.kind == Kind::done) {
        outbox_.done(request.number);
      } else if (request.kind == Kind::gone) {
        return false;
      }
    }
    send();
  }
  return true;
}

void Recorder::send() {
  outbox_.send();
  if (snapshot_report_ && !outbox_.is_waiting_to_send()) {
    link_.post(*snapshot_report_);
    snapshot_report_.reset();
  }
}

void Recorder::wait() {
  std::vector<RecordedTopic*> waited;
  for (const auto& topic : topics_) {
    if (topic->subscription && topic->treatment != Treatment::measured) {
      waited.push_back(topic.get());
    }
  }
  wait_set_.begin(waited.size(), 2, survey_.clients());
  for (const RecordedTopic* topic : waited) {
    wait_set_.add(*topic->subscription);
  }
  wait_set_.add(node_.graph());
  wait_set_.add(arrival_.rcl());
  survey_.add_to(wait_set_);
  wait_set_.wait(timeout());
  graph_changed_ = graph_changed_ || wait_set_.is_guard_ready(0);
  for (std::size_t i = 0; i < waited.size(); ++i) {
    if (wait_set_.is_subscription_ready(i)) {
      take_some(*waited[i]);
    }
  }
  handle_requests();
  if (graph_changed_ && Clock::now() >= looked_ + kBetweenLooks) {
    follow_graph();
  }
  ask_for_parameters();
}

std::int64_t Recorder::timeout() const {
  auto until = std::min({live_.due(), held_.due(), measures_.due()});
  const auto now = Clock::now();
  if (graph_changed_) {
    until = std::min(until, looked_ + kBetweenLooks);
  }
  if (outbox_.is_waiting_to_send()) {
    until = std::min(until, now + kBetweenSends);
  }
  if (has_drops_) {
    until = std::min(until, drops_reported_ + kBetweenReports);
  }
  if (has_room()) {
    until = std::min(until, survey_.due(now));
  }
  if (until == Clock::time_point::max()) {
    return -1;
  }
  return std::max<std::int64_t>(0, nanoseconds(until - now).count());
}

void Recorder::handle_requests() {
  for (const Request& request : link_.requests()) {
    switch (request.kind) {
      case Kind::answer:
        give_channel(request.number, request.channel);
        break;
      case Kind::done:
        outbox_.done(request.number);
        ring_.set_elsewhere(outbox_.held_size());
        break;
      case Kind::take:
        hand_over(request.number);
        break;
      case Kind::stop:
        stopping_ = true;
        break;
      case Kind::gone:
        stopping_ = gone_ = true;
        break;
      default:
        break;
    }
  }
}

void Recorder::give_channel(std::uint32_t request, std::uint16_t channel) {
  if (request == kParametersRequest) {
    parameters_channel_ = channel;
    graph_changed_ = true;
    return;
  }
  if (request == 0 || request > topics_.size() || channel == 0) {
    return;  // the supervisor has reported why there is no channel
  }
  RecordedTopic& topic = *topics_[request - 1];
  topic.channel = channel;
  subscribe(topic);
  graph_changed_ = true;  // others may publish it by now
}

void Recorder::subscribe(RecordedTopic& topic) {
  try {
    topic.subscription = std::make_unique<SerializedSubscription>(node_, topic.type_support,
                                                                  topic.name, topic.request);
  } catch (const std::exception& error) {
    unsubscribe(topic, error.what());
  }
}

void Recorder::unsubscribe(RecordedTopic& topic, const std::string& reason) {
  topic.subscription.reset();
  warn_once(topic.name, topic.treatment, "of type " + topic.type + ": " + reason);
}

void Recorder::hand_over(std::uint32_t number) {
  // The last that arrived may be what explains a crash.
  take_rest(Treatment::held);
  finish(held_);
  ring_.expire(clock_.now_ns());
  std::uint64_t messages = 0;
  std::uint64_t bytes = 0;
  std::uint64_t first = 0;
  std::uint64_t last = 0;
  while (std::optional<Chunk> chunk = ring_.take()) {
    for (const ChannelPart& part : chunk->parts) {
      messages += part.messages;
    }
    bytes += chunk->length;
    first = first == 0 ? chunk->start_time : std::min(first, chunk->start_time);
    last = std::max(last, chunk->end_time);
    outbox_.add(std::move(*chunk), Treatment::held);
  }
  ring_.set_elsewhere(outbox_.held_size());
  snapshot_report_ = Packet(Kind::snapshot);
  snapshot_report_->number(number).number(messages).number(bytes).number(last - first);
  send();
}

void Recorder::follow_graph() {
  graph_changed_ = false;
  looked_ = Clock::now();
  if (parameters_channel_ != 0) {
    survey_.follow_graph(looked_);
  }
  measures_.forget_publishers();
  for (const GraphTopic& found : node_.topics()) {
    measures_.note(found, node_);
    const Treatment wanted = treatment(options_, found.name);
    if (wanted == Treatment::none) {
      continue;
    }
    const auto known =
        std::ranges::find(topics_, found.name, [](const auto& topic) { return topic->name; });
    if (known == topics_.end()) {
      meet(found, wanted);
    } else {
      reconsider(**known, found);
    }
  }
}

void Recorder::ask_for_parameters() {
  if (has_room()) {
    survey_.go_on(Clock::now(), [this](const auto& result) { record(result); });
  }
}

void Recorder::record(const ParameterSurvey::Parameters& parameters) {
  const std::uint64_t now = system_now_ns();
  ++parameters_sequence_;
  if (const auto size = put(parameters, now, live_.builder())) {
    append(live_, {parameters_channel_, parameters_sequence_, clock_.now_ns(), now}, *size);
  } else {
    const std::string reason = "those of " + parameters.node + " cannot be serialised";
    warn_once(kParametersTopic, Treatment::recorded, reason);
  }
}

void Recorder::meet(const GraphTopic& found, Treatment wanted) {
  if (warned_.contains(found.name)) {
    return;
  }
  const auto offered = node_.offered(found.name);
  if (offered.empty()) {
    return;  // nothing is said there yet, and of what quality is not known
  }
  if (found.types.size() != 1) {
    warn_once(found.name, wanted, "it has several types: " + found.types_in_words());
    return;
  }
  const std::string& type = found.types.front();
  const rosidl_message_type_support_t* support = nullptr;
  try {
    support = message_type_support(type);
  } catch (const std::exception& error) {
    warn_once(found.name, wanted, "of type " + type + ": " + error.what());
    return;
  }
  topics_.push_back(std::make_unique<RecordedTopic>(
      RecordedTopic{found.name, type, wanted, support, ByteBudget(budget_of(options_, found.name)),
                    request_for(offered, wanted), nullptr, measures_.find(found.name)}));
  if (wanted == Treatment::measured) {
    subscribe(*topics_.back());
    return;
  }
  link_.post(Packet(Kind::channel)
                 .number(static_cast<std::uint32_t>(topics_.size()))
                 .text(found.name)
                 .text(type)
                 .text(offered_qos_profiles(offered)));
}

void Recorder::reconsider(RecordedTopic& topic, const GraphTopic& found) {
  if (!topic.subscription) {
    return;
  }
  if (found.types.size() > 1 && warned_.insert(topic.name).second) {
    link_.post(Packet(Kind::warning)
                   .text("topic " + topic.name + " has several types by now (" +
                         found.types_in_words() + "): only " + topic.type + " is " +
                         in_words(topic.treatment)));
  }
  const auto offered = node_.offered(topic.name);
  if (offered.empty()) {
    return;
  }
  const rmw_qos_profile_t wanted = request_for(offered, topic.treatment);
  if (asks_too_much(topic.subscription->qos(), wanted)) {
    take_rest(topic.treatment);
    topic.request = wanted;
    topic.subscription.reset();
    subscribe(topic);
  }
}

void Recorder::warn_once(const std::string& topic, Treatment wanted, const std::string& text) {
  if (warned_.insert(topic).second) {
    const std::string lost = std::string(" is not ") + in_words(wanted) + ": ";
    link_.post(Packet(Kind::warning).text("topic " + topic + lost + text));
  }
}

void Recorder::take_rest(Treatment treatment) {
  const auto end = Clock::now() + kLongestEnd;
  for (const auto& topic : topics_) {
    // No more than can wait at a time: a publisher that goes on would keep us here.
    std::size_t left = topic->treatment == treatment ? topic->request.depth / kAtOnce + 1 : 0;
    for (; left > 0 && take_some(*topic); --left) {
      if (Clock::now() >= end) {
        link_.post(
            Packet(Kind::warning).text("messages that had arrived are not recorded: no time"));
        return;
      }
    }
  }
}

bool Recorder::take_some(RecordedTopic& topic) {
  for (std::size_t i = 0; topic.subscription && i < kAtOnce; ++i) {
    try {
      if (!take_one(topic)) return false;
    } catch (const std::exception& error) {
      unsubscribe(topic, error.what());
    }
  }
  return topic.subscription != nullptr;
}

bool Recorder::take_one(RecordedTopic& topic) {
  const bool is_full = topic.treatment == Treatment::recorded && !has_room();
  const bool is_kept = topic.treatment != Treatment::measured && !is_full;
  OpenChunk& open = topic.treatment == Treatment::held ? held_ : live_;
  rcl_serialized_message_t message = message_in(is_kept ? open.builder() : scratch_);
  rmw_message_info_t info = rmw_get_zero_initialized_message_info();
  if (!topic.subscription->take(message, info)) {
    return false;
  }
  const std::uint64_t received = clock_.received(info);
  if (topic.measure != nullptr) {
    topic.measure->note(received);
  }
  if (topic.treatment == Treatment::measured) {
    return true;
  }
  ++topic.sequence;
  const std::int64_t now = Clock::now().time_since_epoch().count();
  if (is_full || !topic.budget.spend(message.buffer_length, now)) {
    ++(is_full ? topic.without_room : topic.over_budget);
    has_drops_ = true;
    return true;
  }
  MessageHead head;
  head.channel = topic.channel;
  head.sequence = topic.sequence;
  // They are not given in the order in which they arrived: one that had to be sent again is given
  // before those that came meanwhile, and those of several publishers in any order.
  topic.log_time = std::max(topic.log_time, received);
  head.log_time = topic.log_time;
  head.publish_time =
      info.source_timestamp > 0 ? static_cast<std::uint64_t>(info.source_timestamp) : head.log_time;
  append(open, head, message.buffer_length);
  return true;
}

bool Recorder::has_room() const { return !live_.is_empty() || outbox_.has_room(); }

void Recorder::append(OpenChunk& open, const MessageHead& head, std::size_t size) {
  open.append(head, size);
  if (open.is_complete()) {
    finish(open);
  }
}

void Recorder::finish(OpenChunk& open) {
  std::optional<Chunk> chunk = open.finish();
  if (!chunk) {
    return;
  }
  if (chunk->file.data() == nullptr) {
    link_.post(Packet(Kind::warning).text("messages of topics are lost: out of memory"));
  } else if (open.treatment() == Treatment::held) {
    ring_.add(std::move(*chunk));
  } else {
    outbox_.add(std::move(*chunk), Treatment::recorded);
  }
}

void Recorder::report_drops(Clock::time_point now) {
  if (!has_drops_ || now < drops_reported_ + kBetweenReports) {
    return;
  }
  has_drops_ = false;
  drops_reported_ = now;
  for (const auto& topic : topics_) {
    if (topic->over_budget == 0 && topic->without_room == 0) {
      continue;
    }
    const Packet packet = Packet(Kind::drops)
                              .text(topic->name)
                              .number(topic->over_budget)
                              .number(topic->without_room);
    if (link_.send(packet)) {
      topic->over_budget = topic->without_room = 0;
    } else {
      has_drops_ = true;
    }
  }
}

}  // namespace play_launch::topics
