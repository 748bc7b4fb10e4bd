#include "components/library_loader.hpp"

#include <pthread.h>
#include <string.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <system_error>

#include "base/report.hpp"
#include "isolation/record/own_signals.hpp"
#include "overrides/exit_guard.hpp"
#include "overrides/type_supports.hpp"

namespace play_launch::container {
namespace {

std::filesystem::file_time_type write_time(const std::string& path) {
  std::error_code unreadable;
  return std::filesystem::last_write_time(path, unreadable);
}

}  // namespace

LibraryLoader::~LibraryLoader() {
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) {
    thread_.join();
  }
}

std::shared_ptr<LibraryLoader::Order> LibraryLoader::order(ComponentBackend& backend,
                                                           const std::string& path,
                                                           const std::string& node) {
  const auto found = std::ranges::find_if(orders_, [&](const std::shared_ptr<Order>& order) {
    return &order->backend == &backend && order->path == path;
  });
  if (found != orders_.end()) {
    return *found;
  }
  if (!thread_.joinable()) {
    thread_ = std::thread([this] { work(); });
  }
  return orders_.emplace_back(std::make_shared<Order>(Order{backend, path, node, false, {}}));
}

const ComponentLibrary& LibraryLoader::open(ComponentBackend& backend, const std::string& path,
                                            std::uint64_t unique_id, const std::string& node) {
  const Key key(&backend, path);
  std::unique_lock lock(mutex_);
  if (const auto found = open_.find(key); found != open_.end()) {
    const Opened& opened = found->second;
    lock.unlock();
    if (write_time(path) != opened.written) {
      report(path + " has changed since it was loaded: node " + node +
             " gets the code as it was, until the container is restarted");
    }
    return *opened.library;
  }
  const std::shared_ptr<Order> order = this->order(backend, path, node);
  waiting_.emplace(unique_id, order);
  changed_.notify_all();
  changed_.wait(lock, [&] { return order->done; });
  waiting_.erase(unique_id);
  if (!order->failure.empty()) {
    throw LoadError(order->failure);
  }
  return *open_.at(key).library;
}

std::string LibraryLoader::opening_for(std::uint64_t unique_id) const {
  const std::lock_guard lock(mutex_);
  return waiting_.contains(unique_id) && !orders_.empty() ? orders_.front()->path : "";
}

void LibraryLoader::work() {
  ::pthread_setname_np(::pthread_self(), "loader");
  const OpeningGuard::Thread guarded;
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return done_ || !orders_.empty(); });
    if (orders_.empty()) {
      return;
    }
    const std::shared_ptr<Order> order = orders_.front();
    lock.unlock();
    carry_out(*order);
    lock.lock();
    orders_.pop_front();
    order->done = true;
    changed_.notify_all();
  }
}

void LibraryLoader::carry_out(Order& order) {
  try {
    const auto written = write_time(order.path);
    const OpeningGuard guard(order.node, order.path);
    std::unique_ptr<ComponentLibrary> library = open_library(order.backend, order.path);
    isolation::look_up_type_supports(order.path.c_str());
    const std::lock_guard lock(mutex_);
    open_.emplace(Key(&order.backend, order.path), Opened{std::move(library), written});
  } catch (...) {
    order.failure = describe_current_exception();
  }
}

}  // namespace play_launch::container

// In programs that use ROS from PyPI's wheels only: see python_symbols.c.
extern "C" [[gnu::weak, gnu::visibility("hidden")]] void play_launch_stand_in_for_python(
    int active);

namespace play_launch::container {
namespace {

bool lacks_python(const std::string& failure) {
  return play_launch_stand_in_for_python != nullptr &&
         failure.find("undefined symbol: ") != std::string::npos &&
         (failure.find("PyExc_RuntimeError") != std::string::npos ||
          failure.find("_Py_TrueStruct") != std::string::npos);
}

}  // namespace

std::unique_ptr<ComponentLibrary> open_library(ComponentBackend& backend, const std::string& path) {
  try {
    return backend.open(path);
  } catch (const LoadError& error) {
    if (!lacks_python(error.what())) {
      throw;
    }
  }
  struct Lending {
    Lending() { play_launch_stand_in_for_python(1); }
    ~Lending() { play_launch_stand_in_for_python(0); }
  } const lending;
  return backend.open(path);
}

namespace {

std::atomic<const char*> text{nullptr};
std::atomic<pid_t> thread{0};
pid_t process = 0;

/// Reports how the initialiser that runs in the calling thread ends the container; once.
void report_end(const char* how, const char* what) {
  const char* const known = text;
  if (known == nullptr || ::gettid() != thread || ::getpid() != process) {
    return;
  }
  // Put together without the allocator, which may be what crashed.
  std::array<char, 1024> line{};
  constexpr std::size_t kRoom = 64;
  ::strncpy(line.data(), known, line.size() - kRoom);
  ::strcat(line.data(), how);
  ::strncat(line.data(), what, kRoom / 2);
  report(line.data());
  text = nullptr;
}

void on_fault(int signal, siginfo_t* info, void* context) {
  const int error = errno;
  isolation::is_surviving(*info);  // in another thread, which reads what a crash has damaged
  const char* const name = ::sigabbrev_np(signal);
  report_end(name != nullptr ? "died of SIG" : "died of a signal", name != nullptr ? name : "");
  isolation::die_in_place(signal, *info, context);
  errno = error;
}

/// The container's own exit handlers and destructors would run, while its threads do.
void on_exit_call(const char* call) {
  if (text != nullptr && ::gettid() == thread && ::getpid() == process) {
    report_end("called ", call);
    std::abort();
  }
}

}  // namespace

OpeningGuard::Thread::Thread() noexcept {
  if (stack_) {
    stack_.use();
  }
}

OpeningGuard::Thread::~Thread() { isolation::AlternateStack::stop_using(); }

OpeningGuard::OpeningGuard(const std::string& node, const std::string& library)
    : text_("the container ends: opening " + library + " for node " + node +
            ", an initialiser of it ") {
  process = ::getpid();
  thread = ::gettid();
  text = text_.c_str();
  isolation::set_exit_hook(on_exit_call);
  struct sigaction action{};
  action.sa_sigaction = on_fault;
  action.sa_flags = SA_SIGINFO | SA_RESTART | SA_ONSTACK;
  sigfillset(&action.sa_mask);
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    ::sigaction(kSignals[i], &action, &before_[i]);
  }
}

OpeningGuard::~OpeningGuard() {
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    struct sigaction now{};
    ::sigaction(kSignals[i], nullptr, &now);
    if ((now.sa_flags & SA_SIGINFO) != 0 && now.sa_sigaction == on_fault) {
      ::sigaction(kSignals[i], &before_[i], nullptr);  // unless the library has put in its own
    }
  }
  isolation::set_exit_hook(nullptr);
  text = nullptr;
}

}  // namespace play_launch::container
