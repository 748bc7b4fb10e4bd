#pragma once

#include <signal.h>

#include <array>
#include <string>

#include "isolation/record/alternate_stack.hpp"

namespace play_launch::container {

/// While it exists, a fault or a call of exit() in the calling thread ends the container, as it
/// would without, but the container's log says before which library did it, and for which node:
/// initialisers of a library run in the container itself. exit() ends it by SIGABRT. One at a time.
class OpeningGuard {
 public:
  /// Prepares the thread; lives longer than the guards in it.
  class Thread {
   public:
    Thread() noexcept;
    ~Thread();
    Thread(const Thread&) = delete;
    Thread& operator=(const Thread&) = delete;

   private:
    isolation::AlternateStack stack_;
  };

  OpeningGuard(const std::string& node, const std::string& library);
  ~OpeningGuard();
  OpeningGuard(const OpeningGuard&) = delete;
  OpeningGuard& operator=(const OpeningGuard&) = delete;

 private:
  static constexpr std::array kSignals{SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTRAP, SIGSYS};

  std::string text_;
  std::array<struct sigaction, kSignals.size()> before_{};
};

}  // namespace play_launch::container
