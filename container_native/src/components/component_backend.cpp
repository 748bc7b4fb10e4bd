#include "components/component_backend.hpp"

#include <fcntl.h>

#include <algorithm>
#include <ament_index_cpp/get_resource.hpp>
#include <ament_index_cpp/get_search_paths.hpp>
#include <ament_index_cpp/has_resource.hpp>
#include <cerrno>
#include <exception>
#include <sstream>
#include <system_error>

#include "base/unique_fd.hpp"

namespace play_launch::container {
namespace {

constexpr std::size_t kMostListed = 20;

std::string listed(const std::vector<std::string>& names) {
  if (names.empty()) {
    return "none";
  }
  std::string text;
  for (std::size_t i = 0; i < std::min(names.size(), kMostListed); ++i) {
    text += (i == 0 ? "" : ", ") + names[i];
  }
  if (names.size() > kMostListed) {
    text += " and " + std::to_string(names.size() - kMostListed) + " more";
  }
  return text;
}

[[noreturn]] void no_index(const std::exception& error) {
  throw LoadError(std::string("cannot search the ament index: ") + error.what() +
                  "; set AMENT_PREFIX_PATH to the prefixes where components are installed");
}

/// One entry of a resource: class and library.
using IndexEntry = std::pair<std::string, std::string>;

/// The lines of a resource; empty lines are skipped. Throws LoadError naming a line that has not
/// the form "class;library".
std::vector<IndexEntry> parse_component_resource(const std::string& content) {
  std::vector<IndexEntry> entries;
  std::istringstream lines(content);
  for (std::string line; std::getline(lines, line);) {
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) {
      line.pop_back();
    }
    if (line.empty()) {
      continue;
    }
    const std::size_t separator = line.find(';');
    if (separator == std::string::npos || separator == 0 || separator + 1 == line.size() ||
        line.find(';', separator + 1) != std::string::npos) {
      throw LoadError("its line '" + line + "' is not of the form class;library");
    }
    entries.emplace_back(line.substr(0, separator), line.substr(separator + 1));
  }
  return entries;
}

}  // namespace

bool ComponentIndex::has_package(const std::string& package) const {
  if (package.empty()) {
    throw LoadError("the request names no package");
  }
  try {
    return ament_index_cpp::has_resource(resource_type_, package);
  } catch (const std::exception& error) {
    no_index(error);
  }
}

std::filesystem::path ComponentIndex::library_of(const std::string& package,
                                                 const std::string& plugin) const {
  std::string content;
  std::string prefix;
  try {
    if (!ament_index_cpp::get_resource(resource_type_, package, content, &prefix)) {
      throw LoadError("package '" + package + "' is not in the ament index");
    }
  } catch (const LoadError&) {
    throw;
  } catch (const std::exception& error) {
    no_index(error);
  }
  std::vector<IndexEntry> entries;
  try {
    entries = parse_component_resource(content);
  } catch (const LoadError& error) {
    throw LoadError("resource '" + resource_type_ + "' of package '" + package + "' in " + prefix +
                    " is damaged: " + error.what());
  }
  std::vector<std::string> names;
  for (const auto& [name, library] : entries) {
    if (name == plugin) {
      return std::filesystem::path(prefix) / library;  // an absolute path stays what it is
    }
    names.push_back(name);
  }
  throw LoadError("package '" + package + "' in " + prefix + " has no component '" + plugin +
                  "'; it has: " + listed(names));
}

std::string no_such_package(const std::string& package,
                            const std::vector<ComponentIndex>& indexes) {
  // To the index, a file that cannot be opened is not there.
  if (!UniqueFd(::open("/", O_RDONLY | O_CLOEXEC)) && (errno == EMFILE || errno == ENFILE)) {
    return "cannot search the ament index: " + std::generic_category().message(errno) +
           "; raise the limit of open files (ulimit -n, or LimitNOFILE= in the systemd unit)";
  }
  std::string kinds;
  for (const ComponentIndex& index : indexes) {
    kinds += (kinds.empty() ? "" : ", ") + index.resource_type();
  }
  const std::string rclcpp = "rclcpp_components";
  if (kinds.find(rclcpp) == std::string::npos && ComponentIndex(rclcpp).has_package(package)) {
    return "the components of package '" + package +
           "' are made for rclcpp, which this container is built without";
  }
  std::string prefix;
  if (ament_index_cpp::has_resource("packages", package, &prefix)) {
    return "package '" + package + "' in " + prefix + " registers no components (" + kinds +
           "): its CMakeLists.txt has to register them, and it has to be built again";
  }
  return "package '" + package + "' is not installed: no prefix in AMENT_PREFIX_PATH has it; " +
         "install it, or source its workspace";
}

}  // namespace play_launch::container
