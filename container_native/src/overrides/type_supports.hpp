#pragma once

namespace play_launch::isolation {

/// Looks up the type supports of all message and service types of C++ that a library which is open
/// uses, as the middleware will; null: the program. Afterwards nodes of it are made without the
/// dynamic loader's lock. Takes that lock itself, and opens the libraries of type supports.
void look_up_type_supports(const char* library);

}  // namespace play_launch::isolation
