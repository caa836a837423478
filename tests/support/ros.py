"""Messages of ROS 2 by rosbags, and as much of rclpy as the node uses. What is published is written and read as CDR."""

import os
import random
import socket
import subprocess
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)

_TYPES = {
    "builtin_interfaces": ("Time",),
    "geometry_msgs": (
        "Point", "Pose", "PoseArray", "PoseStamped", "Quaternion", "Transform", "TransformStamped", "Vector3",
    ),
    "nav_msgs": ("MapMetaData", "OccupancyGrid", "Path"),
    "std_msgs": ("ColorRGBA", "Header", "String"),
    "tf2_msgs": ("TFMessage",),
    "visualization_msgs": ("Marker", "MarkerArray"),
}  # fmt: skip


def _default(kind: Any) -> Any:
    """The value of a field that nobody sets, as in rclpy."""
    node, of = kind
    if node == Nodetype.NAME:
        return _new(of)()
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(of[0], 0.0 if of[0].startswith("float") else 0)
    element = of[0]
    return np.zeros(0, element[1][0]) if element[0] == Nodetype.BASE and element[1][0] != "string" else []


def _new(name: str) -> Any:
    """A class of messages whose fields have defaults, as in rclpy."""
    constants, fields = STORE.fielddefs[name]

    def message(**given: Any) -> Any:
        assert given.keys() <= {field for field, _ in fields}, given.keys()
        return STORE.types[name](**{field: given.get(field, _default(kind)) for field, kind in fields})

    vars(message).update({constant: value for constant, _, value in constants}, message_type=name)
    return message


MESSAGES = SimpleNamespace(
    **{name: _new(f"{package}/msg/{name}") for package, names in _TYPES.items() for name in names}
)


def copied(message: Any) -> Any:
    """A message after its path through CDR."""
    kind = message.__msgtype__
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, kind), kind)


class LifecycleNode:
    """A node whose topics are attributes. Tests call its callbacks."""

    parameters: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, name: str):
        self.warnings, self.errors, self.published, self.subscribed = [], [], {}, {}
        self.declared, self.services = set(), {}

    def declare_parameter(self, name, default, descriptor):
        assert descriptor.description
        value = self.parameters.get(name, default)
        if type(value) is not type(default):
            raise ParameterException(f"parameter '{name}' is '{value}', expecting type '{type(default).__name__}'")
        self.declared.add(name)
        return SimpleNamespace(value=value)

    def create_publisher(self, kind, topic, qos):
        def publish(message):
            assert message.__msgtype__ == kind.message_type
            self.published[topic] = copied(message)

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind, topic, callback, qos):
        self.subscribed[topic] = callback

    def create_timer(self, period, callback, callback_group):
        self.tick = callback

    def create_service(self, kind, name, callback):
        self.services[name] = lambda **request: callback(SimpleNamespace(**request), SimpleNamespace())

    def _succeeds(self, state):
        return "success"

    on_configure = on_activate = on_deactivate = on_cleanup = on_shutdown = _succeeds

    def __getattr__(self, name):
        if not name.startswith("trigger_"):
            raise AttributeError(name)
        return lambda: getattr(self, name.replace("trigger_", "on_"))(None)

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append, error=self.errors.append)

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: MESSAGES.Time(sec=7, nanosec=8)))


class Future:
    """Something that has not happened yet."""

    def add_done_callback(self, callback):
        self.happens = lambda **result: callback(SimpleNamespace(result=lambda: SimpleNamespace(**result)))


class ActionClient:
    """Keeps the goals that were sent, each with its future."""

    def __init__(self, node, kind, name):
        assert (kind.__name__, name) == ("NavigateToPose", "navigate_to_pose")
        self.goals, self.ready = [], True

    def server_is_ready(self):
        return self.ready

    def send_goal_async(self, goal):
        self.goals.append((copied(goal.pose), Future()))
        return self.goals[-1][1]


class Buffer:
    """Transforms by the frames they are between."""

    def __init__(self):
        self.transforms = {}

    def lookup_transform(self, target, source, time):
        if (target, source) not in self.transforms:
            raise TransformException(f"{source} is not connected to {target}")
        return SimpleNamespace(transform=self.transforms[target, source])


class TransformException(Exception):
    """There is no such transform."""


class ParameterException(Exception):
    """A parameter has another type than its default."""


class ExternalShutdownException(Exception):
    """The context was shut down by a signal."""


class MultiThreadedExecutor:
    """Ends at once."""

    def __init__(self, num_threads):
        pass

    def add_node(self, node):
        self.node = node

    def spin(self):
        pass


class NavigateToPose:
    """The action of Nav2."""

    class Goal:
        """Where to go."""


def python_with_rclpy() -> str:
    """A Python that has the real rclpy: that of DC2G_ROS_PYTHON, or this one. Skips the test if there is none."""
    python = os.environ.get("DC2G_ROS_PYTHON", sys.executable)
    command = [python, "-c", "import rclpy, nav_msgs, std_srvs, visualization_msgs"]
    if subprocess.run(command, capture_output=True).returncode:
        packages = "ros-rclpy ros-nav-msgs ros-std-srvs ros-visualization-msgs ros-rmw-fastrtps-cpp"
        pytest.skip(f"rclpy is not installed; DC2G_ROS_PYTHON may be a Python with {packages} from PyPI")
    return python


def free_domain() -> int:
    """A domain whose first port nobody has."""
    while True:
        domain = random.SystemRandom().randrange(1, 200)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", 7410 + 250 * domain))
            except OSError:
                continue
        return domain


def only_here(domain: int) -> dict[str, str]:
    """The environment of ROS for a domain on this machine."""
    return {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def install(patch) -> None:
    """Let `import rclpy` and the like find what is here."""
    found = {
        "rclpy": {"init": lambda signal_handler_options: None, "try_shutdown": lambda: None},
        "rclpy.callback_groups": {"MutuallyExclusiveCallbackGroup": SimpleNamespace},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
        "rcl_interfaces.msg": {"ParameterDescriptor": SimpleNamespace},
        "std_srvs.srv": {"SetBool": None, "Trigger": None},
        "rclpy.action": {"ActionClient": ActionClient},
        "rclpy.exceptions": {"ParameterException": ParameterException},
        "rclpy.executors": {
            "ExternalShutdownException": ExternalShutdownException,
            "MultiThreadedExecutor": MultiThreadedExecutor,
        },
        "rclpy.lifecycle": {
            "LifecycleNode": LifecycleNode,
            "TransitionCallbackReturn": SimpleNamespace(SUCCESS="success", FAILURE="failure"),
        },
        "rclpy.qos": {
            "QoSProfile": SimpleNamespace,
            "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="transient local"),
        },
        "rclpy.time": {"Time": SimpleNamespace},
        "tf2_ros": {
            "Buffer": Buffer,
            "TransformException": TransformException,
            "TransformListener": lambda buffer, node: None,
        },
        "action_msgs.msg": {"GoalStatus": SimpleNamespace(STATUS_SUCCEEDED=4, STATUS_CANCELED=5, STATUS_ABORTED=6)},
        "nav2_msgs.action": {"NavigateToPose": NavigateToPose},
        **{f"{package}.msg": {name: getattr(MESSAGES, name) for name in names} for package, names in _TYPES.items()},
    }
    for name, contents in found.items():
        module = ModuleType(name)
        vars(module).update(contents)
        patch.setitem(sys.modules, name, module)
        package = name.partition(".")[0]
        if package not in found:
            patch.setitem(sys.modules, package, ModuleType(package))
