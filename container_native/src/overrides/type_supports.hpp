#pragma once

namespace play_launch::isolation {

/// Looks up the type supports of all message and service types of C++ that a library uses, as the
/// middleware will. `library` is from dlopen(). Afterwards nodes of it are made without the dynamic
/// loader's lock. Takes that lock itself, and opens the libraries of type supports.
void look_up_type_supports(void* library);

}  // namespace play_launch::isolation
