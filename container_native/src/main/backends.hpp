#pragma once

#include <memory>
#include <string>
#include <vector>

#include "components/backend_list.hpp"

namespace play_launch::container {

/// Every backend that this program was built with, and one context for all of them. `argv` is the
/// command line. Throws std::exception. Once per process.
BackendList make_backends(int argc, const char* const* argv);

/// Every backend, with a context from the other function, or null: then they can find libraries and
/// open them, but make no nodes.
BackendList make_backends(const std::shared_ptr<Context>& context);

/// Their names, for people and for the hello.
std::vector<std::string> backend_names();

}  // namespace play_launch::container
