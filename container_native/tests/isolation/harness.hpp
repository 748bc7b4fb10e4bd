#pragma once

#include <fcntl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <string>
#include <utility>

#include "check.hpp"
#include "isolation/clone/child.hpp"
#include "isolation/clone/donor_thread.hpp"
#include "isolation/crash/crash_handler.hpp"
#include "isolation/crash/symbolise.hpp"
#include "isolation/record/own_signals.hpp"

namespace isolation_test {

using namespace play_launch::isolation;

/// With ENDS_BY_KILL in the environment the programs do what the gate does where core dumps spread.
inline const bool ends_by_kill = [] {
  end_children_by_kill(std::getenv("ENDS_BY_KILL") != nullptr);
  return children_end_by_kill();
}();

/// A program from a function; cancel() sets `cancelled`.
class Program final : public ChildProgram {
 public:
  explicit Program(std::function<int(Program&)> body) : body_(std::move(body)) {}

  int run() override { return body_(*this); }
  void cancel() noexcept override { cancelled = true; }

  std::atomic<bool> cancelled{false};

 private:
  std::function<int(Program&)> body_;
};

/// One run of a program on a donor of its own.
struct Outcome {
  ChildEnd end;
  CrashSlot slot;

  std::string text() const { return describe_end(end, slot); }
};

inline std::uint64_t now_ns() {
  timespec time{};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<std::uint64_t>(time.tv_sec) * 1'000'000'000u +
         static_cast<std::uint64_t>(time.tv_nsec);
}

inline void run(Outcome& outcome, ChildProgram& program, const ChildOptions& options = {}) {
  DonorThread donor("donor", [&] { outcome.end = run_in_child(program, outcome.slot, options); });
}

inline void run(Outcome& outcome, std::function<int(Program&)> body,
                const ChildOptions& options = {}) {
  Program program(std::move(body));
  run(outcome, program, options);
}

/// A pipe to wait on what happens in another process or thread.
class Event {
 public:
  Event() { CHECK(::pipe2(ends_, O_CLOEXEC) == 0); }
  ~Event() {
    ::close(ends_[0]);
    ::close(ends_[1]);
  }
  Event(const Event&) = delete;
  Event& operator=(const Event&) = delete;

  void set() const { CHECK(::write(ends_[1], "x", 1) == 1); }
  void wait() const {
    char byte = 0;
    CHECK(::read(ends_[0], &byte, 1) == 1);
  }

 private:
  int ends_[2] = {-1, -1};
};

inline std::string joined(const CrashSlot& slot, std::chrono::steady_clock::time_point end =
                                                     std::chrono::steady_clock::time_point::max()) {
  std::string text;
  for (const std::string& line : symbolise(slot, end)) {
    text += line + "\n";
  }
  return text;
}

}  // namespace isolation_test
