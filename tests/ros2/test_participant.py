"""The planner on DDS: bytes and names as in ROS 2, and decisions over the wire, on loopback only."""

import functools
import itertools
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from PIL import Image
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import Writer
from scipy.spatial.transform import Rotation

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install -e '.[dds]'")

from cyclonedds._clayer import ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import Policy
from cyclonedds.util import duration
from dc2g_planner import dds_types, messages, participant
from dc2g_planner.decider import PARAMETERS, Decider, planner_options
from dc2g_planner.frames import Frames
from dc2g_planner.planner_process import MapPose, PlannerHere, Refused

import dc2g_jax
from tests.support import dds, ros
from tests.support.places import ROOT
from tests.support.refusals import refusal_of
from tests.support.ros_maps import CORRIDOR, REACH, YAW, M, in_map, map_message, transform_of

SIZES = {"cell_size": 0.25, "sensing_range": REACH * 0.25, "largest": [18, 18]}
OPTIONS = ["--cell_size", "0.25", "--sensing_range", str(REACH * 0.25), "--largest", "18", "18", "--period", "0.001"]


# --- bytes and names --------------------------------------------------------------------------------------------------


def contents(kind) -> st.SearchStrategy:
    """Values of a field, as rosbags has them."""
    node, of = kind
    if node == Nodetype.NAME:
        return random_message(of)
    if node == Nodetype.SEQUENCE:
        is_number = of[0][0] == Nodetype.BASE
        return st.lists(contents(of[0]), max_size=5).map(
            lambda each: np.array(each, of[0][1][0]) if is_number else each
        )
    if of[0] == "string":
        return st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
    if of[0] == "bool":
        return st.booleans()
    if of[0].startswith("float"):
        return st.floats(width=int(of[0][5:]), allow_nan=False)
    limits = np.iinfo(of[0])
    return st.integers(int(limits.min), int(limits.max))


@functools.cache
def random_message(name: str) -> st.SearchStrategy:
    fields = {field: contents(kind) for field, kind in ros.STORE.fielddefs[name][1]}
    return st.builds(ros.STORE.types[name], **fields)


@pytest.mark.parametrize("name", dds_types._DEFINITIONS)
@settings(max_examples=25)
@given(data=st.data())
def test_the_bytes_of_a_message_are_those_of_ros(name, data):
    """As rosbags, which shares no code with cyclonedds, writes and reads them."""
    package, _, short = name.partition("/")
    kind = f"{package}/msg/{short}"
    message = data.draw(random_message(kind))
    expected = bytes(ros.STORE.serialize_cdr(message, kind))
    own = dds.ours(message)
    assert own.serialize(use_version_2=False) == expected
    assert type(own).deserialize(expected) == own == dds.ours(ros.STORE.deserialize_cdr(expected, kind))


@pytest.fixture
def wire():
    """A robot, and a function that starts the planner in this process; the lines of its log are an attribute."""
    robot, ended, threads = dds.Robot(domain := ros.free_domain()), threading.Event(), []

    def start(planner=None, **given):
        given = vars(participant._parser().parse_args(OPTIONS)) | given
        planner = planner or PlannerHere(**planner_options(given))
        made = participant.Participant(domain, given, planner, start.log.append)
        threads.append(threading.Thread(target=made.run, args=(ended,)))
        threads[-1].start()
        dds.wait_until(robot.tf.get_matched_subscriptions, "nobody reads tf")
        return robot

    start.log = []
    yield start
    ended.set()
    for thread in threads:
        thread.join()


@functools.cache
def corridor():
    return dds.ours(map_message(CORRIDOR))


def numbered(number: int):
    """A map whose stamp is a number."""
    corridor().header.stamp.sec = number
    return corridor()


