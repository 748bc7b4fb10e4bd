# Used with the ROS wheels only: they bundle the OpenSSL that they were built with, but their CMake
# files still demand the machine's development package. Nothing of it is compiled or linked here.
set(OPENSSL_FOUND TRUE)
set(OpenSSL_FOUND TRUE)
set(OPENSSL_VERSION "1.1.1")
set(OPENSSL_INCLUDE_DIR "")
set(OPENSSL_LIBRARIES "")
foreach(component IN ITEMS SSL Crypto)
  if(NOT TARGET OpenSSL::${component})
    add_library(OpenSSL::${component} INTERFACE IMPORTED)
  endif()
endforeach()
