"""A robot without ROS on DDS, over loopback, and the planner's participant in a process of its own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from dc2g_planner.dds_types import TYPES
from dc2g_planner.messages import OUTPUTS
from dc2g_planner.participant import quality_of_service

from tests.support import ros
from tests.support.places import ROOT

# Only loopback, and no multicast, which loopback may not have. A peer that was killed is missed after two seconds.
os.environ["CYCLONEDDS_URI"] = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='localhost'/></Peers>"
    "<SPDPInterval>200ms</SPDPInterval><LeaseDuration>2s</LeaseDuration></Discovery></Domain></CycloneDDS>"
)

LATCHED, VOLATILE = quality_of_service(latched=True), quality_of_service(latched=False)


def wait_until(condition: Callable[[], Any], what: str, seconds: float = 30.0) -> Any:
    """What a condition gives once it is true."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.001)
    raise AssertionError(f"after {seconds} seconds: {what}")


class Robot:
    """Publishes a map, doors and transforms, and reads what the planner publishes."""

    def __init__(self, domain: int):
        self._dds = DomainParticipant(domain)
        self.map = self.writer("rt/map", "OccupancyGrid", LATCHED)
        self.doors = self.writer("rt/doors", "PoseArray", VOLATILE)
        self.tf = self.writer("rt/tf", "TFMessage", quality_of_service(latched=False, depth=100))
        self.tf_static = self.writer("rt/tf_static", "TFMessage", LATCHED)
        self.outputs = {name: self.reader(f"rt/dc2g_planner/{name}", kind) for name, kind in OUTPUTS.items()}
        self.goal = self.reader("rt/goal_pose", "PoseStamped", VOLATILE)

    def writer(self, topic: str, kind: str, quality=LATCHED) -> DataWriter:
        return DataWriter(self._dds, Topic(self._dds, topic, getattr(TYPES, kind)), qos=quality)

    def reader(self, topic: str, kind: str, quality=LATCHED) -> DataReader:
        return DataReader(self._dds, Topic(self._dds, topic, getattr(TYPES, kind)), qos=quality)

    def await_planner(self) -> None:
        """Wait until the planner hears what this robot says on tf, which keeps nothing for those who come later."""
        for writer in (self.tf, self.doors):
            wait_until(writer.get_matched_subscriptions, "nobody reads tf or doors")

    def answer(self) -> dict[str, Any]:
        """The next decision: one message of each output, and of the subgoal if there is one."""
        found: dict[str, Any] = {}

        def is_complete() -> bool:
            for name in OUTPUTS.keys() - found.keys():
                if messages := taken(self.outputs[name]):
                    (found[name],) = messages
            return found.keys() | {"subgoal"} == OUTPUTS.keys() and bool(found["path"].poses) == ("subgoal" in found)

        wait_until(is_complete, "no decision")
        stamps = {found[name].header.stamp.sec for name in ("path", "frontiers", "subgoal") if name in found}
        assert stamps == {marker.header.stamp.sec for marker in found["markers"].markers}
        return found


def taken(reader: DataReader) -> list[Any]:
    """The messages that arrived, without notices of senders that have gone."""
    return [each for each in reader.take(N=1000) if each.sample_info.valid_data]


def ours(message: Any) -> Any:
    """A message of `tests.support.ros`, or anything in one, as the types of DDS have it."""
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list):
        return [ours(each) for each in message]
    name = getattr(message, "__msgtype__", None)
    if name is None:
        return message
    members = {field: ours(getattr(message, field)) for field, _ in ros.STORE.fielddefs[name][1]}
    return getattr(TYPES, name.rpartition("/")[2])(**members)


def start_planner(domain: int, *options: str, log: Any = subprocess.DEVNULL) -> subprocess.Popen:
    """The participant as its command runs it."""
    places = os.pathsep.join([str(ROOT), str(ROOT / "ros2/dc2g_planner"), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | ros.only_here(domain) | {"PYTHONPATH": places}
    command = [sys.executable, "-m", "dc2g_planner.participant", *options]
    return subprocess.Popen(command, env=environment, stderr=log, text=True)


def end(process: subprocess.Popen, number: int = signal.SIGTERM) -> int:
    """End a process by a signal. Returns its exit status."""
    process.send_signal(number)
    return process.wait(timeout=20)


def start_robot(domain: int, first: int) -> subprocess.Popen:
    """A robot in a process of its own that publishes maps with numbers from `first`, 50 a second."""
    return subprocess.Popen([sys.executable, "-c", _ENDLESS.format(domain=domain, first=first)], cwd=ROOT)


_ENDLESS = """
import itertools, sys, time
sys.path.insert(0, "ros2/dc2g_planner")
from tests.support import dds, ros_maps
robot = dds.Robot({domain})
message = dds.ours(ros_maps.map_message(ros_maps.CORRIDOR))
for message.header.stamp.sec in itertools.count({first}):
    robot.map.write(message)
    time.sleep(0.02)
"""
