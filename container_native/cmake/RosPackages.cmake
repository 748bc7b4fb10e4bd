# ros_package(<name>): makes the target ros::<name> from the files of an installed ROS package.
#
# The packages' own CMake files are not used for this. With the ROS wheels they name folders and
# libraries of the machine that built the wheels, and want build tools that the wheels do not bring;
# the files themselves are all there: <prefix>/include/<name>, <prefix>/lib/lib<name>.so or the C++
# type support, and <prefix>/share/<name>/package.xml with the dependencies. A ROS installation and
# a colcon workspace have the same layout (REP 122), so there is one way for all.
#
# Prefixes: CMAKE_PREFIX_PATH, then the environment's AMENT_PREFIX_PATH, then ROS_PREFIX.

function(ros_prefixes result)
  set(prefixes ${CMAKE_PREFIX_PATH})
  if(DEFINED ENV{AMENT_PREFIX_PATH})
    string(REPLACE ":" ";" from_environment "$ENV{AMENT_PREFIX_PATH}")
    list(APPEND prefixes ${from_environment})
  endif()
  list(APPEND prefixes ${ROS_PREFIX})
  list(REMOVE_DUPLICATES prefixes)
  set(${result}
      ${prefixes}
      PARENT_SCOPE)
endfunction()

function(ros_package_prefix name result)
  ros_prefixes(prefixes)
  foreach(prefix IN LISTS prefixes)
    if(EXISTS "${prefix}/share/${name}/package.xml")
      set(${result}
          "${prefix}"
          PARENT_SCOPE)
      return()
    endif()
  endforeach()
  set(${result}
      ""
      PARENT_SCOPE)
endfunction()

function(ros_package name)
  if(TARGET ros::${name})
    return()
  endif()
  ros_package_prefix(${name} prefix)
  if(NOT prefix)
    ros_prefixes(prefixes)
    list(JOIN prefixes ", " searched)
    message(FATAL_ERROR "ROS package ${name} is not installed (looked in: ${searched})")
  endif()
  add_library(ros::${name} INTERFACE IMPORTED GLOBAL)
  if(EXISTS "${prefix}/include/${name}")
    target_include_directories(ros::${name} SYSTEM INTERFACE "${prefix}/include/${name}")
  endif()
  foreach(library IN ITEMS ${name} ${name}__rosidl_typesupport_cpp ${name}__rosidl_typesupport_fastrtps_cpp)
    if(EXISTS "${prefix}/lib/lib${library}.so")
      target_link_libraries(ros::${name} INTERFACE "${prefix}/lib/lib${library}.so")
    endif()
  endforeach()
  target_link_options(ros::${name} INTERFACE "-Wl,--as-needed" "-Wl,-rpath-link,${prefix}/lib")

  # A dependency that is not installed is a build tool; the compiler reports a missing header.
  file(READ "${prefix}/share/${name}/package.xml" manifest)
  string(REGEX MATCHALL "<(depend|build_depend|build_export_depend|exec_depend)[^>]*>[^<]+<" entries
               "${manifest}")
  foreach(entry IN LISTS entries)
    string(REGEX REPLACE "<[^>]*>([^<]+)<" "\\1" dependency "${entry}")
    string(STRIP "${dependency}" dependency)
    ros_package_prefix("${dependency}" found)
    if(found AND (EXISTS "${found}/include/${dependency}" OR EXISTS
                                                             "${found}/lib/lib${dependency}.so"))
      ros_package("${dependency}")
      target_link_libraries(ros::${name} INTERFACE ros::${dependency})
    endif()
  endforeach()
endfunction()

# The wheels keep what they bundle (OpenSSL, tinyxml2, ...) beside the Python packages, most of it
# several times. Gives folders that have all of it, for each version of Python: what is built here
# is installed for any.
function(ros_bundled_folders prefix result)
  file(GLOB folders RELATIVE "${prefix}/lib" "${prefix}/lib/python3*/site-packages/ros_*.libs")
  set(seen "")
  set(chosen "")
  foreach(folder IN LISTS folders)
    file(GLOB libraries RELATIVE "${prefix}/lib/${folder}" "${prefix}/lib/${folder}/*.so*")
    set(new ${libraries})
    list(REMOVE_ITEM new ${seen})
    if(new)
      list(APPEND seen ${new})
      foreach(version IN ITEMS 3.11 3.12 3.13 3.14)
        string(REGEX REPLACE "python3[.][0-9]+" "python${version}" place "${folder}")
        list(APPEND chosen "${place}")
      endforeach()
    endif()
  endforeach()
  set(${result}
      ${chosen}
      PARENT_SCOPE)
endfunction()

# Lets a program or library in <prefix>/lib/... find ROS without LD_LIBRARY_PATH. `up` leads from
# its folder to <prefix>/lib. DT_RPATH, not RUNPATH: it must hold for the libraries' own
# dependencies too. With ROS_RPATH_ABSOLUTE the prefix of ROS is written in as well: for projects
# that are installed elsewhere.
function(ros_install_rpath target up)
  ros_bundled_folders("${ROS_PREFIX}" folders)
  set(paths "$ORIGIN${up}")
  foreach(folder IN LISTS folders)
    list(APPEND paths "$ORIGIN${up}/${folder}")
    target_link_options(${target} PRIVATE "-Wl,-rpath-link,${ROS_PREFIX}/lib/${folder}")
  endforeach()
  if(ROS_RPATH_ABSOLUTE)
    list(APPEND paths "${ROS_PREFIX}/lib")
    foreach(folder IN LISTS folders)
      list(APPEND paths "${ROS_PREFIX}/lib/${folder}")
    endforeach()
  endif()
  set_target_properties(${target} PROPERTIES INSTALL_RPATH "${paths}")
  target_link_options(${target} PRIVATE "-Wl,--disable-new-dtags"
                      "-Wl,-rpath-link,${ROS_PREFIX}/lib")
endfunction()
