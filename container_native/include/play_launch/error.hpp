#pragma once

#include <rcl/types.h>

#include <stdexcept>
#include <string>

namespace play_launch {

/// A call into the ROS client library failed. The text names what was being done and carries the
/// library's own explanation, which is cleared from its thread-local storage on construction.
class RclError : public std::runtime_error {
 public:
  /// `doing` completes the sentence "failed to ..."; `code` is what the library returned.
  RclError(const std::string& doing, rcl_ret_t code);

  /// The library's return code.
  [[nodiscard]] rcl_ret_t code() const noexcept { return code_; }

 private:
  rcl_ret_t code_;
};

/// Throws RclError unless `code` is RCL_RET_OK.
void throw_unless_ok(rcl_ret_t code, const std::string& doing);

/// Base of everything that can go wrong with a parameter.
class ParameterError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A value has another type than the parameter; the text gives name, expected and given type.
class ParameterTypeError : public ParameterError {
 public:
  ParameterTypeError(const std::string& name, const std::string& expected,
                     const std::string& given);
};

/// The parameter was read or set before it was declared.
class ParameterNotDeclared : public ParameterError {
 public:
  explicit ParameterNotDeclared(const std::string& name);
};

/// The parameter was declared twice.
class ParameterAlreadyDeclared : public ParameterError {
 public:
  explicit ParameterAlreadyDeclared(const std::string& name);
};

/// The node's own on_set_parameters callback refused a value.
class ParameterRejected : public ParameterError {
 public:
  ParameterRejected(const std::string& name, const std::string& reason);
};

}  // namespace play_launch
