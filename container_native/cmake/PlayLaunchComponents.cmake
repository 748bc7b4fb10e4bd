# play_launch_add_components(<library> <sources...> PLUGINS <Class...> [DEPENDS <ROS package...>])
#
# Builds a shared library of components for play-launch's container and registers it: the container
# finds `package: <project name>, plugin: <Class>` through the ament resource
# `play_launch_components`. PLUGINS are the names given to PLAY_LAUNCH_REGISTER_COMPONENT.
# May be called once for each library of a package: the index has the classes of all of them.
# Install prefix: where ROS, or an overlay named in AMENT_PREFIX_PATH, is.

function(play_launch_add_components library)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "PACKAGE" "PLUGINS;DEPENDS")
  if(NOT arg_PLUGINS)
    message(FATAL_ERROR "play_launch_add_components(${library}): PLUGINS names no class")
  endif()
  if(NOT arg_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "play_launch_add_components(${library}): no source files")
  endif()
  if(NOT arg_PACKAGE)
    set(arg_PACKAGE "${PROJECT_NAME}")
  endif()
  add_library(${library} SHARED ${arg_UNPARSED_ARGUMENTS})
  target_compile_features(${library} PUBLIC cxx_std_20)
  target_link_libraries(${library} PRIVATE play_launch::component)
  foreach(package IN LISTS arg_DEPENDS)
    ros_package(${package})
    target_link_libraries(${library} PRIVATE ros::${package})
  endforeach()
  ros_install_rpath(${library} "")

  install(TARGETS ${library} LIBRARY DESTINATION lib)
  foreach(plugin IN LISTS arg_PLUGINS)
    _play_launch_add_to_index("${arg_PACKAGE}" "${plugin};lib/lib${library}.so")
  endforeach()
endfunction()

# Adds a line to the package's entry in the index, which the first line of this build creates.
function(_play_launch_add_to_index package line)
  set(property _play_launch_components_of_${package})
  get_property(entry GLOBAL PROPERTY ${property})
  if(NOT entry)
    set(index "${CMAKE_CURRENT_BINARY_DIR}/share/ament_index/resource_index")
    set(entry "${index}/play_launch_components/${package}")
    set_property(GLOBAL PROPERTY ${property} "${entry}")
    file(WRITE "${entry}" "")
    file(WRITE "${index}/packages/${package}" "")
    install(DIRECTORY "${index}" DESTINATION share/ament_index)
  endif()
  file(APPEND "${entry}" "${line}\n")
endfunction()
