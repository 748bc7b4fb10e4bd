// How often is looked for locks of the dead.

#include "hosts/cloned/lock_watch.hpp"

#include "check.hpp"

namespace {

using namespace std::chrono_literals;
using play_launch::container::look_interval;

}  // namespace

int main() {
  CHECK(look_interval(0s) == 500ms);
  CHECK(look_interval(59s) == 500ms);
  CHECK(look_interval(60s) == 2s);
  CHECK(look_interval(24h) == 2s);
  return 0;
}
