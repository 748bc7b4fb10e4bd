#include <rcl/logging_rosout.h>
#include <rmw/qos_profiles.h>

#include <play_launch/qos.hpp>

namespace play_launch {
namespace {

rmw_time_t to_rmw_time(std::chrono::nanoseconds duration) {
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(duration);
  return {static_cast<std::uint64_t>(seconds.count()),
          static_cast<std::uint64_t>((duration - seconds).count())};
}

}  // namespace

QoS::QoS() : profile_(rmw_qos_profile_default) {}
QoS::QoS(std::size_t depth) : QoS() { keep_last(depth); }

QoS QoS::sensor_data() { return QoS(rmw_qos_profile_sensor_data); }
QoS QoS::services() { return QoS(rmw_qos_profile_services_default); }
QoS QoS::parameter_events() { return QoS(rmw_qos_profile_parameter_events); }
QoS QoS::rosout() { return QoS(rcl_qos_profile_rosout_default); }

QoS& QoS::keep_last(std::size_t depth) {
  profile_.history = RMW_QOS_POLICY_HISTORY_KEEP_LAST;
  profile_.depth = depth;
  return *this;
}

QoS& QoS::keep_all() {
  profile_.history = RMW_QOS_POLICY_HISTORY_KEEP_ALL;
  profile_.depth = 0;
  return *this;
}

QoS& QoS::reliable() {
  profile_.reliability = RMW_QOS_POLICY_RELIABILITY_RELIABLE;
  return *this;
}

QoS& QoS::best_effort() {
  profile_.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  return *this;
}

QoS& QoS::durability_volatile() {
  profile_.durability = RMW_QOS_POLICY_DURABILITY_VOLATILE;
  return *this;
}

QoS& QoS::transient_local() {
  profile_.durability = RMW_QOS_POLICY_DURABILITY_TRANSIENT_LOCAL;
  return *this;
}

QoS& QoS::deadline(std::chrono::nanoseconds period) {
  profile_.deadline = to_rmw_time(period);
  return *this;
}

QoS& QoS::lifespan(std::chrono::nanoseconds duration) {
  profile_.lifespan = to_rmw_time(duration);
  return *this;
}

QoS& QoS::liveliness_lease(std::chrono::nanoseconds duration) {
  profile_.liveliness_lease_duration = to_rmw_time(duration);
  return *this;
}

}  // namespace play_launch
