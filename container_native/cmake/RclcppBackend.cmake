# Components written with rclcpp: compiled in when rclcpp_components is there. Needs RosPackages.

set(PLAY_LAUNCH_RCLCPP
    AUTO
    CACHE STRING "Load rclcpp components: AUTO (if rclcpp_components is found), ON or OFF")
set_property(CACHE PLAY_LAUNCH_RCLCPP PROPERTY STRINGS AUTO ON OFF)

# Packages of ROS whose headers and libraries the backend uses.
set(rclcpp_backend_packages rclcpp rclcpp_components class_loader)

function(find_rclcpp result)
  set(missing "")
  foreach(package IN LISTS rclcpp_backend_packages)
    ros_package_prefix(${package} prefix)
    if(NOT prefix)
      list(APPEND missing ${package})
    endif()
  endforeach()
  find_package(console_bridge QUIET)
  if(NOT console_bridge_FOUND)
    list(APPEND missing console_bridge)
  endif()
  set(${result}
      "${missing}"
      PARENT_SCOPE)
endfunction()

set(rclcpp_backend_found OFF)
if(PLAY_LAUNCH_RCLCPP STREQUAL "AUTO" OR PLAY_LAUNCH_RCLCPP)
  find_rclcpp(rclcpp_missing)
  if(NOT rclcpp_missing)
    set(rclcpp_backend_found ON)
    message(STATUS "rclcpp components: in")
  else()
    list(JOIN rclcpp_missing ", " rclcpp_missing)
    if(NOT PLAY_LAUNCH_RCLCPP STREQUAL "AUTO")
      ros_prefixes(searched)
      list(JOIN searched ", " searched)
      message(
        FATAL_ERROR
          "play-launch: PLAY_LAUNCH_RCLCPP is ON, but not found: ${rclcpp_missing} (looked in: "
          "${searched}). Source a ROS installation that has them, or name its prefix in "
          "AMENT_PREFIX_PATH; on Ubuntu: apt install ros-jazzy-rclcpp-components")
    endif()
    message(STATUS "rclcpp components: left out, not found: ${rclcpp_missing}")
  endif()
else()
  message(STATUS "rclcpp components: left out, PLAY_LAUNCH_RCLCPP is ${PLAY_LAUNCH_RCLCPP}")
endif()

function(add_rclcpp_backend target)
  if(NOT rclcpp_backend_found)
    return()
  endif()
  foreach(package IN LISTS rclcpp_backend_packages)
    ros_package(${package})
    target_link_libraries(${target} PRIVATE ros::${package})
  endforeach()
  find_package(console_bridge REQUIRED)
  target_link_libraries(${target} PRIVATE console_bridge::console_bridge)
  file(GLOB sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/src/components/rclcpp/*.cpp"
       "${CMAKE_CURRENT_SOURCE_DIR}/src/overrides/rclcpp_*.cpp")
  # Each for itself: their headers are those of whichever rclcpp is installed.
  set_source_files_properties(${sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  target_sources(${target} PRIVATE ${sources})
  target_compile_definitions(${target} PRIVATE PLAY_LAUNCH_RCLCPP)
endfunction()
