# What the container's own targets and its tests have in common. Needs RosPackages.

# The functions of rmw.h are behind a switch, or, with the wheels, in their only middleware.
set(ROS_FROM_WHEELS ON)
set(middleware rmw_fastrtps_cpp)
ros_package_prefix(rmw_implementation switch_prefix)
if(EXISTS "${switch_prefix}/lib/librmw_implementation.so")
  set(ROS_FROM_WHEELS OFF)
  set(middleware rmw_implementation)
endif()
foreach(package IN ITEMS rcl rcl_yaml_param_parser rcutils rmw rcl_interfaces ament_index_cpp
                         rosidl_typesupport_cpp rosidl_runtime_cpp builtin_interfaces ${middleware})
  ros_package(${package})
endforeach()
include(ContainerSources)

# A program that is not Python but uses librcl: the wheels' librcl drags in libraries for Python.
# Their functions are bound when called, which never happens; the two data symbols they want are in
# python_symbols.c, which takes them back once the program has started.
function(ros_program target)
  if(ROS_FROM_WHEELS)
    set(symbols "${CMAKE_CURRENT_FUNCTION_LIST_DIR}/../src/overrides/python_symbols.c")
    target_sources(${target} PRIVATE "${symbols}")
    # The headers that tests precompile are for C++.
    set_source_files_properties("${symbols}" PROPERTIES SKIP_PRECOMPILE_HEADERS ON)
    target_link_options(${target} PRIVATE "-Wl,--allow-shlib-undefined")
  endif()
  set(exports "${CMAKE_CURRENT_FUNCTION_LIST_DIR}/exports.list")
  target_link_options(${target} PRIVATE "-Wl,--dynamic-list=${exports}")
  set_property(TARGET ${target} APPEND PROPERTY LINK_DEPENDS "${exports}")
  ros_install_rpath(${target} "/..")
endfunction()

function(link_interfaces target)
  foreach(package IN ITEMS composition_interfaces play_launch_msgs)
    if(TARGET ${package}__rosidl_typesupport_cpp)
      # Generated in this build: its headers exist once its generator target has run.
      target_link_libraries(${target} PRIVATE ${package}__rosidl_typesupport_cpp)
      add_dependencies(${target} ${package})
    else()
      ros_package(${package})
      target_link_libraries(${target} PRIVATE ros::${package})
    endif()
  endforeach()
endfunction()
