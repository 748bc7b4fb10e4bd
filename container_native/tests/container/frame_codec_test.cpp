// Frames survive any cutting of the stream; nonsense is refused.

#include "control/frame_codec.hpp"

#include <numeric>
#include <random>

#include "check.hpp"

using namespace play_launch::control;

namespace {

std::vector<std::uint8_t> bytes(std::size_t size) {
  std::vector<std::uint8_t> result(size);
  std::iota(result.begin(), result.end(), std::uint8_t{0});
  return result;
}

void test_layout() {
  const std::vector<std::uint8_t> payload{0xAA, 0xBB};
  const std::vector<std::uint8_t> expected{6, 0, 0, 0, 10, 0, 1, 0, 0xAA, 0xBB};
  CHECK(encode_frame(FrameKind::shutdown, payload) == expected);
  CHECK((encode_frame(FrameKind::hello, {}) == std::vector<std::uint8_t>{4, 0, 0, 0, 1, 0, 1, 0}));
}

void test_any_cutting() {
  std::mt19937 random(42);
  std::vector<std::size_t> sizes;
  std::vector<std::uint8_t> stream;
  for (int i = 0; i < 200; ++i) {
    sizes.push_back(random() % 300);
    const auto frame = encode_frame(FrameKind::event, bytes(sizes.back()));
    stream.insert(stream.end(), frame.begin(), frame.end());
  }
  for (const std::size_t largest_piece : {1, 3, 7, 100, 5000, 1'000'000}) {
    FrameDecoder decoder;
    std::size_t seen = 0;
    for (std::size_t at = 0; at < stream.size();) {
      const std::size_t piece = std::min(1 + random() % largest_piece, stream.size() - at);
      decoder.feed(std::span(stream).subspan(at, piece));
      at += piece;
      while (const auto frame = decoder.next()) {
        CHECK(seen < sizes.size());
        CHECK(frame->kind == static_cast<std::uint16_t>(FrameKind::event));
        CHECK(frame->version == kProtocolVersion);
        CHECK(frame->payload == bytes(sizes[seen]));
        ++seen;
      }
    }
    CHECK(seen == sizes.size());
    CHECK(decoder.pending() == 0);
  }
}

void test_refused() {
  const auto feed = [](std::uint32_t length) {
    FrameDecoder decoder;
    const std::vector<std::uint8_t> head{
        static_cast<std::uint8_t>(length), static_cast<std::uint8_t>(length >> 8),
        static_cast<std::uint8_t>(length >> 16), static_cast<std::uint8_t>(length >> 24)};
    decoder.feed(head);
    return decoder.next();
  };
  for (const std::uint32_t length : {0U, 1U, 3U, kMaxFrameLength + 1, 0xFFFFFFFFU}) {
    CHECK(contains(CHECK_THROWS(feed(length), ProtocolError), std::to_string(length)));
  }
  CHECK(!feed(4).has_value());
  CHECK(!feed(kMaxFrameLength).has_value());
  CHECK_THROWS(encode_frame(FrameKind::event, bytes(kMaxFrameLength)), ProtocolError);
  CHECK(encode_frame(FrameKind::event, bytes(kMaxFrameLength - 4)).size() == kMaxFrameLength + 4);
}

void test_a_cut_off_frame_is_noticed() {
  FrameDecoder decoder;
  auto frame = encode_frame(FrameKind::event, bytes(10));
  frame.pop_back();
  decoder.feed(frame);
  CHECK(!decoder.next().has_value());
  CHECK(decoder.pending() == frame.size());
}

}  // namespace

int main() {
  test_layout();
  test_any_cutting();
  test_refused();
  test_a_cut_off_frame_is_noticed();
  return 0;
}