@functools.cache
def at(column: int, frame: str = "map", child: str = "base_link"):
    """The message of tf for a robot in the corridor."""
    header, place = M.Header(frame_id=frame), transform_of((column, 1, 0), len(CORRIDOR))
    return dds.ours(M.TFMessage(transforms=[M.TransformStamped(header=header, child_frame_id=child, transform=place)]))


def stamped(frame: str, child: str, x: float, y: float, yaw: float):
    turn = M.Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    place = M.Transform(translation=M.Vector3(x=x, y=y, z=0.0), rotation=turn)
    return M.TransformStamped(header=M.Header(frame_id=frame), child_frame_id=child, transform=place)


def discovered(robot) -> dict:
    """The readers and writers of others, by topic."""
    found = {}
    for topic in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription):
        for each in BuiltinDataReader(robot._dds, topic).read(100):
            if each.key.bytes[:12] != robot._dds.guid.bytes[:12]:
                found[each.topic_name] = each
    return found


def test_topics_have_the_names_and_qualities_of_ros(wire):
    """What others discover. An entity of RTPS without a key ends in 03 (writer) or 04 (reader)."""
    robot = wire(drive=True)
    found = discovered(robot)
    depths = {"rt/tf": 100, "rt/tf_static": 100}
    kinds = {"rt/map": "nav_msgs OccupancyGrid", "rt/doors": "geometry_msgs PoseArray"}
    kinds |= {"rt/tf": "tf2_msgs TFMessage", "rt/tf_static": "tf2_msgs TFMessage"}
    kinds |= {"rt/goal_pose": "geometry_msgs PoseStamped", "rt/dc2g_planner/subgoal": "geometry_msgs PoseStamped"}
    kinds |= {"rt/dc2g_planner/frontiers": "geometry_msgs PoseArray", "rt/dc2g_planner/path": "nav_msgs Path"}
    kinds |= {"rt/dc2g_planner/why": "std_msgs String", "rt/dc2g_planner/mode": "std_msgs String"}
    kinds |= {"rt/dc2g_planner/markers": "visualization_msgs MarkerArray"}
    assert {name: each.type_name for name, each in found.items()} == {
        name: "{}::msg::dds_::{}_".format(*kind.split()) for name, kind in kinds.items()
    }
    for name, each in found.items():
        is_volatile = name in ("rt/doors", "rt/tf", "rt/goal_pose")
        durability = Policy.Durability.Volatile if is_volatile else Policy.Durability.TransientLocal
        assert each.qos[Policy.Durability] == durability, name
        assert each.qos[Policy.History] == Policy.History.KeepLast(depths.get(name, 1)), name
        assert isinstance(each.qos[Policy.Reliability], Policy.Reliability.Reliable), name
        assert each.qos[Policy.DataRepresentation] == Policy.DataRepresentation(use_cdrv0_representation=True), name
        assert each.key.bytes[-1] in (3, 4), name


def test_names_in_a_namespace(wire):
    robot = wire(namespace="robot1", map="/semantic")
    names = discovered(robot).keys()
    assert {"rt/semantic", "rt/tf", "rt/tf_static", "rt/robot1/doors", "rt/robot1/dc2g_planner/path"} <= names
    assert not names & {"rt/map", "rt/doors", "rt/robot1/tf"}


# --- decisions --------------------------------------------------------------------------------------------------------


def test_a_decision_is_published_as_by_the_node(wire):
    robot = wire()
    robot.tf_static.write(at(2))
    robot.map.write(numbered(7))
    found, expected = robot.answer(), messages.Outgoing(M, "map", M.Time(sec=7)).all(decision_in_corridor())
    for name, message in expected:
        bytes_of = ros.STORE.serialize_cdr(message, message.__msgtype__)
        assert close(found[name], type(found[name]).deserialize(bytes(bytes_of))), name
    time.sleep(0.1)
    assert [dds.taken(reader) for reader in robot.outputs.values()] == [[]] * 6, "nothing is new"


