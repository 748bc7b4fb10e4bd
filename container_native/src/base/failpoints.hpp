#pragma once

#include <stdexcept>

namespace play_launch {

/// Places where tests can make the container misbehave; failpoints.cpp has their names.
enum class Failpoint : unsigned {
  before_hello,         // ROS side is up, the hello is not sent
  after_accept,         // ControlAccepted is queued, construction has not begun
  before_construct,     // in the constructing thread
  after_construct,      // in the constructing thread, the constructor has returned
  drop_accepted,        // ControlAccepted is not sent
  drop_event_loading,   // the event is not sent on the control channel
  drop_event_loaded,    // "
  drop_event_failed,    // "
  drop_event_unloaded,  // "
  drop_event_crashed,   // "
  ignore_query,         // ControlQuery is not answered
  before_unload,        // in the unloading thread
  on_shutdown,          // ControlShutdown was read
  during_stop,          // the stop has begun
  during_burial,        // in the process that cleans up after a dead node
  abrupt_deaths,        // nodes that crash, or get a signal, die with all threads where they are
  count
};

// In isolated modes constructing and unloading happen in the node's process, and what is done there
// is done to that process.

/// PLAY_LAUNCH_FAILPOINTS makes no sense; the text says which part.
class FailpointError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Reads PLAY_LAUNCH_FAILPOINTS="name=action;name=action". Actions:
///   hang       the calling thread stops here for ever
///   abort      the process dies of SIGABRT
///   kill       the process dies of SIGKILL
///   exit:N     the process exits at once with status N
///   delay:MS   the calling thread sleeps for MS milliseconds
///   once       hit() answers true the first time
///   always     hit() answers true
/// Throws FailpointError. Call it before there are threads.
void arm_failpoints(const char* specification);

/// Does what was asked for at this place. True: the caller leaves out what it was about to do.
/// Costs one load when nothing was asked for.
bool hit(Failpoint place);

}  // namespace play_launch
