"""The test of the ROS package, run by a Python that has rclpy, with stand-ins for tf2_ros and nav2_msgs."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

PACKAGE = Path(__file__).resolve().parents[2] / "ros2/dc2g_planner"


class Buffer:
    """Transforms by the frames they are between, the same for all."""

    transforms: dict = {}  # noqa: RUF012

    def lookup_transform(self, target, source, time):
        """The transform that was sent."""
        if (target, source) not in self.transforms:
            raise TransformException(f"{source} is not connected to {target}")
        return SimpleNamespace(transform=self.transforms[target, source])


class TransformException(Exception):
    """There is no such transform."""


class StaticTransformBroadcaster:
    """Sends transforms to the buffers of this process."""

    def __init__(self, node):
        pass

    def sendTransform(self, sent):
        """Send a transform."""
        Buffer.transforms[sent.header.frame_id, sent.child_frame_id] = sent.transform


STAND_INS = {
    "tf2_ros": {
        "Buffer": Buffer,
        "StaticTransformBroadcaster": StaticTransformBroadcaster,
        "TransformException": TransformException,
        "TransformListener": lambda buffer, node: None,
    },
    "nav2_msgs": {},
    "nav2_msgs.action": {"NavigateToPose": None},
}

if __name__ == "__main__":
    for name, contents in STAND_INS.items():
        sys.modules[name] = ModuleType(name)
        vars(sys.modules[name]).update(contents)
    sys.path.insert(0, str(PACKAGE))
    runpy.run_path(str(PACKAGE / "test/test_on_ros.py"))["test_a_map_leads_to_a_subgoal"]()
