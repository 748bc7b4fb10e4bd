# Runs at the end of an installation: takes the debug information out of what was installed, and puts
# it where gdb and `play-launch explain` look for it: <DEBUG_FOLDER>/.build-id/ab/cdef.debug. The
# names of functions stay.
foreach(installed IN LISTS CMAKE_INSTALL_MANIFEST_FILES)
  set(file "$ENV{DESTDIR}${installed}")
  if(NOT file MATCHES "/lib/" OR IS_SYMLINK "${file}")
    continue()
  endif()
  execute_process(
    COMMAND "${READELF}" --notes "${file}"
    OUTPUT_VARIABLE notes
    ERROR_QUIET)
  if(notes MATCHES "Build ID: ([0-9a-f][0-9a-f])([0-9a-f]+)")
    set(folder "${DEBUG_FOLDER}/.build-id/${CMAKE_MATCH_1}")
    set(debug "${folder}/${CMAKE_MATCH_2}.debug")
    file(MAKE_DIRECTORY "${folder}")
    execute_process(COMMAND "${OBJCOPY}" --only-keep-debug "${file}" "${debug}"
                            COMMAND_ERROR_IS_FATAL ANY)
    execute_process(COMMAND "${OBJCOPY}" --strip-debug "${file}" COMMAND_ERROR_IS_FATAL ANY)
  endif()
endforeach()
