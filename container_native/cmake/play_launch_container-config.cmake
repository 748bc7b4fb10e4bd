# find_package(play_launch_container): the component SDK of play-launch for projects of your own.
# Gives the target play_launch::component and the function play_launch_add_components().

get_filename_component(play_launch_container_PREFIX "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
include("${CMAKE_CURRENT_LIST_DIR}/RosPackages.cmake")
include("${CMAKE_CURRENT_LIST_DIR}/PlayLaunchComponents.cmake")
include(CMakeFindDependencyMacro)
find_dependency(Threads)

if(NOT ROS_PREFIX)
  # Our own prefix where the ROS wheels are installed beside us; a sourced ROS is found through
  # AMENT_PREFIX_PATH.
  set(ROS_PREFIX "${play_launch_container_PREFIX}")
endif()
set(ROS_RPATH_ABSOLUTE ON)

if(NOT TARGET play_launch::component)
  foreach(package IN ITEMS rcl rcl_interfaces rosidl_typesupport_cpp rosidl_runtime_cpp)
    ros_package(${package})
  endforeach()
  add_library(play_launch::component SHARED IMPORTED)
  set_target_properties(
    play_launch::component
    PROPERTIES IMPORTED_LOCATION "${play_launch_container_PREFIX}/lib/libplay_launch_component.so"
               INTERFACE_INCLUDE_DIRECTORIES "${play_launch_container_PREFIX}/include")
  target_link_libraries(
    play_launch::component INTERFACE ros::rcl ros::rcl_interfaces ros::rosidl_typesupport_cpp
                                     ros::rosidl_runtime_cpp Threads::Threads)
endif()
if(NOT TARGET play_launch::private_memory)
  # For rclcpp components: <play_launch/private_memory.hpp>, without anything to link.
  add_library(play_launch::private_memory INTERFACE IMPORTED)
  set_target_properties(
    play_launch::private_memory PROPERTIES INTERFACE_INCLUDE_DIRECTORIES
                                           "${play_launch_container_PREFIX}/include")
endif()
set(play_launch_container_FOUND TRUE)