def decision_in_corridor():
    """What the planner decides at the second column."""
    pose = MapPose(*in_map(2, 1, len(CORRIDOR)), YAW)
    return PlannerHere(**SIZES, field_of_view=90.0).plan(messages.map_of(map_message(CORRIDOR)), pose, [])


def close(one, other) -> bool:
    """Whether two messages are equal, but for rounding."""
    if isinstance(one, float):
        return math.isclose(one, other, abs_tol=1e-6)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(close, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(close(getattr(one, field), getattr(other, field)) for field in one.__dataclass_fields__)
    return one == other


def test_a_problem_is_one_line_and_ends_with_its_cause(wire):
    robot = wire()
    log = wire.log
    robot.map.write(numbered(1))
    dds.wait_until(lambda: log, "no line about tf")
    time.sleep(0.1)
    assert log == ["warning: no decision: base_link is not connected to map; publish transforms between them on tf"]
    robot.tf.write(at(2, child="odom"))
    robot.tf.write(dds.ours(M.TFMessage(transforms=[stamped("odom", "base_link", 0.0, 0.0, 0.0)])))
    assert robot.answer()["path"].header.stamp.sec == 1
    wrong = dds.ours(map_message(CORRIDOR))
    wrong.info.width += 1
    robot.map.write(wrong)
    dds.wait_until(lambda: len(log) > 1, "no line about the map")
    assert "33 cells, but its info says 12 x 3" in log[1]
    robot.doors.write(dds.ours(M.PoseArray(header=M.Header(frame_id="odom"), poses=[M.Pose()])))
    robot.map.write(numbered(2))
    dds.wait_until(lambda: len(log) > 2, "no line about the doors")
    assert "'odom'" in log[2]
    robot.doors.write(dds.ours(M.PoseArray(header=M.Header(frame_id="map"))))
    assert robot.answer()["path"].header.stamp.sec == 2
    text = numbered(3).serialize(use_version_2=False)
    ddspy_write(robot.map._ref, text.replace(b"map\0", b"m\xffp\0"))
    dds.wait_until(lambda: len(log) > 3, "no line about the bytes")
    assert log[3].startswith("warning: a message on rt/map cannot be read: ")
    robot.map.write(numbered(4))
    assert robot.answer()["path"].header.stamp.sec == 4


def test_only_the_newest_of_many_maps_is_planned_on(wire):
    begun, goes_on = threading.Event(), threading.Event()

    class Slow(PlannerHere):
        def plan(self, *arguments):
            begun.set()
            assert goes_on.wait(timeout=30)
            return super().plan(*arguments)

    robot = wire(Slow(**SIZES))
    robot.tf_static.write(at(2))
    time.sleep(0.1)
    robot.map.write(numbered(0))
    assert begun.wait(timeout=30)
    for number in range(1, 100):
        robot.map.write(numbered(number))
    time.sleep(0.3)
    goes_on.set()
    stamps = []
    dds.wait_until(lambda: stamps.extend(taken_stamps(robot)) or 99 in stamps, "no decision on the last map")
    time.sleep(0.1)
    assert [*stamps, *taken_stamps(robot)] == [0, 99]


def taken_stamps(robot) -> list[int]:
    return [message.header.stamp.sec for message in dds.taken(robot.outputs["subgoal"])]


def test_it_drives_only_if_asked_and_to_each_subgoal_once(wire):
    robot, goals = wire(drive=True), []

    def await_goals(number: int) -> None:
        dds.wait_until(lambda: goals.extend(dds.taken(robot.goal)) or len(goals) >= number, f"no goal {number}")

    robot.tf_static.write(at(2))
    for number in range(3):
        robot.map.write(numbered(number))
        subgoal = robot.answer()["subgoal"]
    await_goals(1)
    x, y = in_map(5, 0, len(CORRIDOR))
    door = M.Pose(position=M.Point(x=x, y=y, z=0.0))
    robot.doors.write(dds.ours(M.PoseArray(header=M.Header(frame_id="map"), poses=[door])))
    answer = robot.answer()
    assert answer["mode"].data == "to_goal"
    await_goals(2)
    robot.goal = robot.reader("rt/goal_pose", "PoseStamped", dds.VOLATILE)  # as Nav2, started again
    robot.map.write(numbered(4))
    robot.answer()
    await_goals(3)
    in_front = answer["path"].poses[-2].pose
    assert [goal.pose for goal in goals] == [subgoal.pose, in_front, in_front]
    del robot.goal
    robot.map.write(numbered(5))
    dds.wait_until(lambda: wire.log, "no line about Nav2")
    assert wire.log == ["warning: nobody reads goal_pose; start Nav2"]


@pytest.mark.parametrize(
    ("member", "value"),
    [
        *itertools.product(["info.resolution"], [0.0, -1.0, math.inf, math.nan, 1e-30, 1e30]),
        *itertools.product(["info.origin.position.x", "info.origin.orientation.w"], [math.inf, math.nan, 1e300]),
        *[("data", [-128] * 33), ("data", [127] * 33), ("data", []), ("info.width", 0), ("header.frame_id", "")],
        *itertools.product(["translation.x", "rotation.z"], [math.inf, -math.inf, math.nan]),
        *[("translation.x", 99.0), ("translation.x", 1e300), ("position.x", math.inf), ("position.x", math.nan)],
    ],
)
def test_odd_numbers_are_refused(planner, member, value):
    """In a map, a transform or a door: with one line."""
    decider, frames, seen = Decider(), Frames(), dds.ours(map_message(CORRIDOR))
    transforms = dds.ours(M.TFMessage(transforms=[stamped("map", "base_link", *in_map(2, 1, 3), 0.0)]))
    doors = dds.TYPES.PoseArray(header=seen.header, poses=[dds.TYPES.Pose()])
    for message in (seen, transforms.transforms[0].transform, doors.poses[0]):
        *above, last = member.split(".")
        if hasattr(message, (above or [last])[0]):
            setattr(functools.reduce(getattr, above, message), last, value)
    decider.see_map(seen)
    decider.see_doors(doors)
    frames.see(transforms)
    with pytest.raises(Refused) as caught:
        decider.decide(planner, lambda frame: frames.pose("base_link", frame))
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def planner():
    return PlannerHere(**SIZES)


# --- frames -----------------------------------------------------------------------------------------------------------


def random_transform(random: np.random.Generator):
    (x, y, z), turn = random.normal(size=3), Rotation.random(rng=random)
    parts = dict(zip("xyzw", turn.as_quat().tolist(), strict=True))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), (x, y, z)
    return M.Transform(translation=M.Vector3(x=x, y=y, z=z), rotation=M.Quaternion(**parts)), matrix


