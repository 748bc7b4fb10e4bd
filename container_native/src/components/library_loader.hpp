#pragma once

#include <signal.h>

#include <array>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include "components/component_backend.hpp"
#include "isolation/record/child_threads.hpp"

namespace play_launch::container {

/// Opens libraries of components, one after the other, in a thread of the container that lives as
/// long as the container does: what a library's initialisers start, such as a pool of threads, does
/// not go down with the first node that needs the library. A library that is open is never given to
/// the dynamic loader again, whose lock is held for as long as another one's initialisers run.
/// Libraries stay open: code of a library may be needed until the process ends, for example by a
/// message's deleter, a thread_local or a handler it registered. Where the file has changed since,
/// the container's log says so.
///
/// All members may be called from several threads of the container, none from a child.
class LibraryLoader {
 public:
  LibraryLoader() = default;
  /// Waits for the library that is being opened.
  ~LibraryLoader();
  LibraryLoader(const LibraryLoader&) = delete;
  LibraryLoader& operator=(const LibraryLoader&) = delete;

  /// The library, at once if it is open already; else waits until it has been opened. `unique_id`
  /// and `node` name the requester. Throws LoadError.
  const ComponentLibrary& open(ComponentBackend& backend, const std::string& path,
                               std::uint64_t unique_id, const std::string& node);

  /// While open() waits for that node: path of the library that is being opened, its own or one
  /// before it. Empty otherwise.
  std::string opening_for(std::uint64_t unique_id) const;

 private:
  struct Order {
    ComponentBackend& backend;
    const std::string path;
    const std::string node;
    bool done = false;
    std::string failure;
  };
  using Key = std::pair<const ComponentBackend*, std::string>;
  struct Opened {
    std::unique_ptr<ComponentLibrary> library;
    std::filesystem::file_time_type written;  // min() where the file could not be read
  };

  std::shared_ptr<Order> order(ComponentBackend& backend, const std::string& path,
                               const std::string& node);
  void work();
  void carry_out(Order& order);

  mutable std::mutex mutex_;  // guards what follows; never held while a library is opened
  std::condition_variable changed_;
  std::map<Key, Opened> open_;                 // nothing is removed
  std::deque<std::shared_ptr<Order>> orders_;  // the first one is being carried out
  std::map<std::uint64_t, std::shared_ptr<Order>> waiting_;
  bool done_ = false;
  std::thread thread_;  // from the first order on
};

/// Opens a library with ComponentBackend::open(). With ROS from PyPI's wheels, a library that was
/// linked, without need, against the Python half of an interface package wants symbols of libpython
/// that no library defines; it gets stand-ins. One that brings libpython along gets its own. In one
/// thread at a time. Throws LoadError.
std::unique_ptr<ComponentLibrary> open_library(ComponentBackend& backend, const std::string& path);

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
