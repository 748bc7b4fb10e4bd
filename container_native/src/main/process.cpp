#include "main/process.hpp"

#include <pthread.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <exception>
#include <thread>
#include <utility>

#include "base/process.hpp"
#include "base/report.hpp"
#include "base/scheduling.hpp"
#include "fastdds/waits.hpp"
#include "main/host_choice.hpp"

namespace play_launch::container {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kMaxRequest = 64 * 1024;  // bytes

}  // namespace

struct Process::Request {
  UniqueFd control_socket;
  std::string number;
  std::vector<std::string> arguments;
};

Process::Process(const Options& options, int argc, const char* const* argv)
    : options_(options), shared_(make_backends(argc, argv)) {
  stop_.handle_signals();
  fastdds::replace_waits();
  context_guard_.emplace(shared_.backends.context(),
                         [this](const std::string& caller) { on_context_shutdown(caller); });
}

int Process::run_one(UniqueFd control_socket) {
  shared_.watchdog = &watchdog_;
  Container container(options_, shared_, stop_, std::move(control_socket), {});
  const Container::End end = container.run();
  if (!end.in_order) {
    leave_now(end.status);
  }
  return end.status;
}

int Process::run_many(UniqueFd requests) {
  requests_ = std::move(requests);
  std::thread taker([this] {
    ::pthread_setname_np(::pthread_self(), "requests");
    take_requests();
  });
  while (stop_.cause() == StopCause::none) {
    stop_.wait();
  }
  ::shutdown(requests_.get(), SHUT_RD);
  taker.join();
  stop_all();
  const int status = stop_.cause() == StopCause::context ? kExitContext : kExitOk;
  if (!std::ranges::all_of(hosted_, [](const auto& each) { return each->end->in_order; })) {
    leave_now(status);
  }
  return status;
}

void Process::on_context_shutdown(const std::string& caller) {
  std::call_once(shut_down_by_node_, [&] {
    const std::string why = caller + " shut the ROS context down";
    report(why + ", which all nodes of this container share: stopping");
    stop_.request(StopCause::context, why);
  });
}

void Process::take_requests() {
  std::vector<char> text(kMaxRequest);
  while (true) {
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
    iovec part{text.data(), text.size()};
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    const ssize_t size = ::recvmsg(requests_.get(), &message, MSG_CMSG_CLOEXEC);
    if (size < 0 && errno == EINTR) {
      continue;
    }
    if (size <= 0) {
      stop_.request(StopCause::closed);
      return;
    }
    Request request;
    if (const cmsghdr* const header = CMSG_FIRSTHDR(&message);
        header != nullptr && header->cmsg_type == SCM_RIGHTS) {
      int fd = -1;
      std::memcpy(&fd, CMSG_DATA(header), sizeof fd);
      // Kept from programs that nodes start, and from code of nodes that counts descriptors.
      request.control_socket = UniqueFd(move_to_high_number(fd));
    }
    const char* at = text.data();
    const char* const end = at + size;
    for (const char* stop; (stop = std::find(at, end, '\0')) != end; at = stop + 1) {
      request.arguments.emplace_back(at, stop);
    }
    if (!request.control_socket || request.arguments.empty() || at != end) {
      report("a request for a container makes no sense, and is ignored");
      continue;
    }
    request.number = std::move(request.arguments.front());
    request.arguments.front() = "component_container";
    begin(std::move(request));
  }
}

void Process::begin(Request request) {
  const std::lock_guard lock(mutex_);
  std::erase_if(hosted_, [](const auto& each) {
    const bool is_over = each->end && each->end->in_order;  // what is left of others uses it
    if (is_over) {
      each->thread.join();
    }
    return is_over;
  });
  auto& hosted = *hosted_.emplace_back(std::make_unique<Hosted>());
  try {
    hosted.thread = std::thread([this, &hosted, request = std::move(request)]() mutable {
      ::pthread_setname_np(::pthread_self(), "container");
      run(hosted, std::move(request));
    });
  } catch (const std::system_error& error) {
    report(std::string("a container has no thread: ") + error.what());
    hosted_.pop_back();  // its control channel ends
  }
}

void Process::run(Hosted& hosted, Request request) {
  Container::End end;
  end.status = kExitFailed;
  try {
    std::vector<const char*> arguments;
    for (const std::string& argument : request.arguments) {
      arguments.push_back(argument.c_str());
    }
    const Options options = parse_options(static_cast<int>(arguments.size()), arguments.data());
    Container container(options, shared_, hosted.stop, std::move(request.control_socket),
                        options.ros_arguments);
    end = container.run();
  } catch (const std::exception& error) {
    report(std::string("cannot start a container: ") + error.what());
  }
  const char* const state = end.is_poisoned ? " poisoned" : end.in_order ? " gone" : " left";
  const std::string text = request.number + " " + std::to_string(end.status) + state;
  ::send(requests_.get(), text.data(), text.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  {
    const std::lock_guard lock(mutex_);
    hosted.end = end;
  }
  stop_.wake();
}

bool Process::are_done() {
  const std::lock_guard lock(mutex_);
  return std::ranges::all_of(hosted_, [](const auto& each) { return each->end.has_value(); });
}

void Process::stop_all() {
  const StopCause cause = stop_.cause();
  const auto limit =
      cause == StopCause::closed
          ? kOrphanLifeLimit
          : std::chrono::duration_cast<Clock::duration>(options_.stop_timeout) + kTeardownLimit;
  watchdog_.arm(Clock::now() + limit, cause == StopCause::context ? kExitContext : kExitOk,
                "taking the containers apart takes too long: leaving");
  // Where the supervisor has gone, their own channels have told them, and a second request would
  // cut their stop short.
  if (cause == StopCause::context) {
    for (const auto& each : hosted_) {
      each->stop.request(cause, stop_.why());
    }
  }
  while (!are_done()) {
    for (const auto& each : hosted_) {
      each->stop.wake();  // signals count for all
    }
    stop_.wait();
  }
  for (const auto& each : hosted_) {
    each->thread.join();
  }
}

}  // namespace play_launch::container