def test_poses_in_a_tree_of_frames():
    """Composed by scipy, in both directions, through a common frame above."""
    random, frames, below = np.random.default_rng(0), Frames(), {"map": np.eye(4)}
    for parent, child in (("map", "odom"), ("odom", "base_link"), ("base_link", "camera"), ("map", "other")):
        transform, matrix = random_transform(random)
        below[child] = below[parent] @ matrix
        header = M.Header(frame_id=parent)
        frames.see(
            M.TFMessage(transforms=[M.TransformStamped(header=header, child_frame_id=child, transform=transform)])
        )
    for frame, of in itertools.product(below, repeat=2):
        matrix = np.linalg.inv(below[frame]) @ below[of]
        expected = (*matrix[:2, 3], math.atan2(matrix[1, 0], matrix[0, 0]))
        assert frames.pose(of, frame) == pytest.approx(expected, abs=1e-9), (frame, of)


def test_frames_that_are_not_connected_or_go_round_in_a_circle():
    frames = Frames()
    refusal_of(Refused, lambda: frames.pose("base_link", "map"), "base_link is not connected to map")
    for frame, child in (("map", "odom"), ("odom", "map"), ("base_link", "base_link")):
        frames.see(M.TFMessage(transforms=[stamped(frame, child, 0.0, 0.0, 0.0)]))
    assert frames.pose("map", "odom") == (0.0, 0.0, 0.0)
    refusal_of(Refused, lambda: frames.pose("base_link", "map"), "base_link is not connected to map")


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("domain", "options", "error"),
    [
        ("233", [], r"error: ROS_DOMAIN_ID is '233'; give a number from 0 to 232"),
        ("here", [], r"error: ROS_DOMAIN_ID is 'here'; give a number from 0 to 232"),
        ("1", ["--planner", "nobody"], r"error: .*'nobody'"),
        ("1", ["--labels", "road"], r"error: labels: 'road'; write VALUE:CLASS"),
    ],
)
def test_what_the_command_refuses_is_one_line(monkeypatch, domain, options, error):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    monkeypatch.setattr(sys, "argv", ["dc2g_planner_dds", *options])
    monkeypatch.setattr(participant.signal, "signal", lambda number, handler: None)
    with pytest.raises(SystemExit, match=f"^{error}") as caught:
        participant.main()
    assert "\n" not in str(caught.value)


