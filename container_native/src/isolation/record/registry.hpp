#pragma once

#include <sys/types.h>

#include <array>

#include "isolation/record/child_record.hpp"

namespace play_launch::isolation {

/// One place in the table by which a process finds its own record. Async-signal-safe.
class Registration {
 public:
  /// On the donor, before the child exists. The record must stay where it is.
  explicit Registration(ChildRecord& record) noexcept;
  ~Registration();
  Registration(const Registration&) = delete;
  Registration& operator=(const Registration&) = delete;

  /// False: kMaxChildren live already.
  explicit operator bool() const { return index_ < kMaxChildren; }

 private:
  std::size_t index_ = 0;
};

/// Writes the ids of the children that live now, but for expendable ones, into `pids`; their
/// number. Any thread.
std::size_t living_children(std::array<pid_t, kMaxChildren>& pids) noexcept;

}  // namespace play_launch::isolation
