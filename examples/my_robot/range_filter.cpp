#include <algorithm>
#include <cstddef>
#include <deque>
#include <memory>
#include <play_launch/component.hpp>
#include <std_msgs/msg/float64.hpp>
#include <stdexcept>
#include <vector>

namespace my_robot {

using std_msgs::msg::Float64;

/// Publishes the median of the latest values of `range` on `range/filtered`. Parameter: `window`.
class RangeFilter : public play_launch::Node {
 public:
  explicit RangeFilter(const play_launch::NodeOptions& options) : Node("range_filter", options) {
    const auto window = declare_parameter<std::int64_t>("window", 5);
    if (window < 1) {
      throw std::invalid_argument("parameter window must be at least 1");
    }
    window_ = static_cast<std::size_t>(window);
    publisher_ = create_publisher<Float64>("range/filtered");
    subscription_ = create_subscription<Float64>(
        "range", play_launch::QoS{}, [this](const Float64& message) { take(message.data); });
  }

 private:
  void take(double value) {
    values_.push_back(value);
    if (values_.size() > window_) {
      values_.pop_front();
    }
    std::vector<double> sorted(values_.begin(), values_.end());
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    Float64 message;
    message.data = *middle;
    publisher_->publish(message);
  }

  std::size_t window_ = 0;
  std::deque<double> values_;
  std::shared_ptr<play_launch::Publisher<Float64>> publisher_;
  std::shared_ptr<play_launch::Subscription<Float64>> subscription_;
};

}  // namespace my_robot

PLAY_LAUNCH_REGISTER_COMPONENT(my_robot::RangeFilter)
