#include "base/failpoints.hpp"

#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <charconv>
#include <chrono>
#include <cstddef>
#include <cstdlib>
#include <string>
#include <string_view>
#include <thread>

#include "base/report.hpp"

namespace play_launch {
namespace {

using namespace std::string_view_literals;

constexpr std::size_t kCount = static_cast<std::size_t>(Failpoint::count);

// In the order of the enumeration.
constexpr std::array<std::string_view, kCount> kNames{
    "container.before_hello",    "container.after_accept",   "container.before_construct",
    "container.after_construct", "container.drop_accepted",  "container.drop_event",
    "container.ignore_query",    "container.before_unload",  "container.on_shutdown",
    "container.during_stop",     "container.during_cleanup", "container.abrupt_deaths",
};

// Numbered as in play_launch_msgs/ComponentEvent.
constexpr std::array kEvents{"loaded"sv, "unloaded"sv, "failed"sv, "crashed"sv, "loading"sv};

enum class Action : unsigned char { none, hang, abort, kill, exit, delay, once, always };

struct Slot {
  std::atomic<Action> action{Action::none};
  int argument = 0;
};

std::array<Slot, kCount> slots;

struct ActionName {
  std::string_view name;
  Action action;
  bool has_argument;
};

constexpr std::array kActions{
    ActionName{"hang", Action::hang, false},     ActionName{"abort", Action::abort, false},
    ActionName{"kill", Action::kill, false},     ActionName{"exit", Action::exit, true},
    ActionName{"delay", Action::delay, true},    ActionName{"once", Action::once, false},
    ActionName{"always", Action::always, false},
};

[[noreturn]] void refuse(std::string_view part, const std::string& why) {
  throw FailpointError("--failpoints: '" + std::string(part) + "': " + why);
}

void arm_event(std::string_view part, std::string_view type) {
  const auto found = std::ranges::find(kEvents, type);
  if (found == kEvents.end()) {
    refuse(part, "the type is not one of loading, loaded, failed, unloaded, crashed");
  }
  Slot& slot = slots[static_cast<std::size_t>(Failpoint::drop_event)];
  slot.argument = static_cast<int>(found - kEvents.begin());
  slot.action = Action::once;
}

void arm(std::string_view part) {
  const std::size_t equals = part.find('=');
  if (equals == std::string_view::npos) {
    refuse(part, "expected name=action");
  }
  const std::string_view name = part.substr(0, equals);
  std::string_view action = part.substr(equals + 1);
  std::size_t index = 0;
  while (index < kCount && kNames[index] != name) {
    ++index;
  }
  if (index == kCount) {
    refuse(part, "there is no failpoint of that name");
  }
  if (index == static_cast<std::size_t>(Failpoint::drop_event)) {
    arm_event(part, action);
    return;
  }
  std::string_view argument;
  const std::size_t colon = action.find(':');
  if (colon != std::string_view::npos) {
    argument = action.substr(colon + 1);
    action = action.substr(0, colon);
  }
  for (const ActionName& known : kActions) {
    if (known.name != action || known.has_argument != (colon != std::string_view::npos)) {
      continue;
    }
    const char* const end = argument.data() + argument.size();
    if (known.has_argument &&
        std::from_chars(argument.data(), end, slots[index].argument).ptr != end) {
      refuse(part, "the argument is no number");
    }
    slots[index].action = known.action;
    return;
  }
  refuse(part, "the action is not one of hang, abort, kill, exit:N, delay:MS, once, always");
}

bool act(Slot& slot, std::string_view name) {
  switch (slot.action.load()) {
    case Action::none:
      return false;
    case Action::hang:
      report("failpoint " + std::string(name) + ": hangs");
      while (true) {
        ::pause();
      }
    case Action::abort:
      std::abort();
    case Action::kill:
      ::kill(::getpid(), SIGKILL);
      return true;
    case Action::exit:
      ::_exit(slot.argument);
    case Action::delay:
      std::this_thread::sleep_for(std::chrono::milliseconds(slot.argument));
      return false;
    case Action::once:
      return slot.action.exchange(Action::none) == Action::once;
    case Action::always:
      return true;
  }
  return false;
}

}  // namespace

void arm_failpoints(std::string_view specification) {
  std::string_view rest = specification;
  while (!rest.empty()) {
    const std::size_t end = std::min(rest.find(';'), rest.size());
    if (end > 0) {
      arm(rest.substr(0, end));
    }
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
}

bool hit(Failpoint place) {
  const auto index = static_cast<std::size_t>(place);
  if (slots[index].action.load(std::memory_order_relaxed) == Action::none) {
    return false;
  }
  return act(slots[index], kNames[index]);
}

bool drops_event(unsigned type) {
  const Slot& slot = slots[static_cast<std::size_t>(Failpoint::drop_event)];
  return slot.argument == static_cast<int>(type) && hit(Failpoint::drop_event);
}

}  // namespace play_launch
