"""play-launch: brings up a whole ROS 2 system from one YAML file and records what happened."""
