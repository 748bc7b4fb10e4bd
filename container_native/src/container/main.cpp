#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>

#include "container/backends.hpp"
#include "container/container_process.hpp"
#include "container/control_interface.hpp"
#include "container/failpoints.hpp"
#include "container/installation.hpp"
#include "container/options.hpp"
#include "container/report.hpp"

namespace {

using namespace play_launch::container;

void print_version() {
  std::string line = "component_container " PLAY_LAUNCH_VERSION ", components:";
  for (const std::string& name : backend_names()) {
    line += " " + name;
  }
  std::puts(line.c_str());
}

int usage_error(const std::exception& error) {
  report(error.what());
  return kExitUsage;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const Options options = parse_options(argc, argv);
    if (options.help) {
      std::fputs(usage(), stdout);
      return kExitOk;
    }
    if (options.version) {
      print_version();
      return kExitOk;
    }
    arm_failpoints(std::getenv("PLAY_LAUNCH_FAILPOINTS"));
    search_own_prefix();
    play_launch::control::UniqueFd control_socket = take_control_socket();
    ContainerProcess process(options, argc, argv, std::move(control_socket));
    return process.run();
  } catch (const UsageError& error) {
    return usage_error(error);
  } catch (const FailpointError& error) {
    return usage_error(error);
  } catch (const std::exception& error) {
    report(std::string("cannot start: ") + error.what());
    return kExitFailed;
  }
}
