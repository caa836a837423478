"""The node: it reads a map and the robot's pose, and publishes subgoal, path and ranked frontiers."""

import functools
import signal
import sys
from types import SimpleNamespace
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, Vector3
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import OccupancyGrid, Path
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from std_msgs.msg import ColorRGBA, Header, String
from std_srvs.srv import SetBool, Trigger
from tf2_ros import Buffer, TransformException, TransformListener
from visualization_msgs.msg import Marker, MarkerArray

from .decider import PARAMETERS, Decider, planner_options
from .messages import OUTPUTS, Outgoing, is_same, place_to_drive_to, pose_of
from .planner_process import Decision, MapPose, PlannerProcess, Refused

_TYPES = SimpleNamespace(
    ColorRGBA=ColorRGBA, Header=Header, Marker=Marker, MarkerArray=MarkerArray, Path=Path, Point=Point, Pose=Pose,
    PoseArray=PoseArray, PoseStamped=PoseStamped, Quaternion=Quaternion, String=String, Vector3=Vector3,
)  # fmt: skip

#: The last message is kept for subscribers that come later.
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

#: Parameters that only the node has.
_OWN = {
    "python": ("", "path of a Python that has dc2g_jax; empty: that of the node"),
    "autostart": (True, "whether the node configures and activates itself, without a lifecycle manager"),
}

#: Seconds to wait for Nav2 to cancel the goal when the node ends.
_SECONDS_TO_CANCEL = 1.0


