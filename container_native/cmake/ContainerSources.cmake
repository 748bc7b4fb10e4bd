# The container's sources and how they are compiled; needs no ROS.

find_package(Threads REQUIRED)

# The sources of the container, but for those that need rclcpp, below these folders of src/.
function(container_sources result)
  set(rooms ${ARGN})
  if(NOT rooms)
    set(rooms base fastdds control isolation overrides components hosts manager main)
  endif()
  set(all "")
  foreach(room IN LISTS rooms)
    file(GLOB_RECURSE sources CONFIGURE_DEPENDS
         "${CMAKE_CURRENT_FUNCTION_LIST_DIR}/../src/${room}/*.cpp")
    list(APPEND all ${sources})
  endforeach()
  list(FILTER all EXCLUDE REGEX "/components/rclcpp/|/overrides/rclcpp_|/fastdds/library")
  set(${result}
      "${all}"
      PARENT_SCOPE)
endfunction()

function(strict_warnings target)
  # GCC 12 takes ("text" + std::string) for overlapping copies (its bug 105651).
  target_compile_options(${target} PRIVATE -Wall -Wextra $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict>)
  if(PLAY_LAUNCH_WARNINGS_ARE_ERRORS)
    target_compile_options(${target} PRIVATE -Werror)
  endif()
endfunction()
