#pragma once

#include <memory>
#include <string>

#include "components/component_backend.hpp"

namespace play_launch::container {

/// Opens a library with ComponentBackend::open(). With ROS from PyPI's wheels, a library that was
/// linked, without need, against the Python half of an interface package wants symbols of libpython
/// that no library defines; it gets stand-ins. One that brings libpython along gets its own. In one
/// thread at a time. Throws LoadError.
std::unique_ptr<ComponentLibrary> open_library(ComponentBackend& backend, const std::string& path);

}  // namespace play_launch::container
