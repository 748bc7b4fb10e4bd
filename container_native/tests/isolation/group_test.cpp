// A child is born in a control group, or enters one before its program runs.

#include <sys/stat.h>

#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "harness.hpp"
#include "isolation/clone/vm_clone.hpp"

namespace {

using namespace isolation_test;
using play_launch::parse_resource_settings;
using play_launch::ResourceSetting;
using play_launch::UniqueFd;

constexpr int kSkipped = 77;

/// Where the hierarchy of version 2 is mounted; empty: nowhere.
std::string mounted() {
  std::ifstream mounts("/proc/self/mounts");
  std::string device;
  std::string folder;
  std::string type;
  std::string rest;
  while (mounts >> device >> folder >> type && std::getline(mounts, rest)) {
    if (type == "cgroup2") {
      return folder;
    }
  }
  return "";
}

/// The group of the calling process.
std::string own_group() {
  std::ifstream file("/proc/self/cgroup");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("0::")) {
      return line.substr(3);
    }
  }
  return "";
}

/// A group of this process alone.
class Folder {
 public:
  explicit Folder(const std::string& parent)
      : path_(parent + "/group_test." + std::to_string(::getpid())) {
    made_ = ::mkdir(path_.c_str(), 0755) == 0;
  }
  ~Folder() { ::rmdir(path_.c_str()); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  bool made() const { return made_; }
  const std::string& path() const { return path_; }
  std::string name() const { return path_.substr(path_.rfind('/')); }
  UniqueFd open() const { return UniqueFd(::open(path_.c_str(), O_RDONLY | O_DIRECTORY)); }

 private:
  std::string path_;
  bool made_ = false;
};

/// Where a child is that is born in `group`, or enters it by `settings`.
std::string group_of_child(UniqueFd* group, const std::vector<ResourceSetting>& settings) {
  ChildOptions options;
  options.group = group;
  options.resources = settings;
  std::string seen;
  Outcome outcome;
  run(
      outcome,
      [&seen](Program&) {
        seen = own_group();
        return 3;
      },
      options);
  CHECK(outcome.end.returned && outcome.end.exit_code == 3);
  return seen;
}

void test_born_inside(const Folder& folder) {
  UniqueFd group = folder.open();
  CHECK(group.get() >= 0);
  const int number = group.get();
  // No setting: it is there from the beginning.
  CHECK(group_of_child(&group, {}).ends_with(folder.name()));
  // The descriptor is not needed now, and its number may be reused.
  CHECK(group.get() == -1 && ::fcntl(number, F_GETFD) == -1);
}

void test_enters_by_itself(const Folder& folder) {
  const auto settings = parse_resource_settings({"cgroup " + folder.path()});
  CHECK(group_of_child(nullptr, settings).ends_with(folder.name()));
  UniqueFd none;
  CHECK(group_of_child(&none, settings).ends_with(folder.name()));
  // As where clone3 is refused: not a group.
  UniqueFd other(::open("/tmp", O_RDONLY | O_DIRECTORY));
  CHECK(group_of_child(&other, settings).ends_with(folder.name()));
}

void test_runs_without(const Folder& folder) {
  const auto settings = parse_resource_settings({"cgroup " + folder.path()});
  UniqueFd group = folder.open();
  CHECK(::rmdir(folder.path().c_str()) == 0);
  CHECK(group_of_child(&group, settings) == own_group());
}

void test_required(const Folder& folder) {
  const auto settings = parse_resource_settings({"required_cgroup " + folder.path()});
  CHECK(group_of_child(nullptr, settings).ends_with(folder.name()));
  ChildOptions options;
  const auto gone = parse_resource_settings({"required_cgroup " + folder.path() + "/gone"});
  options.resources = gone;
  bool has_run = false;
  Outcome outcome;
  run(
      outcome,
      [&has_run](Program&) {
        has_run = true;
        return 3;
      },
      options);
  CHECK(!has_run && outcome.end.exit_code == 126);
  CHECK(outcome.slot.report.kept_out);
}

}  // namespace

int main() {
  CHECK(prepare_clone() == nullptr);
  const Folder folder(mounted() + own_group());
  if (mounted().empty() || !folder.made()) {
    std::puts("skipped: no control group can be made");
    return kSkipped;
  }
  test_born_inside(folder);
  test_enters_by_itself(folder);
  test_required(folder);
  test_runs_without(folder);
  return 0;
}
