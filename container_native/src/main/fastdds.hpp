#pragma once

namespace play_launch::container {

/// Opens the libraries in which the middleware, if it is Fast DDS, is going to look for the types
/// that a container has of its own. Initialises nothing of it. Takes the dynamic loader's lock.
void open_type_supports();

}  // namespace play_launch::container
