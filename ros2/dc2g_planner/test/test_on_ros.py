"""The node on a ROS installation; DC2G_PYTHON is a Python that has dc2g_jax, by default that of ROS."""

import os
import time

import numpy as np
import rclpy
from dc2g_planner.node import _LATCHED, PlannerNode
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from tf2_ros import StaticTransformBroadcaster


def test_a_map_leads_to_a_subgoal():
    """A room that is open to the right, with the robot in it."""
    rclpy.init(args=["--ros-args", "-p", f"python:={os.environ.get('DC2G_PYTHON', '')}"])
    planner, robot = PlannerNode(), rclpy.create_node("robot")
    executor = MultiThreadedExecutor()
    for node in (planner, robot):
        executor.add_node(node)
    subgoals = []
    robot.create_subscription(PoseStamped, "/dc2g_planner/subgoal", subgoals.append, _LATCHED)
    place = TransformStamped(child_frame_id="base_link")
    place.header.frame_id = "map"
    place.transform.translation.x = place.transform.translation.y = 1.0
    place.transform.rotation.w = 1.0
    StaticTransformBroadcaster(robot).sendTransform(place)
    seen = OccupancyGrid()
    seen.header.frame_id = "map"
    seen.info.resolution, seen.info.width, seen.info.height = 0.05, 60, 40
    seen.info.origin.orientation.w = 1.0
    cells = np.full((40, 60), -1, np.int8)
    cells[:, :50] = 100
    cells[2:38, 2:50] = 0
    seen.data = cells.ravel().tolist()
    robot.create_publisher(OccupancyGrid, "/map", _LATCHED).publish(seen)
    for transition in (planner.trigger_configure, planner.trigger_activate):
        assert transition() == TransitionCallbackReturn.SUCCESS
    deadline = time.monotonic() + 60
    while not subgoals and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    planner.trigger_shutdown()
    rclpy.try_shutdown()
    assert subgoals[0].pose.position.x > 1.0
