// The public headers of the SDK, and what they include of ROS, for a precompiled header.
#pragma once

#include <play_launch/component.hpp>

#include "standard.hpp"
