// A channel over a real socket pair: order, bounds, the end of the stream.

#include "control/channel.hpp"

#include <sys/socket.h>

#include <future>

#include "check.hpp"

using namespace play_launch::control;
using namespace std::chrono_literals;

namespace {

constexpr auto kPatience = 20s;

class Recorder final : public ChannelHandler {
 public:
  void on_frame(const Frame& frame) override {
    if (frame.payload.size() == 1 && frame.payload[0] == 'x') {
      throw ProtocolError("x");
    }
    frames.push_back(frame);
    if (frames.size() == wanted) {
      enough.set_value();
    }
  }
  void on_closed() override { ended.set_value("closed"); }
  void on_protocol_error(const std::string& what) override { ended.set_value(what); }

  std::string end() {
    auto future = ended.get_future();
    CHECK(future.wait_for(kPatience) == std::future_status::ready);
    return future.get();
  }

  std::size_t wanted = 0;
  std::vector<Frame> frames;
  std::promise<void> enough;
  std::promise<std::string> ended;
};

std::pair<play_launch::UniqueFd, play_launch::UniqueFd> socket_pair() {
  int fds[2];
  CHECK(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fds) == 0);
  return {play_launch::UniqueFd(fds[0]), play_launch::UniqueFd(fds[1])};
}

void send_raw(const play_launch::UniqueFd& fd, std::span<const std::uint8_t> bytes) {
  CHECK(::send(fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL) ==
        static_cast<ssize_t>(bytes.size()));
}

std::vector<std::uint8_t> number(std::uint32_t value) {
  return {static_cast<std::uint8_t>(value), static_cast<std::uint8_t>(value >> 8),
          static_cast<std::uint8_t>(value >> 16), static_cast<std::uint8_t>(value >> 24)};
}

void test_both_directions() {
  auto [left_fd, right_fd] = socket_pair();
  Recorder left_handler;
  Recorder right_handler;
  constexpr std::size_t kCount = 2000;
  right_handler.wanted = kCount;
  Channel left(std::move(left_fd));
  Channel right(std::move(right_fd));
  left.start(left_handler);
  right.start(right_handler);
  for (std::uint32_t i = 0; i < kCount; ++i) {
    CHECK(left.send(FrameKind::event, number(i)));  // before the gate is open, and after
    if (i == kCount / 2) {
      right.open_gate();
    }
  }
  CHECK(right_handler.enough.get_future().wait_for(kPatience) == std::future_status::ready);
  CHECK(left.flush(std::chrono::steady_clock::now() + kPatience));
  for (std::uint32_t i = 0; i < kCount; ++i) {
    CHECK(right_handler.frames[i].payload == number(i));
  }
  CHECK(left.dropped() == 0);
  right.stop();
}

void test_a_peer_that_does_not_read() {
  auto [ours, theirs] = socket_pair();
  Recorder handler;
  Channel channel(std::move(ours), 10);
  channel.start(handler);
  const std::vector<std::uint8_t> large(100'000);
  std::uint64_t refused = 0;
  for (int i = 0; i < 100; ++i) {
    refused += channel.send(FrameKind::event, large) ? 0 : 1;
  }
  CHECK(refused > 50);
  CHECK(channel.dropped() == refused);
  CHECK(!channel.flush(std::chrono::steady_clock::now() + 1ms));
  channel.stop();  // in the middle of a frame that is not read
}

void test_ends() {
  for (const bool open : {false, true}) {  // the end is noticed behind a closed gate, too
    auto [ours, theirs] = socket_pair();
    Recorder handler;
    Channel channel(std::move(ours));
    channel.start(handler);
    if (open) {
      channel.open_gate();
    }
    theirs.reset();
    CHECK(handler.end() == "closed");
    channel.send(FrameKind::event, number(1));
    CHECK(!channel.flush(std::chrono::steady_clock::now() + kPatience));
    CHECK(channel.dropped() == 1);
    CHECK(!channel.send(FrameKind::event, number(2)));
  }
}

void test_what_came_before_the_end_is_handled() {
  auto [ours, theirs] = socket_pair();
  Recorder handler;
  Channel channel(std::move(ours));
  send_raw(theirs, encode_frame(FrameKind::load, number(1)));
  theirs.reset();
  channel.open_gate();
  channel.start(handler);
  CHECK(handler.end() == "closed");
  CHECK(handler.frames.size() == 1);
}

void test_protocol_errors() {
  const std::vector<std::uint8_t> bad_length = number(2);
  const std::vector<std::uint8_t> bad_message =
      encode_frame(FrameKind::load, std::vector<std::uint8_t>{'x'});
  for (const auto& bytes : {bad_length, bad_message}) {
    auto [ours, theirs] = socket_pair();
    Recorder handler;
    Channel channel(std::move(ours));
    channel.start(handler);
    channel.open_gate();
    send_raw(theirs, bytes);
    const std::string end = handler.end();
    CHECK(end == "x" || contains(end, "length 2"));
  }
}

}  // namespace

int main() {
  test_both_directions();
  test_a_peer_that_does_not_read();
  test_ends();
  test_what_came_before_the_end_is_handled();
  test_protocol_errors();
  return 0;
}
