#pragma once

#include <rcl/arguments.h>
#include <rcl/node_options.h>

#include <map>
#include <play_launch/node_options.hpp>
#include <play_launch/parameter.hpp>
#include <string>

namespace play_launch {

/// What NodeOptions mean for rcl, owned.
class NodeArguments {
 public:
  /// Throws RclError for arguments that rcl refuses, std::invalid_argument for those it does not
  /// know or when there is no context.
  explicit NodeArguments(const NodeOptions& options);
  ~NodeArguments();
  NodeArguments(const NodeArguments&) = delete;
  NodeArguments& operator=(const NodeArguments&) = delete;

  [[nodiscard]] const rcl_node_options_t& rcl() const noexcept { return rcl_options_; }

  /// Values for the parameters of that node. Later sources win: the context's arguments, the
  /// node's own arguments, options.parameter_overrides.
  [[nodiscard]] std::map<std::string, ParameterValue> parameter_overrides(
      const std::string& full_name) const;

  /// Least severity for that logger, 0 when neither the options nor the node's own arguments say.
  [[nodiscard]] int log_level(const std::string& logger_name) const;

 private:
  const NodeOptions& options_;
  rcl_node_options_t rcl_options_;
};

/// Whether a node name of a parameter file ("/a/b", "b", "/**", "/*/b") means that node. `*` stands
/// for one token, `**` for any number of them.
[[nodiscard]] bool parameter_section_matches(const std::string& section,
                                             const std::string& full_name);

}  // namespace play_launch
