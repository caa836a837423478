"""The planner as a DDS participant that exchanges ROS 2 messages. It needs `cyclonedds`, but no ROS."""

import argparse
import os
import signal
import struct
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

try:
    from cyclonedds.core import DDSException, InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
except ImportError:
    sys.exit("error: cyclonedds is not installed in this Python; pip install 'dc2g_jax[dds]'")

from .dds_types import TYPES
from .decider import PARAMETERS, Decided, Decider, planner_options
from .frames import Frames
from .messages import OUTPUTS, Outgoing, is_same, place_to_drive_to
from .planner_process import AnyPlanner, MapPose, PlannerHere, Refused

#: Largest domain number whose UDP ports exist.
_LAST_DOMAIN = 232

#: Compare types by name only: Cyclone DDS cannot read the type information of Fast DDS (vendor 1.15), and that of nodes
#: on Cyclone DDS (1.16) may name members differently.
_SETTINGS = (
    "<CycloneDDS><Domain><Compatibility><IgnoreTypeInformation>1.15,1.16</IgnoreTypeInformation></Compatibility>"
    "</Domain></CycloneDDS>"
)

#: Most messages that are taken from a topic before the others have their turn.
_AT_ONCE = 100

#: Seconds between the reading thread's checks whether to end.
_LOOK_UP = 0.2


def quality_of_service(*, latched: bool, depth: int = 1) -> Qos:
    """Reliable, in CDR (XCDR1), as ROS offers and requests it.

    Args:
      latched: whether subscribers that come later get the last message (transient local in ROS).
      depth: how many messages are kept.
    """
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)),
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.WriterDataLifecycle(autodispose=False),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


class Participant:
    """Reads maps, doors and transforms from DDS, and publishes what the planner decides.

    The outputs are those of the node, with the stamp of the map that was decided on. Nothing that peers send
    ends it: it logs each message that it cannot read, and once each problem that prevents a decision.

    Args:
      domain: number of the DDS domain, `ROS_DOMAIN_ID`.
      given: values of the options: `PARAMETERS`, `map` and `namespace`.
      planner: makes the decisions.
      log: gets the lines of the log.

    Raises:
      Refused: DDS cannot be started.
    """

    def __init__(self, domain: int, given: Mapping[str, Any], planner: AnyPlanner, log: Callable[[str], None] = print):
        self._given, self._planner, self._log = given, planner, log
        self._decider, self._frames = Decider(), Frames()
        self._goal: MapPose | None = None
        self._listeners: set[int] = set()
        self._problem = ""
        try:
            self._dds = DomainParticipant(domain)
            self._open()
        except DDSException as error:
            raise Refused(
                f"DDS does not start on domain {domain}: {error}; check --map, --namespace and CYCLONEDDS_URI"
            ) from None

    def _open(self) -> None:
        """Make readers and writers."""
        given, latched = self._given, quality_of_service(latched=True)
        self._out = {name: self._writer(f"dc2g_planner/{name}", kind, latched) for name, kind in OUTPUTS.items()}
        if given["drive"]:
            self._to_nav2 = self._writer("goal_pose", "PoseStamped", quality_of_service(latched=False))
        # As tf2 does, keep many transforms: each sender publishes different ones.
        self._read = [
            (self._reader(given["map"], "OccupancyGrid", latched), self._decider.see_map),
            (self._reader("doors", "PoseArray", quality_of_service(latched=False)), self._decider.see_doors),
            (self._reader("/tf", "TFMessage", quality_of_service(latched=False, depth=100)), self._frames.see),
            (self._reader("/tf_static", "TFMessage", quality_of_service(latched=True, depth=100)), self._frames.see),
        ]

    def run(self, ended: threading.Event) -> None:
        """Decide whenever anything is new, at most once a period, until `ended` is set."""
        reading = threading.Thread(target=self._listen, args=(ended,))
        reading.start()
        try:
            while not ended.is_set():
                began = time.monotonic()
                self._decide()
                ended.wait(max(0.0, began + self._given["period"] - time.monotonic()))
        finally:
            ended.set()
            reading.join()

    def _topic(self, name: str, kind: str) -> Topic:
        """The DDS topic for a ROS name, which is in the namespace unless it begins with `/`."""
        path = name if name.startswith("/") else f"{self._given['namespace'].strip('/')}/{name}"
        return Topic(self._dds, f"rt/{path.lstrip('/')}", getattr(TYPES, kind))

    def _writer(self, name: str, kind: str, quality: Qos) -> DataWriter:
        return DataWriter(self._dds, self._topic(name, kind), qos=quality)

    def _reader(self, name: str, kind: str, quality: Qos) -> DataReader:
        return DataReader(self._dds, self._topic(name, kind), qos=quality)

    def _listen(self, ended: threading.Event) -> None:
        """Take in what arrives."""
        arrived = WaitSet(self._dds)
        for reader, _ in self._read:
            arrived.attach(ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.NotRead))
        try:
            while not ended.is_set():
                arrived.wait(duration(seconds=_LOOK_UP))
                # Maps are taken first and seen last: a transform that came before a map counts with it.
                batches = [(take_in, self._taken(reader)) for reader, take_in in self._read]
                for take_in, messages in reversed(batches):
                    for message in messages:
                        take_in(message)
        finally:
            ended.set()  # also after an error of DDS: better ended than deaf

    def _taken(self, reader: DataReader) -> list[Any]:
        """The messages that arrived on a topic. They are taken one by one, so that an unreadable one loses no other."""
        messages: list[Any] = []
        for _ in range(_AT_ONCE):
            try:
                taken = reader.take(N=1)
            except (ValueError, IndexError, struct.error) as error:
                self._log(f"warning: a message on {reader.topic.name} cannot be read: {error}")
                continue
            if not taken:
                break
            messages += [message for message in taken if message.sample_info.valid_data]  # others: a sender has gone
        return messages

    def _decide(self) -> None:
        """If anything is new, decide and publish the decision. Log each problem once."""
        try:
            decided = self._decider.decide(self._planner, self._pose_in)
            if decided is None:
                return
            problem = self._tell(decided)
        except Refused as error:
            problem = f"no decision: {error}"
        except (DDSException, IndexError) as error:  # a reader is slow, or has come or gone meanwhile
            self._decider.is_news = True
            problem = f"a decision was not published: {error}"
        if problem and problem != self._problem:
            self._log(f"warning: {problem}")
        self._problem = problem

    def _pose_in(self, frame: str) -> MapPose:
        """The robot's pose."""
        return self._frames.pose(self._given["base_frame"], frame)

    def _tell(self, decided: Decided) -> str:
        """Publish a decision and follow it. Returns what prevents that."""
        header, _, decision = decided
        out = Outgoing(TYPES, header.frame_id, header.stamp)
        for name, message in out.all(decision):
            self._out[name].write(message)
        place = place_to_drive_to(decision)
        if not self._given["drive"] or place is None:
            return ""
        listeners = set(self._to_nav2.get_matched_subscriptions())
        if not listeners:
            self._decider.is_news = True
            return "nobody reads goal_pose; start Nav2"
        if self._goal is None or not is_same(place, self._goal) or listeners - self._listeners:
            self._to_nav2.write(out.stamped(place))
            self._goal, self._listeners = place, listeners
        return ""


