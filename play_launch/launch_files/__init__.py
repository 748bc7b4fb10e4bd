"""Launch files of ROS, evaluated, and the configurations that become of them."""
