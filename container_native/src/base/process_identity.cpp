#include "base/process_identity.hpp"

#include <fstream>
#include <sstream>
#include <string>

namespace play_launch::container {

ProcessIdentity identity_of(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string stat;
  std::getline(file, stat);
  // Field 2 is the command in parentheses and may hold spaces and parentheses itself: count from
  // its end.
  const std::size_t command_end = stat.rfind(')');
  if (command_end == std::string::npos) {
    return {pid, 0};
  }
  std::istringstream fields(stat.substr(command_end + 1));
  constexpr int kFieldsBefore = 22 - 3;
  std::string skipped;
  for (int i = 0; i < kFieldsBefore; ++i) {
    fields >> skipped;
  }
  std::uint64_t start_time = 0;
  fields >> start_time;
  return {pid, start_time};
}

}  // namespace play_launch::container
