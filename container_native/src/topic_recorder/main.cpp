// topic_recorder --socket FD [--topic NAME]... [--exclude NAME]... [--held NAME]...
//                [--measure NAME]... [--budget BYTES] [--topic-budget NAME=BYTES]...
//                [--hold-time NANOSECONDS] [--hold-size BYTES] [--answer-timeout NANOSECONDS]
//
// Takes messages of ROS topics as they came over the wire, and hands them as chunks of an MCAP file
// to the supervisor at the other end of the socket FD, see supervisor_link.hpp. A process of its
// own, so that neither the rate of a camera nor a fault of the middleware disturbs the supervisor.

#include <unistd.h>

#include <cstdio>
#include <exception>
#include <stdexcept>

#include "fastdds/segments.hpp"
#include "topic_recorder/recorder.hpp"
#include "topic_recorder/selection.hpp"

int main(int argc, char** argv) {
  using namespace play_launch::topics;
  try {
    Recorder recorder(parse_options(argc, argv));
    if (!recorder.run()) {
      // Taking the middleware apart may take longer than what is left of this process.
      play_launch::unlink_own_segments();
      ::_exit(0);
    }
  } catch (const std::invalid_argument& error) {
    std::fprintf(stderr, "topic_recorder: %s\n", error.what());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "topic_recorder: %s\n", error.what());
    return 1;
  }
  return 0;
}
