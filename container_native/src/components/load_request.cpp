#include "components/load_request.hpp"

#include <cxxabi.h>

#include <cstddef>
#include <exception>
#include <string>
#include <typeinfo>

#include "base/elf.hpp"

namespace play_launch::container {
namespace {

/// Bytes. A text that is too long for a frame would be dropped whole, and this much is not read.
constexpr std::size_t kLongestText = 16 * 1024;

/// At most that of it, cut between two characters (UTF-8).
std::string shortened(std::string text) {
  if (text.size() <= kLongestText) {
    return text;
  }
  const auto continues = [](char byte) {
    return (static_cast<unsigned char>(byte) & 0xc0) == 0x80;
  };
  const std::string whole = std::to_string(text.size());
  std::size_t end = kLongestText;
  while (end > 0 && continues(text[end])) {
    --end;
  }
  text.resize(end);
  return text + "... (cut, of " + whole + " bytes)";
}

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
    return shortened(describe(error));
  } catch (...) {
    const std::type_info* type = abi::__cxa_current_exception_type();
    return "an exception of type " + (type != nullptr ? demangled(type->name()) : "unknown");
  }
}

}  // namespace play_launch::container
