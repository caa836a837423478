"""The node: it reads a map and the robot's pose, and publishes subgoal, path and ranked frontiers."""

import functools
import gc
import sys
from types import SimpleNamespace
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, Vector3
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.action import ActionClient
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from std_msgs.msg import ColorRGBA, Header, String
from tf2_ros import Buffer, TransformException, TransformListener
from visualization_msgs.msg import Marker, MarkerArray

from dc2g_jax.errors import InputError
from dc2g_jax.planning.metric import MetricDecision, MetricPlanner
from dc2g_jax.planning.metric_map import MetricPose
from dc2g_jax.planning.planners import EXPLORE, MODE_NAMES

from .messages import Outgoing, doors_of, labels_of, map_of, place_to_drive_to, pose_of

_TYPES = SimpleNamespace(
    ColorRGBA=ColorRGBA, Header=Header, Marker=Marker, MarkerArray=MarkerArray, Path=Path, Point=Point, Pose=Pose,
    PoseArray=PoseArray, PoseStamped=PoseStamped, Quaternion=Quaternion, String=String, Vector3=Vector3,
)  # fmt: skip

#: The last message is kept for subscribers that come later.
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

#: Targets that differ by less than this, in meters and radians, are the same.
_SAME = 0.01


class PlannerNode(Node):
    """Decides after each new map, and drives if the parameter `drive` says so."""

    def __init__(self) -> None:
        super().__init__("dc2g_planner")
        defaults: dict[str, Any] = {
            "planner": "", "network": "", "cell_size": 0.25, "smallest_cell": 0.0, "sensing_range": 3.0,
            "labels": [""], "largest": [100, 100], "base_frame": "base_link", "period": 1.0, "drive": False,
        }  # fmt: skip
        given = {name: self.declare_parameter(name, default).value for name, default in defaults.items()}
        self._planner = MetricPlanner(
            given["planner"] or None,
            cell_size=given["cell_size"],
            smallest_cell=given["smallest_cell"] or None,
            sensing_range=given["sensing_range"],
            labels=labels_of(given["labels"]),
            network=given["network"] or None,
            largest=tuple(given["largest"]),
        )
        gc.freeze()  # a full collection would delay some decision by a tenth of a second
        self._base_frame = given["base_frame"]
        self._map: OccupancyGrid | None = None
        self._doors = PoseArray()
        self._is_news = False
        self._goal: MetricPose | None = None
        self._aborted: list[MetricPose] = []
        self._has_arrived = False
        self._tf = Buffer()
        self._listener = TransformListener(self._tf, self)
        self._nav2 = ActionClient(self, NavigateToPose, "navigate_to_pose") if given["drive"] else None
        self._out = {
            name: self.create_publisher(kind, f"~/{name}", _LATCHED)
            for name, kind in (
                ("frontiers", PoseArray), ("subgoal", PoseStamped), ("path", Path), ("markers", MarkerArray),
                ("why", String), ("mode", String),
            )
        }  # fmt: skip
        self.create_subscription(OccupancyGrid, "map", self._on_map, _LATCHED)
        self.create_subscription(PoseArray, "doors", self._on_doors, 1)
        self.create_timer(given["period"], self._decide)

    def _on_map(self, message: OccupancyGrid) -> None:
        self._map, self._is_news = message, True

    def _on_doors(self, message: PoseArray) -> None:
        self._doors, self._is_news = message, True

    def _decide(self) -> None:
        """If anything is new, decide on the latest map and publish the decision."""
        if self._map is None or not self._is_news:
            return
        frame = self._map.header.frame_id
        try:
            transform = self._tf.lookup_transform(frame, self._base_frame, Time()).transform
            doors = doors_of(self._doors, frame) if self._doors.poses else []
            decision = self._planner.plan(map_of(self._map), pose_of(transform), doors=doors)
        except (InputError, TransformException) as error:
            self.get_logger().warning(f"no decision: {error}")
            return
        self._is_news = False
        out = Outgoing(_TYPES, frame, self.get_clock().now().to_msg())
        for name in ("frontiers", "path", "markers", "why", "mode"):
            self._out[name].publish(getattr(out, name)(decision))
        if decision.subgoal is not None:
            self._out["subgoal"].publish(out.stamped(decision.subgoal))
        self._drive(out, decision)

    def _drive(self, out: Outgoing, decision: MetricDecision) -> None:
        """Send the robot where the decision says, unless it is already going there. Nav2 then drops its last goal."""
        place = place_to_drive_to(decision)
        if self._nav2 is None or place is None:
            return
        if self._goal is not None and _is_same(place, self._goal):
            if self._has_arrived:
                self._drop(place, decision, "Nav2 has arrived, by its tolerance, but the planner still goes to")
            return
        if not self._nav2.server_is_ready():
            self.get_logger().warning("Nav2's action navigate_to_pose is not available yet")
            self._is_news = True
            return
        self._goal, self._has_arrived = place, False
        goal = NavigateToPose.Goal()
        goal.pose = out.stamped(place)
        self._nav2.send_goal_async(goal).add_done_callback(functools.partial(self._on_answer, place, decision))

    def _on_answer(self, place: MetricPose, decision: MetricDecision, future: Any) -> None:
        handle = future.result()
        if handle.accepted:
            handle.get_result_async().add_done_callback(functools.partial(self._on_result, place, decision))
        elif place == self._goal:
            self.get_logger().warning("Nav2 rejected the subgoal")
            self._goal, self._is_news = None, True

    def _on_result(self, place: MetricPose, decision: MetricDecision, future: Any) -> None:
        """Decide again at the subgoal. Short of it, wait for the next map: Nav2 also aborts for someone else's goal."""
        if place != self._goal:
            return
        status = future.result().status
        if status == GoalStatus.STATUS_SUCCEEDED:
            self._has_arrived = self._is_news = True
            return
        self._goal = None
        is_aborted = status == GoalStatus.STATUS_ABORTED
        if is_aborted and any(_is_same(place, other) for other in self._aborted):
            self._drop(place, decision, "Nav2 cannot reach")
            return
        if is_aborted:
            self._aborted.append(place)
        self.get_logger().warning(
            f"Nav2 ended short of ({place.x:.2f}, {place.y:.2f}) m with status {status}; the next map decides"
        )

    def _drop(self, place: MetricPose, decision: MetricDecision, why: str) -> None:
        """Set aside what would be seen from a subgoal. The way to a door is tried again with the next map."""
        self._goal = None
        if decision.mode == MODE_NAMES[EXPLORE]:
            self._planner.set_aside(place)
            self._is_news = True
        self.get_logger().warning(f"{why} ({place.x:.2f}, {place.y:.2f}) m")


def _is_same(one: MetricPose, other: MetricPose) -> bool:
    return max(abs(a - b) for a, b in zip(one, other, strict=True)) < _SAME


def main() -> None:
    """Run the node."""
    rclpy.init()
    try:
        rclpy.spin(PlannerNode())
    except (InputError, ParameterException) as error:
        sys.exit(f"error: {error}")
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
