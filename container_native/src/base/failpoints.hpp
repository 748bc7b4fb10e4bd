#pragma once

#include <stdexcept>
#include <string_view>

namespace play_launch {

/// Places where tests can make the container misbehave; failpoints.cpp has their names.
enum class Failpoint : unsigned {
  before_hello,      // ROS side is up, the hello is not sent
  after_accept,      // ControlAccepted is queued, construction has not begun
  before_construct,  // in the constructing thread
  after_construct,   // in the constructing thread, the constructor has returned
  drop_accepted,     // ControlAccepted is not sent
  drop_event,        // an event is not sent on the control channel; of those with a type
  ignore_query,      // ControlQuery is not answered
  before_unload,     // in the unloading thread
  on_shutdown,       // ControlShutdown was read
  during_stop,       // the stop has begun
  during_cleanup,    // in the process that cleans up after a dead node
  abrupt_deaths,     // nodes that crash, or get a signal, die with all threads where they are
  count
};

// In isolated modes constructing and unloading happen in the node's process, and what is done there
// is done to that process.

/// The specification makes no sense; the text says which part.
class FailpointError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Reads "name=action;name=action", the value of the option --failpoints. Nothing else arms them,
/// in particular no variable of the environment, which reaches every program below. Actions:
///   hang       the calling thread stops here forever
///   abort      the process dies of SIGABRT
///   kill       the process dies of SIGKILL
///   exit:N     the process exits at once with status N
///   delay:MS   the calling thread sleeps for MS milliseconds
///   once       hit() answers true the first time
///   always     hit() answers true
/// container.drop_event has a type instead, loading, loaded, failed, unloaded or crashed: hit()
/// answers true the first time it is given that one.
/// Throws FailpointError. Call it before there are threads.
void arm_failpoints(std::string_view specification);

/// Does what was asked for at this place. True: the caller leaves out what it was about to do.
/// Costs one load when nothing was asked for.
bool hit(Failpoint place);

/// Likewise for Failpoint::drop_event, with the type of the event as in
/// play_launch_msgs/ComponentEvent.
bool drops_event(unsigned type);

}  // namespace play_launch
