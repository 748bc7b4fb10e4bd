#include "main/fastdds.hpp"

#include <rcutils/error_handling.h>
#include <rmw/rmw.h>

#include <string_view>

#include "overrides/type_supports.hpp"

namespace play_launch::container {

void open_type_supports() {
  if (std::string_view(rmw_get_implementation_identifier()) == "rmw_fastrtps_cpp") {
    isolation::look_up_type_supports_of_program("rosidl_typesupport_fastrtps_cpp",
                                                "rosidl_typesupport_fastrtps_c");
    rcutils_reset_error();
  }
}

}  // namespace play_launch::container
