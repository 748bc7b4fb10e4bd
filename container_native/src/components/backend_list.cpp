#include "components/backend_list.hpp"

namespace play_launch::container {

std::size_t BackendList::of_package(const std::string& package) const {
  std::vector<ComponentIndex> indexes;
  for (std::size_t i = 0; i < backends_.size(); ++i) {
    if (backends_[i]->index().has_package(package)) {
      return i;
    }
    indexes.push_back(backends_[i]->index());
  }
  throw LoadError(no_such_package(package, indexes));
}

std::optional<std::string> BackendList::expected_full_name(const LoadRequest& request) const {
  // Which backend it will be is found out by whoever constructs, as that reads files.
  std::optional<std::string> name;
  for (const std::unique_ptr<ComponentBackend>& backend : backends_) {
    const std::optional<std::string> expected = backend->expected_full_name(request);
    if (!expected || (name && *name != *expected)) {
      return std::nullopt;
    }
    name = expected;
  }
  return name;
}

}  // namespace play_launch::container
