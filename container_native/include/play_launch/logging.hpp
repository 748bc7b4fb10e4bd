#pragma once

#include <rcutils/logging.h>

#include <cstdarg>
#include <memory>
#include <string>

namespace play_launch {

class Node;
class PublisherHandle;

/// Writes log lines of one name to the console, to the process's log file and, for a node with
/// rosout, to /rosout. A cheap handle: copies share name, level and destination. May be kept longer
/// than its node (then nothing goes to /rosout any more) and used from any thread.
class Logger {
 public:
  /// A logger without /rosout, at the level the process's arguments give it.
  explicit Logger(const std::string& name);

  [[nodiscard]] const std::string& name() const noexcept;

  /// Least severity that is logged, a RCUTILS_LOG_SEVERITY number.
  [[nodiscard]] int level() const noexcept;
  void set_level(int severity) noexcept;
  [[nodiscard]] bool enabled_for(int severity) const noexcept { return severity >= level(); }

  /// Formats as printf and writes, whatever the level is. Never throws.
  void write(int severity, const rcutils_log_location_t& location, const char* format,
             ...) const noexcept __attribute__((format(printf, 4, 5)));

 private:
  friend class Node;
  struct State;

  /// Sends what is logged to that publisher of rcl_interfaces/Log too, as long as it lives. To be
  /// called before the logger is handed out.
  void publish_to(const std::shared_ptr<PublisherHandle>& rosout);

  std::shared_ptr<State> state_;
};

}  // namespace play_launch

/// PLAY_LAUNCH_INFO(logger, "loaded %zu nodes", count) and its siblings: arguments are evaluated
/// only when the logger is enabled for the severity.
#define PLAY_LAUNCH_LOG(logger, severity, ...)                                                   \
  do {                                                                                           \
    if ((logger).enabled_for(severity)) {                                                        \
      static const rcutils_log_location_t play_launch_location = {__func__, __FILE__, __LINE__}; \
      (logger).write(severity, play_launch_location, __VA_ARGS__);                               \
    }                                                                                            \
  } while (false)
#define PLAY_LAUNCH_DEBUG(logger, ...) \
  PLAY_LAUNCH_LOG(logger, RCUTILS_LOG_SEVERITY_DEBUG, __VA_ARGS__)
#define PLAY_LAUNCH_INFO(logger, ...) \
  PLAY_LAUNCH_LOG(logger, RCUTILS_LOG_SEVERITY_INFO, __VA_ARGS__)
#define PLAY_LAUNCH_WARN(logger, ...) \
  PLAY_LAUNCH_LOG(logger, RCUTILS_LOG_SEVERITY_WARN, __VA_ARGS__)
#define PLAY_LAUNCH_ERROR(logger, ...) \
  PLAY_LAUNCH_LOG(logger, RCUTILS_LOG_SEVERITY_ERROR, __VA_ARGS__)
#define PLAY_LAUNCH_FATAL(logger, ...) \
  PLAY_LAUNCH_LOG(logger, RCUTILS_LOG_SEVERITY_FATAL, __VA_ARGS__)
