"""Launch the planner alongside Nav2 and slam_toolbox: `ros2 launch dc2g_planner dc2g_planner.launch.py`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """One node, with parameters from a file."""
    parameters = Path(get_package_share_directory("dc2g_planner")) / "config" / "dc2g_planner.yaml"
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=str(parameters)),
            Node(
                package="dc2g_planner",
                executable="dc2g_planner",
                name="dc2g_planner",
                output="screen",
                parameters=[LaunchConfiguration("params_file")],
            ),
        ]
    )
