#include "components/load_request.hpp"

#include <cxxabi.h>

#include <cstdlib>
#include <exception>
#include <memory>
#include <typeinfo>

namespace play_launch::container {
namespace {

std::string readable_name(const std::type_info& type) {
  int status = 0;
  const std::unique_ptr<char, decltype(&std::free)> name(
      abi::__cxa_demangle(type.name(), nullptr, nullptr, &status), &std::free);
  return status == 0 ? name.get() : type.name();
}

std::string describe(const std::exception& error) {
  std::string text = readable_name(typeid(error)) + ": " + error.what();
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
    return "an exception of type " + (type != nullptr ? readable_name(*type) : "unknown");
  }
}

}  // namespace play_launch::container
