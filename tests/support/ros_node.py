"""A robot as a node of ROS, run by a Python that has rclpy: it publishes maps and prints the planner's answers.

Its input is one line of JSON: the cells of a map, its rows and columns, side of a cell and origin, and how many maps to
publish. The number of a map is its stamp. Each map follows the answer to the one before; the last answer is printed.
"""

import json
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseArray, PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
KINDS = {
    "frontiers": PoseArray, "path": Path, "markers": MarkerArray, "why": String, "mode": String,
    "subgoal": PoseStamped,
}  # fmt: skip


def main() -> None:
    """Publish, and wait for the answers."""
    given = json.loads(input())
    rclpy.init()
    node, found, goals = rclpy.create_node("robot"), {}, []
    for name, kind in KINDS.items():
        node.create_subscription(
            kind, f"/dc2g_planner/{name}", lambda got, name=name: found.update({name: got}), LATCHED
        )
    node.create_subscription(PoseStamped, "/goal_pose", goals.append, 10)
    maps = node.create_publisher(OccupancyGrid, "/map", LATCHED)
    message = OccupancyGrid()
    message.header.frame_id = "map"
    message.info.height, message.info.width = given["shape"]
    message.info.resolution = given["resolution"]
    origin = message.info.origin
    origin.position.x, origin.position.y = given["origin"]
    origin.orientation.z, origin.orientation.w = given["turn"]
    message.data = given["cells"]

    def stamps() -> list[int]:
        numbered: list[Any] = [found.get("frontiers"), found.get("path"), found.get("subgoal")]
        numbered += found["markers"].markers if "markers" in found else [None]
        return [each.header.stamp.sec if each else -1 for each in numbered]

    for number in range(1, given["maps"] + 1):
        message.header.stamp.sec = number
        maps.publish(message)
        end = time.monotonic() + 20
        while set(stamps()) != {number} or not found.keys() >= KINDS.keys():
            assert time.monotonic() < end, f"no answer to map {number}: {stamps()}"
            assert max(stamps()) <= number
            rclpy.spin_once(node, timeout_sec=0.1)
    places = {name: [each.pose.position for each in found["path"].poses] for name in ("path",)}
    places |= {"frontiers": [each.position for each in found["frontiers"].poses]}
    places |= {"subgoal": [found["subgoal"].pose.position], "goals": [each.pose.position for each in goals]}
    answer: dict[str, Any] = {name: [(at.x, at.y) for at in each] for name, each in places.items()}
    answer |= {"why": found["why"].data, "mode": found["mode"].data}
    answer |= {"markers": [marker.type for marker in found["markers"].markers]}
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
