#pragma once

#include <functional>
#include <thread>

#include "isolation/record/crash_slot.hpp"

namespace play_launch::isolation {

/// Reports how this process itself, and no child of it, dies of a fault: for containers whose nodes
/// are threads. There is at most one.
///
/// The thread that causes one of the signals of install_crash_handlers() notes it in a slot, wakes
/// a thread that has waited for that, and dies of the signal when `report` has returned, but after
/// a second at the latest: what the dead one has locked or damaged may hold the other one up. So
/// `report`, unlike a handler, may use memory and locks; a fault in it ends it. Signals from other
/// processes are not reported. A stack that is used up is not, either: there is no room for a
/// handler.
class OwnCrashWatch {
 public:
  using Report = std::function<void(const CrashSlot&)>;

  /// Throws std::system_error.
  explicit OwnCrashWatch(Report report);
  OwnCrashWatch(const OwnCrashWatch&) = delete;
  OwnCrashWatch& operator=(const OwnCrashWatch&) = delete;
  ~OwnCrashWatch();

 private:
  void wait();

  const Report report_;
  std::thread thread_;
};

}  // namespace play_launch::isolation
