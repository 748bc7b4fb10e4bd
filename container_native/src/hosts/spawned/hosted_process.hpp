#pragma once

#include <string>
#include <vector>

#include "base/process_identity.hpp"
#include "base/unique_fd.hpp"

namespace play_launch::container {

/// How a child process ended.
struct ProcessEnd {
  int exit_code = 0;
  int signal = 0;  // 0: it exited
};

/// A container of one node that this container started, as a process. It exits when the
/// other end of its control channel is closed, so with this container at the latest.
class HostedProcess {
 public:
  /// Starts this very program with these arguments, and `control_socket` as its control channel.
  /// Throws std::system_error.
  HostedProcess(const std::vector<std::string>& arguments, const UniqueFd& control_socket);
  HostedProcess(const HostedProcess&) = delete;
  HostedProcess& operator=(const HostedProcess&) = delete;
  /// Kills and reaps it, if it was not reaped.
  ~HostedProcess();

  const ProcessIdentity& identity() const { return identity_; }
  /// Readable when it is dead.
  int fd() const { return fd_.get(); }
  void signal(int number) const;

  /// Reaps it if it is dead; true then, and from then on.
  bool reap();
  bool is_reaped() const { return reaped_; }
  /// Valid when it was reaped.
  const ProcessEnd& end() const { return end_; }

 private:
  ProcessIdentity identity_;
  UniqueFd fd_;
  bool reaped_ = false;
  ProcessEnd end_;
};

}  // namespace play_launch::container