def test_options_are_the_parameters_of_the_node():
    given = vars(participant._parser().parse_args([]))
    assert given.items() >= {name: default for name, (default, _) in PARAMETERS.items()}.items()
    assert given.keys() - PARAMETERS.keys() == {"map", "namespace"}
    assert participant._parser().parse_args(["--labels", "1:road", "2:house"]).labels == ["1:road", "2:house"]
    assert "dc2g_planner_dds = " in (ROOT / "ros2/dc2g_planner/setup.py").read_text().replace("{NAME}", "dc2g_planner")


# --- two processes ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_ten_thousand_updates():
    """Between two processes, 5,000 poses and 5,000 maps go in, and each map's decision comes out before the next.

    Proven: every map sent is decided on, once and in order, and its path, frontiers and markers carry its number. A
    pose that was acknowledged before a map is the pose in its decision, which is checked for every 250th. (Before that,
    DDS promises no order between topics.) Of maps sent in a burst, the newest is decided on last, and nothing follows.
    """
    domain = ros.free_domain()
    planner, robot = dds.start_planner(domain, *OPTIONS), dds.Robot(domain)
    try:
        robot.await_planner()
        for number in range(5_000):
            column = 2 + number % 3
            robot.tf.write(at(column))
            if number % 250 == 0:
                assert robot.tf.wait_for_acks(duration(seconds=10))
            robot.map.write(numbered(number))
            answer = robot.answer()
            assert answer["path"].header.stamp.sec == number
            if number % 250 == 0:
                here = answer["path"].poses[0].pose.position
                assert (here.x, here.y) == pytest.approx(in_map(column, 1, 3))
        stamps = []
        for number in range(5_000, 5_200):
            robot.map.write(numbered(number))
            stamps += taken_stamps(robot)
        dds.wait_until(lambda: stamps.extend(taken_stamps(robot)) or 5_199 in stamps, "no decision on the last map")
        time.sleep(0.3)
        stamps += taken_stamps(robot)
        assert stamps == sorted(set(stamps))
        assert stamps[-1] == 5_199
        assert dds.end(planner) == 0
    finally:
        planner.kill()
        planner.wait()


