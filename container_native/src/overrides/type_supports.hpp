#pragma once

namespace play_launch::isolation {

/// Looks up the type supports of all message and service types of C++ that a library uses, as the
/// middleware will. `library` is from dlopen(). Afterwards nodes of it are made without the dynamic
/// loader's lock. Takes that lock itself, and opens the libraries of type supports.
void look_up_type_supports(void* library);

/// Likewise for the program and all libraries that are there now, before the middleware has asked
/// for anything: for types of C++ it is going to ask for `cpp`, for messages of C for `c`, both
/// constants.
void look_up_type_supports_of_program(const char* cpp, const char* c);

}  // namespace play_launch::isolation
