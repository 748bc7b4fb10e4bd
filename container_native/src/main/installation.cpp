#include "main/installation.hpp"

#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>

namespace play_launch::container {
namespace {

constexpr const char* kPrefixPath = "AMENT_PREFIX_PATH";
constexpr const char* kFolder = "lib/play_launch_container";  // below the prefix

}  // namespace

void search_own_prefix() {
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

}  // namespace play_launch::container
