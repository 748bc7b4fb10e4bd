#include <unistd.h>

#include <chrono>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <sensor_msgs/msg/image.hpp>
#include <sstream>
#include <std_msgs/msg/string.hpp>

namespace test_components {

using sensor_msgs::msg::Image;

/// Publishes 2 MB images, which say in their frame_id in which process and where they were made.
/// One that is copied is kept, so that no copy gets its place.
class ImageSource : public rclcpp::Node {
 public:
  explicit ImageSource(const rclcpp::NodeOptions& options) : Node("image_source", options) {
    publisher_ = create_publisher<Image>("image", 10);
    timer_ = create_wall_timer(std::chrono::milliseconds(10), [this] { publish(); });
    if (!options.use_intra_process_comms()) {
      kept_ = make();
    }
  }

 private:
  void publish() {
    if (kept_) {
      publisher_->publish(*kept_);
    } else {
      publisher_->publish(make());
    }
  }

  static Image::UniquePtr make() {
    constexpr std::uint32_t kBytes = 2'000'000;
    auto image = std::make_unique<Image>();
    image->width = image->step = kBytes;
    image->height = 1;
    image->encoding = "mono8";
    image->data.resize(kBytes);
    std::ostringstream text;
    text << ::getpid() << ' ' << static_cast<const void*>(image->data.data());
    image->header.frame_id = text.str();
    return image;
  }

  Image::UniquePtr kept_;
  rclcpp::Publisher<Image>::SharedPtr publisher_;
  rclcpp::TimerBase::SharedPtr timer_;
};

/// Tells for each image on `verdict`: the sender's process and address, its own process and the
/// address that it got.
class ImageSink : public rclcpp::Node {
 public:
  explicit ImageSink(const rclcpp::NodeOptions& options) : Node("image_sink", options) {
    publisher_ = create_publisher<std_msgs::msg::String>("verdict", 10);
    subscription_ =
        create_subscription<Image>("image", 10, [this](Image::UniquePtr image) { judge(*image); });
  }

 private:
  void judge(const Image& image) {
    std::ostringstream text;
    text << image.header.frame_id << ' ' << ::getpid() << ' '
         << static_cast<const void*>(image.data.data());
    std_msgs::msg::String verdict;
    verdict.data = text.str();
    publisher_->publish(verdict);
  }

  rclcpp::Publisher<std_msgs::msg::String>::SharedPtr publisher_;
  rclcpp::Subscription<Image>::SharedPtr subscription_;
};

}  // namespace test_components

RCLCPP_COMPONENTS_REGISTER_NODE(test_components::ImageSource)
RCLCPP_COMPONENTS_REGISTER_NODE(test_components::ImageSink)
