"""Starts the node with a file of parameters: ``ros2 launch tidemap_ros tidemap.launch.py parameters:=FILE``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """The parts that ``ros2 launch`` starts."""
    usual = PathJoinSubstitution([FindPackageShare("tidemap_ros"), "config", "tidemap.yaml"])
    return LaunchDescription([
        DeclareLaunchArgument("parameters", default_value=usual, description="file of parameters"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="whether the time is that of /clock"),
        Node(
            package="tidemap_ros", executable="tidemap_node", name="tidemap", output="screen",
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("parameters"), {"use_sim_time": LaunchConfiguration("use_sim_time")}],
            # Observations are on the disk; a node that ended goes on from there.
            respawn=True, respawn_delay=5.0,
        ),
    ])