@pytest.mark.slow
def test_peers_that_are_killed_and_come_back(tmp_path):
    """Either side is killed and started again; whoever comes later gets the latest map and the latest decision."""
    domain = ros.free_domain()
    robot = dds.Robot(domain)
    robot.tf_static.write(at(2))
    for number in range(3):
        robot.map.write(numbered(number))
    planners, robots = [dds.start_planner(domain, *OPTIONS)], []
    try:
        answer = robot.answer()
        assert answer["path"].header.stamp.sec == 2, "the planner came later than the maps"
        late = dds.Robot(domain)
        assert late.answer() == answer, "the other robot came later than the decision"
        dds.end(planners[0], signal.SIGKILL)
        robot.map.write(numbered(3))
        planners.append(dds.start_planner(domain, *OPTIONS))
        assert robot.answer()["path"].header.stamp.sec == 3
        for start in (1000, 2000):
            robots.append(dds.start_robot(domain, start))
            dds.wait_until(lambda start=start: max(taken_stamps(robot), default=0) > start + 5, f"none from {start}")
            dds.end(robots[-1], signal.SIGKILL)
        time.sleep(0.5)
        taken_stamps(robot)
        robot.map.write(numbered(4))
        dds.wait_until(lambda: taken_stamps(robot) == [4], "none on the map of the robot that is left")
        assert dds.end(planners[1], signal.SIGINT) == 0
    finally:
        for each in (*planners, *robots):
            each.kill()
            each.wait()


@pytest.mark.slow
def test_a_node_of_ros_gets_the_decisions():
    """A robot in rclpy, with the DDS of ROS, publishes 500 maps, each after the answer to the one before.

    Transforms come from a robot without ROS.
    """
    python = ros.python_with_rclpy()
    domain, corridor = ros.free_domain(), map_message(CORRIDOR)
    origin = corridor.info.origin
    given = {"cells": corridor.data.tolist(), "shape": CORRIDOR.shape, "resolution": corridor.info.resolution}
    given |= {"origin": (origin.position.x, origin.position.y), "maps": 500}
    given |= {"turn": (origin.orientation.z, origin.orientation.w)}
    robot, planner = dds.Robot(domain), dds.start_planner(domain, *OPTIONS, "--drive")
    robot.tf_static.write(at(2))
    try:
        robot.await_planner()
        node = subprocess.run(
            [python, str(ROOT / "tests/support/ros_node.py")],
            input=json.dumps(given),
            env=os.environ | ros.only_here(domain),
            stdout=subprocess.PIPE,
            text=True,
            timeout=100,
            check=True,
        )
        assert dds.end(planner) == 0
    finally:
        planner.kill()
        planner.wait()
    answer, decision = json.loads(node.stdout), decision_in_corridor()
    assert (answer["why"], answer["mode"], answer["markers"][1:]) == (decision.why, decision.mode, [6, 0, 9])
    assert decision.subgoal is not None
    places = {"path": decision.path, "frontiers": decision.candidates, "subgoal": [decision.subgoal]}
    for name, poses in (places | {"goals": [decision.subgoal]}).items():
        np.testing.assert_allclose(answer[name], [pose[:2] for pose in poses], atol=1e-6, err_msg=name)