class PlannerNode(LifecycleNode):
    """While it is active, decides after each new map, and drives if the parameter `drive` says so."""

    def __init__(self) -> None:
        super().__init__("dc2g_planner")
        self.given = given = {
            name: self.declare_parameter(name, default, ParameterDescriptor(description=words, read_only=True)).value
            for name, (default, words) in (_OWN | PARAMETERS).items()
        }
        self._planner: PlannerProcess | None = None
        self._base_frame = given["base_frame"]
        self._decider = Decider()
        self._goal: MapPose | None = None
        self._aborted: list[MapPose] = []
        self._has_arrived = False
        self._is_active = self._is_paused = False
        self._start: tuple[str, MapPose] | None = None
        self._handle: Any = None
        self._changing = self._decider.changing  # guards what is above, which several threads change
        self._tf = Buffer()
        self._listener = TransformListener(self._tf, self)
        self._nav2 = ActionClient(self, NavigateToPose, "navigate_to_pose") if given["drive"] else None
        self._out = {
            name: self.create_publisher(getattr(_TYPES, kind), f"~/{name}", _LATCHED) for name, kind in OUTPUTS.items()
        }
        self.create_subscription(OccupancyGrid, "map", self._decider.see_map, _LATCHED)
        self.create_subscription(PoseArray, "doors", self._decider.see_doors, 1)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/return_to_start", self._on_return)
        self.create_timer(given["period"], self._decide, callback_group=MutuallyExclusiveCallbackGroup())

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        """Start the planner's process, which compiles its programs or loads them."""
        try:
            self._planner = PlannerProcess(self.given["python"], **planner_options(self.given))
        except Refused as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Decide on the latest map, and on each new one."""
        self._is_active = self._decider.is_news = True
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Stop the robot, and decide nothing."""
        self._is_active = False
        self.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        """End the planner's process, and with it what was set aside."""
        self.end_planner()
        return super().on_cleanup(state)

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        """Stop the robot, and end the planner's process."""
        self._is_active = False
        self.stop()
        self.end_planner()
        return super().on_shutdown(state)

    def end_planner(self) -> None:
        """End the planner's process, if it runs."""
        planner, self._planner = self._planner, None
        if planner is not None:
            planner.close()

    @property
    def _rests(self) -> bool:
        return self._is_paused or not self._is_active

    def _on_pause(self, request: Any, response: Any) -> Any:
        """Stop the robot and decide nothing, or go on with the latest map."""
        self._is_paused, self._decider.is_news = request.data, True
        if request.data:
            self.stop()
        response.success, response.message = True, "paused" if request.data else "goes on"
        return response

    def _on_return(self, request: Any, response: Any) -> Any:
        """Pause, and send the robot to where it was at the first decision."""
        del request
        if not self._is_active or self._nav2 is None or self._start is None:
            why = "no decision has been made yet" if self._start is None else "the parameter drive is false"
            why = why if self._is_active else "the node is not active"
            response.success, response.message = False, why
            return response
        with self._changing:
            self._is_paused = True
            frame, place = self._start
            self._send(Outgoing(_TYPES, frame, self.get_clock().now().to_msg()).stamped(place), place, None)
        response.success, response.message = True, "returns to the start; ~/pause with data: false explores again"
        return response

    def stop(self) -> Any:
        """Cancel the goal that Nav2 has from this node. Returns the future of that; `None` if there is no goal."""
        with self._changing:
            handle, self._handle, self._goal = self._handle, None, None
        return None if handle is None else handle.cancel_goal_async()

    def _decide(self) -> None:
        """If anything is new, decide on the latest map and publish the decision."""
        planner = self._planner
        if planner is None or self._rests:
            return
        try:
            decided = self._decider.decide(planner, self._pose_in)
        except Refused as error:
            self.get_logger().warning(f"no decision: {error}")
            return
        with self._changing:
            if decided is not None and not self._rests:  # meanwhile
                frame = decided.header.frame_id
                self._start = self._start or (frame, decided.pose)
                self._tell(frame, decided.decision)

    def _pose_in(self, frame: str) -> MapPose:
        """The robot's pose."""
        try:
            return pose_of(self._tf.lookup_transform(frame, self._base_frame, Time()).transform)
        except TransformException as error:
            raise Refused(str(error)) from None

    def _tell(self, frame: str, decision: Decision) -> None:
        """Publish a decision and follow it."""
        out = Outgoing(_TYPES, frame, self.get_clock().now().to_msg())
        for name, message in out.all(decision):
            self._out[name].publish(message)
        self._drive(out, decision)

    def _drive(self, out: Outgoing, decision: Decision) -> None:
        """Send the robot where the decision says, unless it is already going there. Nav2 then drops its last goal."""
        place = place_to_drive_to(decision)
        if self._nav2 is None or place is None:
            return
        if self._goal is not None and is_same(place, self._goal):
            if self._has_arrived:
                self._drop(place, decision, "Nav2 has arrived, by its tolerance, but the planner still goes to")
            return
        if not self._nav2.server_is_ready():
            self.get_logger().warning("Nav2's action navigate_to_pose is not available yet")
            self._decider.is_news = True
            return
        self._send(out.stamped(place), place, decision)

    def _send(self, stamped: PoseStamped, place: MapPose, decision: Decision | None) -> None:
        """Send a goal to Nav2; without a decision, the robot only drives there."""
        assert self._nav2 is not None
        self._goal, self._has_arrived = place, False
        goal = NavigateToPose.Goal()
        goal.pose = stamped
        self._nav2.send_goal_async(goal).add_done_callback(functools.partial(self._on_answer, place, decision))

    def _on_answer(self, place: MapPose, decision: Decision | None, future: Any) -> None:
        with self._changing:
            self._answered(place, decision, future.result())

    def _answered(self, place: MapPose, decision: Decision | None, handle: Any) -> None:
        """Nav2 has accepted or rejected a goal."""
        if handle.accepted and place != self._goal and self._rests:
            handle.cancel_goal_async()  # paused before Nav2 answered
        elif handle.accepted:
            self._handle = handle
            handle.get_result_async().add_done_callback(functools.partial(self._on_result, place, decision))
        elif place == self._goal:
            self.get_logger().warning("Nav2 rejected the subgoal")
            self._goal, self._decider.is_news = None, True

    def _on_result(self, place: MapPose, decision: Decision | None, future: Any) -> None:
        with self._changing:
            if place == self._goal:
                self._ended(place, decision, future.result().status)

    def _ended(self, place: MapPose, decision: Decision | None, status: int) -> None:
        """Decide again at the subgoal. Short of it, wait for the next map: Nav2 also aborts for someone else's goal."""
        self._handle = None
        if status == GoalStatus.STATUS_SUCCEEDED:
            self._has_arrived = self._decider.is_news = True
            return
        self._goal = None
        is_aborted = status == GoalStatus.STATUS_ABORTED and decision is not None
        if decision is not None and is_aborted and any(is_same(place, other) for other in self._aborted):
            self._drop(place, decision, "Nav2 cannot reach")
            return
        if is_aborted:
            self._aborted.append(place)
        self.get_logger().warning(
            f"Nav2 ended short of ({place.x:.2f}, {place.y:.2f}) m with status {status}; the next map decides"
        )

    def _drop(self, place: MapPose, decision: Decision, why: str) -> None:
        """Set aside what would be seen from a subgoal. The way to a door is tried again with the next map."""
        self._goal = None
        if decision.mode == "explore":
            self._decider.set_aside(place)
        self.get_logger().warning(f"{why} ({place.x:.2f}, {place.y:.2f}) m")


def main() -> None:
    """Run the node."""
    # A signal must not end the context before the robot is stopped.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = None
    try:
        node = PlannerNode()
        if node.given["autostart"]:
            for transition in (node.trigger_configure, node.trigger_activate):
                if transition() != TransitionCallbackReturn.SUCCESS:
                    sys.exit("error: the node cannot start; its log says why")
        executor = MultiThreadedExecutor(num_threads=4)
        executor.add_node(node)
        executor.spin()
    except ParameterException as error:
        sys.exit(f"error: {error}")
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            if (canceled := node.stop()) is not None:
                rclpy.spin_until_future_complete(node, canceled, timeout_sec=_SECONDS_TO_CANCEL)
            node.end_planner()
        rclpy.try_shutdown()
