#pragma once

#include <rmw/types.h>

#include <string>
#include <vector>

namespace play_launch::topics {

/// What to ask for so that every one of these publishers is heard: reliable and transient_local
/// only where all of them are, as rosbag2 does. `offered` is not empty.
rmw_qos_profile_t request_for(const std::vector<rmw_qos_profile_t>& offered);

/// Whether a subscription that asks for `present` does not hear publishers that `wanted` does.
bool asks_too_much(const rmw_qos_profile_t& present, const rmw_qos_profile_t& wanted);

/// The profiles as rosbag2 stores them beside a channel, in YAML; policies as numbers, which every
/// rosbag2 from Foxy on reads.
std::string offered_qos_profiles(const std::vector<rmw_qos_profile_t>& offered);

}  // namespace play_launch::topics
