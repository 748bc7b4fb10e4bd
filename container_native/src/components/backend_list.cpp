#include "components/backend_list.hpp"

#include "components/component_options.hpp"

namespace play_launch::container {

std::size_t BackendList::of_package(const std::string& package) const {
  std::vector<ComponentIndex> indexes;
  for (std::size_t i = 0; i < size(); ++i) {
    const ComponentIndex& index = (*this)[i].index();
    if (index.has_package(package)) {
      return i;
    }
    indexes.push_back(index);
  }
  throw LoadError(no_such_package(package, indexes));
}

BackendList::Place BackendList::place_of(const std::string& package,
                                         const std::string& plugin) const {
  const std::size_t backend = of_package(package);
  return {backend, (*this)[backend].index().library_of(package, plugin)};
}

BackendList::Found BackendList::find(std::uint64_t unique_id, const LoadRequest& request) const {
  const Place place = place_of(request.package_name, request.plugin_name);
  const std::string node = expected_full_name(request).value_or(request.plugin_name);
  const ComponentLibrary& library =
      shared_->loader.open((*this)[place.backend], place.library, unique_id, node);
  return {place.backend, &library.find(request.plugin_name)};
}

std::string BackendList::wait_of(std::uint64_t unique_id) const {
  const std::string library = shared_->loader.opening_for(unique_id);
  return library.empty() ? "" : "waits for the dynamic loader, which is opening " + library;
}

}  // namespace play_launch::container
