"""Launch the planner alongside Nav2 and slam_toolbox: `ros2 launch dc2g_planner dc2g_planner.launch.py`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

#: Arguments that override the file of parameters, if they are given.
_SWITCHES = ("drive", "use_sim_time")


def generate_launch_description() -> LaunchDescription:
    """One node, with parameters from a file."""
    parameters = Path(get_package_share_directory("dc2g_planner")) / "config" / "dc2g_planner.yaml"
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=str(parameters)),
            *(DeclareLaunchArgument(name, default_value="", choices=["", "true", "false"]) for name in _SWITCHES),
            DeclareLaunchArgument("map", default_value="map", description="Topic of the map."),
            DeclareLaunchArgument("namespace", default_value=""),
            DeclareLaunchArgument("python", default_value="", description="A Python that has dc2g_jax."),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    """The node, from the values of the arguments."""

    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    given: dict[str, bool | str] = {name: value(name) == "true" for name in _SWITCHES if value(name)}
    if value("python"):
        given["python"] = value("python")
    return [
        Node(
            package="dc2g_planner",
            executable="dc2g_planner",
            name="dc2g_planner",
            namespace=value("namespace"),
            output="screen",
            parameters=[value("params_file"), *([given] if given else [])],
            remappings=[("map", value("map"))],
        )
    ]
