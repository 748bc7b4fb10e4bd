#include "spawn_guard/zygote_line.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <vector>

#include "base/descriptor_message.hpp"

namespace play_launch::guard {

namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

/// The supervisor waits meanwhile. A zygote that is still being linked takes some of it.
constexpr milliseconds kZygotePatience{1000};

bool wait_for_input(int socket) {
  const auto deadline = steady_clock::now() + kZygotePatience;
  while (true) {
    const auto left =
        std::chrono::duration_cast<milliseconds>(deadline - steady_clock::now()).count();
    pollfd source{socket, POLLIN, 0};
    const int ready = ::poll(&source, 1, left > 0 ? static_cast<int>(left) : 0);
    if (ready >= 0 || errno != EINTR) {
      return ready > 0;
    }
  }
}

}  // namespace

Fork fork_of_zygote(int zygote, const UniqueFd& command, std::span<const UniqueFd> descriptors,
                    std::span<const std::int32_t> wanted) {
  std::array<int, 2> ends{};
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0) {
    return {-errno, {}};
  }
  UniqueFd line(ends[0]);
  UniqueFd theirs(ends[1]);
  std::vector<int> passed{theirs.get(), command.get()};
  for (const UniqueFd& each : descriptors) {
    passed.push_back(each.get());
  }
  if (!send_message(zygote, wanted, passed)) {
    return {-errno, {}};
  }
  theirs.reset();
  if (!wait_for_input(line.get())) {
    return {-ETIMEDOUT, {}};
  }
  DescriptorMessage answer;
  if (!answer.receive(line.get()) || answer.numbers.size() != 1) {
    return {-ECONNREFUSED, {}};
  }
  return {answer.numbers.front(), std::move(line)};
}

void let_begin(const Fork& fork) {
  // When it has died meanwhile, its end is an ordinary one.
  const std::array<std::int32_t, 1> go{1};
  send_message(fork.line.get(), go);
}

}  // namespace play_launch::guard
