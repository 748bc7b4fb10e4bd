"""The same robot as a launch file of ROS, without what only `robot.yaml` can say."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer, LifecycleNode, LifecycleTransition, Node
from launch_ros.descriptions import ComposableNode
from lifecycle_msgs.msg import Transition


def generate_launch_description() -> LaunchDescription:
    fails_after = LaunchConfiguration("fails_after")
    sensing = [
        ComposableNode(
            package="my_robot",
            plugin="my_robot::RangeFilter",
            name="range_filter",
            parameters=[{"window": 5}],
        ),
        ComposableNode(
            package="my_robot",
            plugin="my_robot::Battery",
            name="battery",
            parameters=[{"voltage": 12.6}],
        ),
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "fails_after", default_value="200", description="Measurements; 0: never."
            ),
            ComposableNodeContainer(
                package="play_launch_container",
                executable="component_container",
                name="sensing",
                namespace="",
                composable_node_descriptions=sensing,
            ),
            Node(
                package="my_robot",
                executable="driver.py",
                name="driver",
                parameters=[{"fails_after": fails_after}],
                respawn=True,
            ),
            LifecycleNode(
                package="my_robot",
                executable="planner.py",
                name="planner",
                namespace="",
            ),
            LifecycleTransition(
                lifecycle_node_names=["/planner"],
                transition_ids=[Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE],
            ),
        ]
    )
