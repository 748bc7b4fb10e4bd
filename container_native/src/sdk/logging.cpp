#include <rcl/error_handling.h>
#include <rcl/publisher.h>
#include <rcutils/time.h>

#include <array>
#include <atomic>
#include <cstdio>
#include <play_launch/logging.hpp>
#include <rcl_interfaces/msg/log.hpp>

#include "handles.hpp"

namespace play_launch {

struct Logger::State {
  std::string name;
  std::atomic<int> level;
  std::weak_ptr<PublisherHandle> rosout;
};

namespace {

std::string format_text(const char* format, va_list arguments) {
  std::array<char, 512> buffer;
  va_list again;
  va_copy(again, arguments);
  const int length = std::vsnprintf(buffer.data(), buffer.size(), format, arguments);
  std::string text;
  if (length >= 0 && static_cast<std::size_t>(length) < buffer.size()) {
    text.assign(buffer.data(), static_cast<std::size_t>(length));
  } else if (length >= 0) {
    text.resize(static_cast<std::size_t>(length));
    std::vsnprintf(text.data(), text.size() + 1, format, again);
  }
  va_end(again);
  return text;
}

/// The handlers of rcutils want a va_list.
void hand_over(rcutils_logging_output_handler_t handler, const rcutils_log_location_t& location,
               int severity, const char* name, rcutils_time_point_value_t stamp, const char* format,
               ...) {
  va_list arguments;
  va_start(arguments, format);
  handler(&location, severity, name, stamp, format, &arguments);
  va_end(arguments);
}

void publish(PublisherHandle& rosout, const rcutils_log_location_t& location, int severity,
             const std::string& name, rcutils_time_point_value_t stamp, std::string text) {
  constexpr rcutils_time_point_value_t kSecond = 1'000'000'000;
  rcl_interfaces::msg::Log message;
  message.stamp.sec = static_cast<std::int32_t>(stamp / kSecond);
  message.stamp.nanosec = static_cast<std::uint32_t>(stamp % kSecond);
  message.level = static_cast<std::uint8_t>(severity);
  message.name = name;
  message.msg = std::move(text);
  message.file = location.file_name;
  message.function = location.function_name;
  message.line = static_cast<std::uint32_t>(location.line_number);
  // A failure cannot be logged here; the console has the line.
  if (rcl_publish(rosout.rcl(), &message, nullptr) != RCL_RET_OK) rcl_reset_error();
}

}  // namespace

Logger::Logger(const std::string& name) : state_(std::make_shared<State>()) {
  state_->name = name;
  state_->level = rcutils_logging_get_logger_effective_level(name.c_str());
}

const std::string& Logger::name() const noexcept { return state_->name; }

int Logger::level() const noexcept { return state_->level.load(std::memory_order_relaxed); }

void Logger::set_level(int severity) noexcept {
  state_->level.store(severity, std::memory_order_relaxed);
}

void Logger::publish_to(const std::shared_ptr<PublisherHandle>& rosout) { state_->rosout = rosout; }

// rcl's own way to /rosout goes through a table of all nodes that no lock protects; here every node
// publishes for itself, so that nodes can come and go while others log.
void Logger::write(int severity, const rcutils_log_location_t& location, const char* format,
                   ...) const noexcept {
  try {
    va_list arguments;
    va_start(arguments, format);
    std::string text = format_text(format, arguments);
    va_end(arguments);
    rcutils_time_point_value_t stamp = 0;
    if (rcutils_system_time_now(&stamp) != RCUTILS_RET_OK) rcutils_reset_error();
    if (const auto handler = rcutils_logging_get_output_handler()) {
      hand_over(handler, location, severity, state_->name.c_str(), stamp, "%s", text.c_str());
    }
    if (const auto rosout = state_->rosout.lock()) {
      publish(*rosout, location, severity, state_->name, stamp, std::move(text));
    }
  } catch (...) {  // out of memory: the line is lost
  }
}

}  // namespace play_launch
