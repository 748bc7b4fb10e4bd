// A node may be made while another thread fills the description of a type that both use.

#include <rcl/error_handling.h>
#include <rcl/publisher.h>
#include <rcl/service.h>

#include <array>
#include <chrono>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <std_msgs/msg/string.hpp>
#include <thread>

#include "check.hpp"

using namespace play_launch;
using namespace play_launch::testing;

namespace {

using Description = rosidl_runtime_c__type_description__TypeDescription;
using Individual = rosidl_runtime_c__type_description__IndividualTypeDescription;
using Source = rosidl_runtime_c__type_description__TypeSource;
using Sources = rosidl_runtime_c__type_description__TypeSource__Sequence;

const rosidl_message_type_support_t& real() {
  return *rosidl_typesupport_cpp::get_message_type_support_handle<std_msgs::msg::String>();
}

// What the generated code has in static variables, before it has been filled.
std::array<Individual, 1> referenced;
Description description;
std::array<Source, 1> sources;
Sources all_sources{sources.data(), sources.size(), sources.size()};

const Description* description_of(const rosidl_message_type_support_t*) { return &description; }
const Sources* sources_of(const rosidl_message_type_support_t*) { return &all_sources; }

/// Creates a publisher; the other thread goes on in `fill` meanwhile.
template <class Fill>
rcl_ret_t create_beside(rcl_node_t& node, Fill fill) {
  description = *real().get_type_description_func(&real());
  description.referenced_type_descriptions = {referenced.data(), referenced.size(),
                                              referenced.size()};
  referenced = {};
  sources = {};
  rosidl_message_type_support_t type = real();
  type.get_type_description_func = description_of;
  type.get_type_description_sources_func = sources_of;
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  const rcl_publisher_options_t options = rcl_publisher_get_default_options();
  const std::jthread other([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));  // it is preempted
    fill();
  });
  const rcl_ret_t result = rcl_publisher_init(&publisher, &node, &type, "topic", &options);
  if (result == RCL_RET_OK) {
    CHECK(rcl_publisher_fini(&publisher, &node) == RCL_RET_OK);
  }
  rcl_reset_error();
  return result;
}

}  // namespace

int main() {
  const auto context = make_context();
  rcl_node_t node = rcl_get_zero_initialized_node();
  const rcl_node_options_t options = rcl_node_get_default_options();
  CHECK(rcl_node_init(&node, "node", "", context->rcl(), &options) == RCL_RET_OK);
  const Individual& filled = real().get_type_description_func(&real())->type_description;
  const Source& source = real().get_type_description_sources_func(&real())->data[0];
  CHECK(create_beside(node, [&] {
          referenced[0] = filled;
          sources[0] = source;
        }) == RCL_RET_OK);
  // The other one died in there: this fails, but not without an end.
  CHECK(create_beside(node, [] {}) != RCL_RET_OK);
  CHECK(rcl_node_fini(&node) == RCL_RET_OK);
}
