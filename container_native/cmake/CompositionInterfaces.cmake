# Whose composition_interfaces to build against: that of ROS, or the one built here. Needs
# RosPackages.
#
# It is in every ROS installation, but not among the wheels. What an earlier installation of this
# project left beside the wheels does not count: it is removed when the new one is installed.
# Its manifest says <built_by>play_launch_container</built_by>.

function(ros_has_composition_interfaces result)
  ros_package_prefix(composition_interfaces prefix)
  set(found OFF)
  if(prefix)
    file(READ "${prefix}/share/composition_interfaces/package.xml" manifest)
    if(NOT manifest MATCHES "<built_by>play_launch_container<")
      set(found ON)
    endif()
  endif()
  set(${result}
      ${found}
      PARENT_SCOPE)
endfunction()
