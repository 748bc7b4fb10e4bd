#pragma once

#include <memory>

namespace play_launch {

struct ConstructionLedger;

/// What nodes have taken from the middleware while their constructors ran. Should the process in
/// which they run die there, nobody has the nodes and can destroy them; but with this, what they
/// took can be given back by another process that shares its memory.
class Construction {
 public:
  Construction();
  ~Construction();
  Construction(const Construction&) = delete;
  Construction& operator=(const Construction&) = delete;

  /// While it lives, what nodes take in the calling thread is kept track of. One at a time.
  class Watch {
   public:
    explicit Watch(Construction& construction);
    ~Watch();
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;

   private:
    Construction& construction_;
  };

  /// Whether the calling thread is watched.
  [[nodiscard]] static bool is_watched() noexcept;

  /// First of all, ends the watch of the calling thread: who cleans up after a process that died in
  /// a constructor runs on the thread that it ran on. Takes the nodes, publishers, subscriptions
  /// and services that are known off the middleware and off delivery by pointer. The objects stay,
  /// as nothing more than memory; their thread must be gone for good.
  void discard() noexcept;

 private:
  const std::shared_ptr<ConstructionLedger> ledger_;
};

/// Something that Construction keeps track of.
class Discardable {
 public:
  Discardable(const Discardable&) = delete;
  Discardable& operator=(const Discardable&) = delete;

 protected:
  Discardable() = default;
  ~Discardable() = default;

  /// At the end of the constructor: it is here now.
  void enter_ledger();
  /// In the destructor, first of all. False: it was discarded before.
  bool leave_ledger() noexcept;

 private:
  friend class Construction;
  virtual void discard() noexcept = 0;

  std::shared_ptr<ConstructionLedger> ledger_;
  bool discarded_ = false;
};

}  // namespace play_launch
