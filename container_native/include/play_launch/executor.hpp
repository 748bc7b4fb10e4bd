#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace play_launch {

namespace detail {
class StopFlag;
struct ExecutorAccess;
}  // namespace detail

class Node;
struct ExecutorState;
struct RunningTurn;

/// Runs the callbacks of nodes. Nodes, and what nodes contain, may come and go while it spins. It
/// holds no lock while user code runs, and starts no thread outside of spin().
///
/// What a callback throws is caught nowhere in here, so that a process which ends for it does so
/// where it was thrown. It leaves SingleThreadedExecutor::spin(); MultiThreadedExecutor::spin()
/// cannot be caught: std::terminate() is called.
class Executor {
 public:
  /// Removes the nodes that are left. spin() must have returned.
  virtual ~Executor();
  Executor(const Executor&) = delete;
  Executor& operator=(const Executor&) = delete;

  /// Runs callbacks until cancel(), or until the context of one of its nodes is shut down. Throws
  /// std::logic_error when it is spinning already.
  virtual void spin() = 0;

  /// Makes spin() return after the callbacks that run now; also one that starts later: an executor
  /// is not used again after this. May be called from any thread and from a signal handler.
  void cancel() noexcept;

  /// Keeps the node and runs its callbacks. Throws std::logic_error when an executor has it.
  void add_node(std::shared_ptr<Node> node);

  /// Returns when no callback of the node is running; none will run afterwards. A node that is not
  /// here is ignored. Throws std::logic_error when called from a callback of that very node.
  void remove_node(const std::shared_ptr<Node>& node);

 protected:
  explicit Executor(std::shared_ptr<detail::StopFlag> stop);

  /// See ExecutorAccess.
  virtual void abandon();

  /// Works in the calling thread until cancelled.
  void work();
  /// Marks the executor as spinning for the life of the object.
  class Spinning {
   public:
    explicit Spinning(Executor& executor);
    ~Spinning();
    Spinning(const Spinning&) = delete;
    Spinning& operator=(const Spinning&) = delete;

   private:
    Executor& executor_;
  };

 private:
  friend struct detail::ExecutorAccess;

  void run(RunningTurn& turn, std::unique_lock<std::mutex>& lock);
  [[nodiscard]] std::int64_t next_look(std::int64_t due) const;
  void wait_for_work(std::uint32_t seen, std::unique_lock<std::mutex>& lock);

  std::unique_ptr<ExecutorState> state_;
};

/// Runs all callbacks one after the other, in the thread that calls spin().
class SingleThreadedExecutor final : public Executor {
 public:
  SingleThreadedExecutor();

  void spin() override;

 private:
  friend struct detail::ExecutorAccess;
  explicit SingleThreadedExecutor(std::shared_ptr<detail::StopFlag> stop);
};

/// Runs callbacks in several threads, as their callback groups allow.
class MultiThreadedExecutor final : public Executor {
 public:
  /// `threads` work in spin(), the calling one included; 0 = one per CPU, at least 2.
  explicit MultiThreadedExecutor(std::size_t threads = 0);

  void spin() override;
  [[nodiscard]] std::size_t threads() const noexcept { return threads_; }

 private:
  friend struct detail::ExecutorAccess;
  MultiThreadedExecutor(std::size_t threads, std::shared_ptr<detail::StopFlag> stop);
  void abandon() override;

  const std::size_t threads_;
  std::vector<std::thread> workers_;  // all but the thread that called spin()
};

}  // namespace play_launch