def _log(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    """The parameters as options, with the names and defaults of the node."""
    parser = argparse.ArgumentParser(
        "dc2g_planner_dds", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    for name, (default, words) in PARAMETERS.items():
        if isinstance(default, bool):
            parser.add_argument(f"--{name}", action="store_true", help=words)
        elif isinstance(default, list):
            number = "+" if isinstance(default[0], str) else len(default)
            parser.add_argument(f"--{name}", nargs=number, type=type(default[0]), default=default, help=words)
        else:
            parser.add_argument(f"--{name}", type=type(default), default=default, help=words)
    parser.add_argument("--map", default="map", help="topic of the map; /map is in no namespace")
    parser.add_argument("--namespace", default="", help="namespace of the topics, such as robot1")
    return parser


def _domain() -> int:
    """The domain that ROS uses.

    Raises:
      Refused: `ROS_DOMAIN_ID` is not a domain number.
    """
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (given.isdecimal() and int(given) <= _LAST_DOMAIN):
        raise Refused(f"ROS_DOMAIN_ID is {given!r}; give a number from 0 to {_LAST_DOMAIN}")
    return int(given)


def main() -> None:
    """Run the participant until SIGINT or SIGTERM."""
    given = vars(_parser().parse_args())
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    # Settings of the user come later and win.
    os.environ["CYCLONEDDS_URI"] = ",".join(filter(None, (_SETTINGS, os.environ.get("CYCLONEDDS_URI"))))
    try:
        domain = _domain()
        planner = PlannerHere(**planner_options(given))
        participant = Participant(domain, given, planner, _log)
    except Refused as error:
        sys.exit(f"error: {error}")
    _log(f"waits for maps on domain {domain}")
    participant.run(ended)


if __name__ == "__main__":
    main()
