#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

namespace play_launch::container {

/// What has happened in the life of an isolated node. A set that only grows, and not the latest of
/// a row of stages: a process can be killed at any instant, and how its end is reported depends on
/// all that was before it, such as whether the node had spun, or had left in order already.
enum class NodeLife : std::uint32_t {
  preparing = 0,          // nothing yet
  constructing = 1 << 0,  // it has a process, in which its constructor runs
  spinning = 1 << 1,      // constructed, and its callbacks run
  failed = 1 << 2,        // it cannot be loaded, and what there was of it is destroyed
  left = 1 << 3,          // it was to leave, and what there was of it is destroyed
  ended = 1 << 4,         // no process is left, as it failed or left in order
  died = 1 << 5,          // no process is left, and it ended in another way
  finished = 1 << 6,      // what can be cleaned up after it is, and no thread works on it
};

constexpr NodeLife operator|(NodeLife one, NodeLife other) {
  return NodeLife{static_cast<std::uint32_t>(one) | static_cast<std::uint32_t>(other)};
}

/// Whether any of `parts` has happened.
constexpr bool has_any(NodeLife life, NodeLife parts) {
  return (static_cast<std::uint32_t>(life) & static_cast<std::uint32_t>(parts)) != 0;
}

constexpr bool has_all(NodeLife life, NodeLife parts) { return (life | parts) == life; }

/// How the end of a process counts that had come so far; `clean`: according to the kernel.
constexpr NodeLife ending(NodeLife so_far, bool clean) {
  return clean && has_any(so_far, NodeLife::failed | NodeLife::left) ? NodeLife::ended
                                                                     : NodeLife::died;
}

/// Where a life is written by the node's threads and read by others. What goes with a part, such as
/// a name, is written before the part is added. Async-signal-safe.
class LifeRecord {
 public:
  void add(NodeLife part) noexcept { life_.fetch_or(static_cast<std::uint32_t>(part)); }
  NodeLife so_far() const noexcept { return NodeLife{life_.load()}; }

 private:
  std::atomic<std::uint32_t> life_{0};
};

/// The calls of NodeHostObserver.
enum class LifeCall : std::uint8_t { constructing, loaded, load_failed, gone, died, cleaned_up };

/// Which calls are due for a life, given those that were made. However seldom one looks, the calls
/// are the same.
class LifeCalls {
 public:
  /// The next one, which then counts as made; nothing without one.
  std::optional<LifeCall> next(NodeLife life);

 private:
  std::uint32_t made_ = 0;
};

}  // namespace play_launch::container
