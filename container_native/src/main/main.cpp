#include <sys/socket.h>

#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <string>
#include <system_error>

#include "base/failpoints.hpp"
#include "base/process.hpp"
#include "base/report.hpp"
#include "base/resource_setting.hpp"
#include "isolation/memory/protection_keys.hpp"
#include "main/control_interface.hpp"
#include "main/host_choice.hpp"
#include "main/options.hpp"
#include "main/probe.hpp"
#include "main/process.hpp"
#include "main/stop.hpp"

namespace {

using namespace play_launch;
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

/// As far as the kernel agrees: the supervisor checks what is in force. False: it must not run
/// without.
bool apply_resources(const Options& options) {
  for (const ResourceSetting& setting : options.resources) {
    if (!apply_or_complain(setting)) {
      return false;
    }
  }
  if (options.lock_memory && lock_memory() != 0) {
    report("the memory is not locked: it takes RLIMIT_MEMLOCK unlimited, or CAP_IPC_LOCK");
  }
  return true;
}

/// Adds the prefix that this program is installed in to AMENT_PREFIX_PATH, behind the others: the
/// components installed beside the container are found also without a set-up environment.
void search_own_prefix() {
  constexpr const char* kPrefixPath = "AMENT_PREFIX_PATH";
  constexpr const char* kFolder = "lib/play_launch_container";  // below the prefix
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path prefix = program.parent_path().parent_path().parent_path();
  if (error || program.parent_path() != prefix / kFolder) {
    return;  // run from a build folder
  }
  const char* const value = std::getenv(kPrefixPath);
  const std::string paths = value == nullptr ? "" : value;
  if ((":" + paths + ":").find(":" + prefix.string() + ":") != std::string::npos) {
    return;
  }
  ::setenv(kPrefixPath, (paths.empty() ? prefix.string() : paths + ":" + prefix.string()).c_str(),
           1);
}

int run(int argc, char** argv) {
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
    if (!apply_resources(options)) {
      return kExitFailed;
    }
    if (options.memory_domains != DomainChoice::off) {
      isolation::allow_all_keys();
    }
    arm_failpoints(options.failpoints);
    search_own_prefix();
    if (options.hosted || options.probe) {
      play_launch::set_core_dumps(options.core_dumps);
    }
    if (options.probe) {
      return probe(options.probe->package, options.probe->plugin);
    }
    UniqueFd control_socket = take_socket(control::kSocketVariable, SOCK_STREAM);
    UniqueFd requests = take_socket(kContainersVariable, SOCK_SEQPACKET);
    Process process(options, argc, argv);
    return requests ? process.run_many(std::move(requests))
                    : process.run_one(std::move(control_socket));
  } catch (const UsageError& error) {
    return usage_error(error);
  } catch (const FailpointError& error) {
    return usage_error(error);
  } catch (const std::exception& error) {
    report(std::string("cannot start: ") + error.what());
    return kExitFailed;
  }
}

}  // namespace

int main(int argc, char** argv) { return run(argc, argv); }
