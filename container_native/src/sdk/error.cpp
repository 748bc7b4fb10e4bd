#include <rcl/error_handling.h>

#include <play_launch/error.hpp>

namespace play_launch {
namespace {

std::string explain(const std::string& doing) {
  std::string text = "failed to " + doing;
  if (rcl_error_is_set()) {
    text += ": ";
    text += rcl_get_error_string().str;
    rcl_reset_error();
  }
  return text;
}

}  // namespace

RclError::RclError(const std::string& doing, rcl_ret_t code)
    : std::runtime_error(explain(doing)), code_(code) {}

void throw_unless_ok(rcl_ret_t code, const std::string& doing) {
  if (code != RCL_RET_OK) throw RclError(doing, code);
}

ParameterTypeError::ParameterTypeError(const std::string& name, const std::string& expected,
                                       const std::string& given)
    : ParameterError("parameter '" + name + "' has the wrong type: expected " + expected +
                     ", given " + given) {}

ParameterNotDeclared::ParameterNotDeclared(const std::string& name)
    : ParameterError("parameter '" + name + "' has not been declared") {}

ParameterAlreadyDeclared::ParameterAlreadyDeclared(const std::string& name)
    : ParameterError("parameter '" + name + "' has been declared already") {}

ParameterRejected::ParameterRejected(const std::string& name, const std::string& reason)
    : ParameterError("the node refused the value of parameter '" + name + "': " + reason) {}

}  // namespace play_launch
