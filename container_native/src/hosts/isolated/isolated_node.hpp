#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include "components/load_request.hpp"
#include "hosts/isolated/leave_pressure.hpp"
#include "hosts/node_host.hpp"

namespace play_launch::container {

/// HostTotals while they grow.
struct IsolationTotals {
  std::atomic<std::uint32_t> crashes{0};
  std::atomic<std::uint32_t> undertaken{0};
  std::atomic<std::uint32_t> leaked{0};
  std::atomic<std::uint32_t> unquiesced{0};
};

/// One node in a process of its own, and what remains to be done about it. All but leave() is for
/// one thread, the monitor's.
class IsolatedNode {
 public:
  using Time = LeavePressure::Time;

  /// `doorbell` is an eventfd that is rung when there is something new to tell.
  IsolatedNode(std::uint64_t unique_id, int doorbell)
      : unique_id_(unique_id), doorbell_(doorbell) {}
  IsolatedNode(const IsolatedNode&) = delete;
  IsolatedNode& operator=(const IsolatedNode&) = delete;
  virtual ~IsolatedNode() = default;

  /// Asks the node to leave. Any thread.
  void leave() noexcept;

  /// Does what is due for a node that should leave, and returns when to come again (max: not by
  /// itself). `end`: when it must be gone (max: whenever).
  Time press(Time now, Time end);

  /// Tells the observer what has happened since the last call. Counts deaths in `totals`.
  virtual void tell(NodeHostObserver& observer, IsolationTotals& totals) = 0;

  /// Whether the node's processes are gone for good, and everything is told.
  virtual bool is_over() const = 0;

  /// How long its executor has not come round; nothing: that is not known. Any thread.
  virtual std::optional<std::chrono::nanoseconds> silence() const { return std::nullopt; }

  /// Becomes readable when tell() should be called, besides the doorbell; -1: there is none.
  virtual int watched_fd() const { return -1; }

 protected:
  virtual bool is_dead() const = 0;
  virtual const LoadRequest& request() const = 0;
  /// Full name; empty while it is not known.
  virtual std::string full_name() const = 0;
  virtual void ask_to_leave() = 0;
  /// False: it has no process, as long as its library is being opened.
  virtual bool signal(int number) = 0;
  /// It is dead, and there is no time left for what is done about it.
  virtual void abandon() {}

  std::uint64_t unique_id() const { return unique_id_; }
  int doorbell() const { return doorbell_; }
  /// For messages to people.
  std::string label() const;

 private:
  const std::uint64_t unique_id_;
  const int doorbell_;
  std::atomic<bool> leaving_{false};
  LeavePressure pressure_;
};

}  // namespace play_launch::container
