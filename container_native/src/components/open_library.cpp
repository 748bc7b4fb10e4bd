#include "components/open_library.hpp"

// In programs that use ROS from PyPI's wheels only: see python_symbols.c.
extern "C" [[gnu::weak, gnu::visibility("hidden")]] void play_launch_stand_in_for_python(
    int active);

namespace play_launch::container {
namespace {

bool lacks_python(const std::string& failure) {
  return play_launch_stand_in_for_python != nullptr &&
         failure.find("undefined symbol: ") != std::string::npos &&
         (failure.find("PyExc_RuntimeError") != std::string::npos ||
          failure.find("_Py_TrueStruct") != std::string::npos);
}

}  // namespace

std::unique_ptr<ComponentLibrary> open_library(ComponentBackend& backend, const std::string& path) {
  try {
    return backend.open(path);
  } catch (const LoadError& error) {
    if (!lacks_python(error.what())) {
      throw;
    }
  }
  struct Lending {
    Lending() { play_launch_stand_in_for_python(1); }
    ~Lending() { play_launch_stand_in_for_python(0); }
  } const lending;
  return backend.open(path);
}

}  // namespace play_launch::container