def drive_in(room: np.ndarray, resolution: float, start: tuple[float, float], steps: int):
    """The maps that a robot with a lidar of 3 m publishes, and its poses, while it follows the planner.

    The room has rows from the lowest: 0 free, 100 occupied, -1 unknown.
    """
    planner = dc2g_jax.MetricPlanner(cell_size=0.25, sensing_range=3.0, largest=(70, 130))
    angles, lengths = np.linspace(0, math.tau, 720)[:, None], np.arange(0, 3.0, resolution / 2)
    seen, (x, y, yaw) = np.full(room.shape, -1, np.int8), (*start, 0.0)
    for _ in range(steps):
        columns = ((x + lengths * np.cos(angles)) // resolution).astype(int).clip(0, room.shape[1] - 1)
        rows = ((y + lengths * np.sin(angles)) // resolution).astype(int).clip(0, room.shape[0] - 1)
        hits = np.cumsum(room[rows, columns] != 0, axis=1)
        is_seen = (hits == 0) | ((hits == 1) & (room[rows, columns] != 0))
        seen[rows[is_seen], columns[is_seen]] = room[rows[is_seen], columns[is_seen]]
        yield seen.copy(), (x, y, yaw)
        grid = dc2g_jax.MetricMap(seen, resolution, dc2g_jax.grid.MapFrame(0.0, 0.0, 0.0))
        path = planner.plan(grid, (x, y, yaw)).path
        x, y, yaw = path[min(6, len(path) - 1)] if path else (x, y, yaw)


@pytest.mark.slow
def test_a_bag_over_the_wire_leads_to_the_decisions_of_the_planner(tmp_path, shared_files):
    """A drive through a real map, in maps and two transforms, of which only their product is the robot's pose."""
    (file,) = shared_files("datasets/ros_maps", "depot.pgm")
    image = np.asarray(Image.open(file))[::-1]
    room = np.select([image == 254, image == 0], [0, 100], -1).astype(np.int8)
    kinds = {"/map": "nav_msgs/msg/OccupancyGrid", "/tf": "tf2_msgs/msg/TFMessage"}
    with Writer(tmp_path / "bag", version=9) as bag:
        topics = {name: bag.add_connection(name, kind, typestore=ros.STORE) for name, kind in kinds.items()}
        for number, (seen, (x, y, yaw)) in enumerate(drive_in(room, 0.05, (13.15, 2.9), 25)):
            info = M.MapMetaData(resolution=0.05, width=room.shape[1], height=room.shape[0])
            header = M.Header(stamp=M.Time(sec=number), frame_id="map")
            transforms = [stamped("map", "odom", 1.0, 2.0, 0.0), stamped("odom", "base_link", x - 1.0, y - 2.0, yaw)]
            message = M.OccupancyGrid(header=header, info=info, data=seen.ravel())
            for name, each in (("/tf", M.TFMessage(transforms=transforms)), ("/map", message)):
                bag.write(topics[name], number, ros.STORE.serialize_cdr(each, kinds[name]))
    domain, offline = ros.free_domain(), dc2g_jax.MetricPlanner(cell_size=0.25, sensing_range=3.0, largest=(70, 130))
    planner, robot, modes = (
        dds.start_planner(domain, "--period", "0.001", "--largest", "70", "130"),
        dds.Robot(domain),
        [],
    )
    try:
        robot.await_planner()
        with AnyReader([tmp_path / "bag"], default_typestore=ros.STORE) as bag:
            for connection, number, data in bag.messages():
                if connection.topic == "/tf":
                    robot.tf.write(dds.TYPES.TFMessage.deserialize(data))
                    assert robot.tf.wait_for_acks(duration(seconds=10))
                    at_odom = bag.deserialize(data, connection.msgtype).transforms[1].transform
                    pose = at_odom.translation.x + 1.0, at_odom.translation.y + 2.0, messages.yaw_of(at_odom.rotation)
                    continue
                robot.map.write(dds.TYPES.OccupancyGrid.deserialize(data))
                message = bag.deserialize(data, connection.msgtype)
                cells = message.data.reshape(message.info.height, message.info.width)
                grid = dc2g_jax.MetricMap(cells, message.info.resolution, dc2g_jax.grid.MapFrame(0.0, 0.0, 0.0))
                expected, answer = offline.plan(grid, pose), robot.answer()
                assert answer["path"].header.stamp.sec == number
                assert (answer["why"].data, answer["mode"].data) == (expected.why, expected.mode)
                candidates = [candidate.pose for candidate in expected.candidates]
                for found, poses in (
                    ([each.pose for each in answer["path"].poses], expected.path),
                    (answer["frontiers"].poses, candidates),
                ):
                    each = [(pose.position.x, pose.position.y, messages.yaw_of(pose.orientation)) for pose in found]
                    np.testing.assert_allclose(each, np.reshape(poses, (-1, 3)), atol=1e-9)
                modes.append(expected.mode)
        assert modes.count("explore") > 20
        assert dds.end(planner) == 0
    finally:
        planner.kill()
        planner.wait()
