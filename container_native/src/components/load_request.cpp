#include "components/load_request.hpp"

#include <cxxabi.h>

#include <exception>
#include <typeinfo>

#include "base/demangle.hpp"

namespace play_launch::container {
namespace {

std::string describe(const std::exception& error) {
  std::string text = demangled(typeid(error).name()) + ": " + error.what();
  try {
    std::rethrow_if_nested(error);
  } catch (const std::exception& cause) {
    text += "; caused by " + describe(cause);
  } catch (...) {
    text += "; caused by something that is no std::exception";
  }
  return text;
}

}  // namespace

std::string describe_current_exception() {
  try {
    throw;
  } catch (const LoadError& error) {
    return error.what();
  } catch (const std::exception& error) {
    return describe(error);
  } catch (...) {
    const std::type_info* type = abi::__cxa_current_exception_type();
    return "an exception of type " + (type != nullptr ? demangled(type->name()) : "unknown");
  }
}

}  // namespace play_launch::container
