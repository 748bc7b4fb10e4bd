#pragma once

#include <rmw/types.h>

#include <chrono>
#include <cstddef>

namespace play_launch {

/// Quality of service of a publisher, subscription or service. Defaults as in all of ROS 2: keep
/// the last 10, reliable, volatile. Setters return the object, so that they can be chained.
class QoS {
 public:
  QoS();
  /// Keep the last `depth` messages. Implicit on purpose: `create_publisher<M>("topic", 10)`.
  QoS(std::size_t depth);  // NOLINT(google-explicit-constructor)
  /// Takes over a middleware profile as it is.
  explicit QoS(const rmw_qos_profile_t& profile) : profile_(profile) {}

  /// Keep the last 5, best effort.
  static QoS sensor_data();
  /// What services use.
  static QoS services();
  /// What /parameter_events uses.
  static QoS parameter_events();
  /// What /rosout uses: reliable, transient local, keeps 1000 for 10 s.
  static QoS rosout();

  QoS& keep_last(std::size_t depth);
  QoS& keep_all();
  QoS& reliable();
  QoS& best_effort();
  QoS& durability_volatile();
  QoS& transient_local();
  QoS& deadline(std::chrono::nanoseconds period);
  QoS& lifespan(std::chrono::nanoseconds duration);
  QoS& liveliness_lease(std::chrono::nanoseconds duration);

  /// Messages kept per endpoint; meaningless with keep_all().
  [[nodiscard]] std::size_t depth() const noexcept { return profile_.depth; }
  /// The profile as the middleware wants it.
  [[nodiscard]] const rmw_qos_profile_t& profile() const noexcept { return profile_; }

 private:
  rmw_qos_profile_t profile_;
};

}  // namespace play_launch
