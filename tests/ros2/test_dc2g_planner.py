"""The node of ROS 2: real messages as CDR and in a bag, and its callbacks with a stand-in for rclpy."""

import ast
import functools
import importlib
import math
import os
import re
import runpy
import subprocess
import sys
import threading
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from dc2g_planner import messages, planner_process
from dc2g_planner.decider import PARAMETERS
from dc2g_planner.planner_process import Decision, MapPose, Refused
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer

from dc2g_jax._src.planning.online import OnlinePlanner
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps, ros
from tests.support.places import ROOT
from tests.support.refusals import refusal_of
from tests.support.ros_maps import CORRIDOR, HOUSE, REACH, ROAD, YAW, M, in_map, map_message, transform_of


class InProcess(planner_process.PlannerHere):
    """The planner of the node without a process of its own, which would take seconds to start."""

    def __init__(self, python: str, **options):
        super().__init__(**options)

    def close(self):
        pass


def run(seed: int, steps: int = 12):
    """What a robot on frontier exploration observes, step by step, and its poses."""
    terrain = maps.random_terrain(seed, (14, 18), 0.75, doors=0)
    pose = maps.random_pose(seed, np.isin(terrain, oracle.TRAVERSABLE_CLASSES))
    seen = np.zeros(terrain.shape, bool)
    for action in np.random.default_rng(seed).integers(3, size=steps).tolist():
        seen |= oracle.visible(pose, REACH, terrain.shape)
        yield np.where(seen, terrain, 0), pose
        after = oracle.moved(pose, action, terrain.shape)
        if terrain[after[1], after[0]] in oracle.TRAVERSABLE_CLASSES:
            pose = after


def test_a_bag_leads_to_the_subgoals_of_the_planner_in_cells(tmp_path):
    with Writer(tmp_path / "bag", version=9) as bag:
        topics = {
            name: bag.add_connection(name, kind, typestore=ros.STORE)
            for name, kind in (("/map", "nav_msgs/msg/OccupancyGrid"), ("/tf", "tf2_msgs/msg/TFMessage"))
        }
        walks = [moment for seed in range(3) for moment in run(seed)]
        for time, (terrain, pose) in enumerate(walks):
            header = M.Header(frame_id="map")
            robot = M.TransformStamped(
                header=header, child_frame_id="base_link", transform=transform_of(pose, len(terrain))
            )
            for name, message in (("/tf", M.TFMessage(transforms=[robot])), ("/map", map_message(terrain))):
                bag.write(topics[name], time, ros.STORE.serialize_cdr(message, message.__msgtype__))
    in_cells = OnlinePlanner("frontier", sensing_range=REACH, largest=(18, 18), open_ended=True, settings="occluded")
    explored = 0
    with AnyReader([tmp_path / "bag"], default_typestore=ros.STORE) as bag:
        robot, moments = None, iter(walks)
        for connection, _, data in bag.messages():
            message = bag.deserialize(data, connection.msgtype)
            if connection.topic == "/tf":
                robot = messages.pose_of(message.transforms[0].transform)
                continue
            terrain, pose = next(moments)
            online = InProcess("", planner="frontier", cell_size=0.25, sensing_range=REACH * 0.25, largest=(18, 18))
            decision = online.plan(messages.map_of(message), robot, [])
            grid = np.where(np.isin(terrain, (0, *oracle.TRAVERSABLE_CLASSES)), np.where(terrain, ROAD, 0), HOUSE)
            wanted = in_cells.plan(grid.astype(np.uint8), pose)
            explored += wanted.mode == "explore"
            assert decision.mode == wanted.mode
            frontiers = ros.copied(messages.Outgoing(M, "map", M.Time()).frontiers(decision))
            found = [(pose.position.x, pose.position.y, messages.yaw_of(pose.orientation)) for pose in frontiers.poses]
            expected = [
                (*in_map(each.x, each.y, len(terrain)), math.remainder(YAW - each.heading * math.pi / 2, math.tau))
                for each in wanted.candidates
            ]
            np.testing.assert_allclose(found, expected, atol=1e-6)
            if wanted.subgoal:
                assert decision.subgoal == pytest.approx(found[0] if found else decision.subgoal, abs=1e-6)
    assert next(moments, None) is None
    assert explored > 20


# --- messages in and out ----------------------------------------------------------------------------------------------


def test_what_a_message_says_that_cannot_be():
    message = map_message(np.full((3, 4), ROAD))
    message.info.width = 5
    refusal = functools.partial(refusal_of, Refused)
    refusal(lambda: messages.map_of(message), "12 cells", "5 x 3")
    doors = M.PoseArray(header=M.Header(frame_id="odom"), poses=[M.Pose()])
    refusal(lambda: messages.doors_of(doors, "map"), "'odom'", "'map'")
    for line in ("road", "x:road", "-1:road", ":road"):
        refusal(lambda line=line: messages.labels_of([line]), line, "VALUE:CLASS")


def test_labels():
    assert messages.labels_of([""]) is None
    assert messages.labels_of(["1:road", "12: garage door"]) == {1: "road", 12: "garage door"}


# --- the node ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def start(monkeypatch):
    """Start a node with parameters."""
    ros.install(monkeypatch)
    monkeypatch.delitem(sys.modules, "dc2g_planner.node", raising=False)
    node = importlib.import_module("dc2g_planner.node")
    monkeypatch.setattr(node, "PlannerProcess", InProcess)

    def started(**parameters):
        shared = {"planner": "frontier", "cell_size": 0.25, "sensing_range": REACH * 0.25, "largest": [18, 18]}
        monkeypatch.setattr(ros.LifecycleNode, "parameters", {**shared, **parameters})
        made = node.PlannerNode()
        made.trigger_configure()
        made.trigger_activate()
        return made

    return started


def at(node, pose, terrain=CORRIDOR) -> None:
    """The robot is at a pose and publishes a map; the node's timer ticks."""
    node._tf.transforms["map", "base_link"] = transform_of(pose, len(terrain))
    node.subscribed["map"](ros.copied(map_message(terrain)))
    node.tick()


def answered(node, number: int, status: int) -> None:
    """Nav2 accepts a goal and ends it."""
    result = ros.Future()
    node._nav2.goals[number][1].happens(accepted=True, get_result_async=lambda: result)
    result.happens(status=status)


def test_a_decision_is_published(start):
    node = start()
    node.tick()
    node.subscribed["map"](map_message(CORRIDOR))
    node.tick()
    assert node.published == {}
    assert node.warnings == ["no decision: base_link is not connected to map"]
    at(node, (2, 1, 0))
    subgoal, path, frontiers, markers, why, mode = (
        node.published[f"~/{name}"] for name in ("subgoal", "path", "frontiers", "markers", "why", "mode")
    )
    x, y = in_map(6, 1, 3)
    assert (subgoal.pose.position.x, subgoal.pose.position.y) == pytest.approx((x, y))
    assert messages.yaw_of(subgoal.pose.orientation) == pytest.approx(YAW)
    assert (subgoal.header.frame_id, subgoal.header.stamp.sec) == ("map", 7)
    assert path.poses[-1].pose == subgoal.pose == frontiers.poses[0]
    assert len(path.poses) == 5
    assert [marker.type for marker in markers.markers[1:]] == [6, 0, 9]
    assert len(markers.markers[1].points) == len(markers.markers[1].colors) == len(frontiers.poses)
    assert why.data == markers.markers[3].text
    assert mode.data == "explore"
    assert why.data.startswith(f"explore: ({x:.2f}, {y:.2f}) m facing 30 degrees is the nearest")
    node.published.clear()
    node.tick()
    assert node.published == {}, "nothing is new"


def test_the_file_of_parameters_has_those_of_the_node(start):
    text = (ROOT / "ros2/dc2g_planner/config/dc2g_planner.yaml").read_text()
    parameters = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert parameters.pop("use_sim_time") is False  # every node has it
    node = start(**parameters)
    assert node.declared == parameters.keys()
    assert {name: parameters[name] for name in PARAMETERS} == {
        name: default for name, (default, _) in PARAMETERS.items()
    }
    table = (ROOT / "docs/tutorials/on_a_ros2_robot.md").read_text()
    assert [name for name in node.declared if f"| `{name}` |" not in table] == []


def launched(monkeypatch, **given) -> tuple[dict, set]:
    """How the launch file starts the node, and its arguments. Lists stand in for the classes of `launch`."""
    arguments = {}

    def declare(name, default_value, choices=(), description=""):
        arguments[name] = given.get(name, default_value)
        assert not choices or arguments[name] in choices

    stand_ins = {
        "ament_index_python.packages": {"get_package_share_directory": lambda name: f"/share/{name}"},
        "launch": {"LaunchContext": dict, "LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": declare, "OpaqueFunction": lambda function: function},
        "launch.substitutions": {"LaunchConfiguration": lambda name: SimpleNamespace(perform=lambda at: at[name])},
        "launch_ros.actions": {"Node": dict},
    }
    for name, contents in stand_ins.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("ament_index_python", "launch_ros"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    file = runpy.run_path(str(ROOT / "ros2/dc2g_planner/launch/dc2g_planner.launch.py"))
    nodes = file["generate_launch_description"]()[-1]
    (node,) = nodes(arguments)
    return node, arguments.keys()


def test_arguments_of_the_launch_file(monkeypatch):
    node, arguments = launched(monkeypatch)
    file = "/share/dc2g_planner/config/dc2g_planner.yaml"
    assert (node["parameters"], node["remappings"], node["namespace"]) == ([file], [("map", "map")], "")
    node, _ = launched(monkeypatch, drive="true", python="/py", map="/semantic", namespace="r", params_file="p")
    assert node["parameters"] == ["p", {"drive": True, "python": "/py"}]
    assert (node["remappings"], node["namespace"]) == ([("map", "/semantic")], "r")
    page = (ROOT / "docs/tutorials/on_a_ros2_robot.md").read_text()
    assert [name for name in arguments if f"`{name}:=" not in page] == []


def test_the_package_declares_what_it_imports():
    folder = ROOT / "ros2/dc2g_planner"
    code = "".join(path.read_text() for path in folder.rglob("*.py") if path.name != "setup.py")
    from_pip = {"dc2g_jax", "cyclonedds"}
    imported = set(re.findall(r"^(?:from|import) (\w+)", code, flags=re.M)) - sys.stdlib_module_names - from_pip
    packages = {"numpy": "python3-numpy", "tf2_ros": "tf2_ros_py"}
    declared = {each.text for each in ElementTree.parse(folder / "package.xml").iter() if "_depend" in each.tag}
    assert {packages.get(name, name) for name in imported - {"dc2g_planner"}} == declared - {"python3-pytest"}


def test_doors_count_in_the_frame_of_the_map(start):
    node = start()
    x, y = in_map(5, 0, 3)
    door = M.Pose(position=M.Point(x=x, y=y, z=0.0))
    node.subscribed["doors"](M.PoseArray(header=M.Header(frame_id="odom"), poses=[door]))
    at(node, (2, 1, 0))
    assert "'odom'" in node.warnings[0]
    node.subscribed["doors"](M.PoseArray(header=M.Header(frame_id="map"), poses=[door]))
    node.tick()
    assert node.published["~/why"].data.startswith(f"to goal: the door at ({x:.2f}, {y:.2f}) m is reachable in 5")
    assert node.published["~/frontiers"].poses == []
    assert node.published["~/mode"].data == "to_goal"


def test_it_drives_only_if_asked(start):
    assert start()._nav2 is None
    node = start(drive=True)
    node._nav2.ready = False
    at(node, (2, 1, 0))
    assert node._nav2.goals == []
    node._nav2.ready = True
    node.tick()
    at(node, (3, 1, 0))
    ((goal, _),) = node._nav2.goals
    assert goal.pose == node.published["~/subgoal"].pose
    answered(node, 0, status=4)
    at(node, (6, 1, 0))
    assert len(node._nav2.goals) == 2


def test_a_subgoal_out_of_reach_is_set_aside(start):
    node = start(drive=True)
    at(node, (2, 1, 0))
    answered(node, 0, status=6)
    at(node, (2, 1, 0))
    answered(node, 1, status=6)
    assert node.warnings[1].startswith("Nav2 cannot reach (")
    node.tick()
    assert node.published["~/mode"].data == "gave_up"
    assert node.published["~/why"].data.startswith("gave up")
    assert node.published["~/path"].poses == []
    assert [marker.action for marker in node.published["~/markers"].markers] == [3]
    assert len(node._nav2.goals) == 2


def test_a_subgoal_that_nav2_stops_short_of_is_set_aside(start):
    node = start(drive=True)
    at(node, (2, 1, 0))
    answered(node, 0, status=4)
    at(node, (4, 1, 0))
    assert node.warnings[-1].startswith("Nav2 has arrived, by its tolerance, but the planner still goes to (")
    node.tick()
    assert node.published["~/mode"].data == "gave_up"
    assert len(node._nav2.goals) == 1


@pytest.mark.parametrize("status", [0, 5, 6])
def test_a_subgoal_that_nav2_ends_is_sent_again_with_the_next_map(start, status):
    """Nav2 aborts (6) a goal for someone else's, cancels (5) it, or does not say (0)."""
    node = start(drive=True)
    at(node, (2, 1, 0))
    answered(node, 0, status)
    node.tick()
    x, y = in_map(6, 1, 3)
    assert node.warnings == [f"Nav2 ended short of ({x:.2f}, {y:.2f}) m with status {status}; the next map decides"]
    assert len(node._nav2.goals) == 1
    at(node, (4, 1, 0))
    assert [goal.pose for goal, _ in node._nav2.goals] == [node.published["~/subgoal"].pose] * 2


def test_only_aborts_count_as_out_of_reach(start):
    node = start(drive=True)
    for number, status in enumerate((5, 0, 6, 5)):
        at(node, (2, 1, 0))
        answered(node, number, status)
    at(node, (2, 1, 0))
    assert node.published["~/mode"].data == "explore"
    assert len(node._nav2.goals) == 5


@pytest.mark.parametrize(("status", "warning"), [(4, "Nav2 has arrived"), (6, "Nav2 ended short of")])
def test_the_way_to_a_door_is_tried_again(start, status, warning):
    node = start(drive=True)
    x, y = in_map(7, 1, 3)
    door = M.Pose(position=M.Point(x=x, y=y, z=0.0))
    node.subscribed["doors"](M.PoseArray(header=M.Header(frame_id="map"), poses=[door]))
    at(node, (2, 1, 0))
    answered(node, 0, status)
    node.tick()
    assert node.warnings[0].startswith(warning)
    at(node, (2, 1, 0))
    assert [goal.pose for goal, _ in node._nav2.goals] == [node._nav2.goals[0][0].pose] * 2


def test_a_parameter_of_another_type_is_one_line(start, monkeypatch):
    main = sys.modules["dc2g_planner.node"].main
    monkeypatch.setattr(ros.LifecycleNode, "parameters", {"sensing_range": 3})
    with pytest.raises(SystemExit, match=r"^error: parameter 'sensing_range' is '3', expecting type 'float'$"):
        main()


@pytest.mark.parametrize("error", [ros.ExternalShutdownException, KeyboardInterrupt])
def test_a_signal_cancels_the_goal_and_ends_the_node_without_a_trace(start, monkeypatch, error):
    start(drive=True)
    node, calls = sys.modules["dc2g_planner.node"], []

    def spin(executor):
        at(executor.node, (2, 1, 0))
        accepted(executor.node, 0, calls)
        raise error

    monkeypatch.setattr(ros.MultiThreadedExecutor, "spin", spin)
    monkeypatch.setattr(node.signal, "signal", lambda number, handler: None)

    def wait(node, future, timeout_sec):
        calls.append((future, timeout_sec))

    monkeypatch.setattr(node.rclpy, "spin_until_future_complete", wait, raising=False)
    monkeypatch.setattr(node.rclpy, "try_shutdown", lambda: calls.append("shutdown"))
    node.main()
    assert calls == ["cancel 0", ("cancel 0", 1.0), "shutdown"]


def accepted(node, number: int, calls: list) -> ros.Future:
    """Nav2 accepts a goal, and notes where it is canceled."""
    result = ros.Future()

    def cancel() -> str:
        calls.append(f"cancel {number}")
        return calls[-1]

    node._nav2.goals[number][1].happens(accepted=True, get_result_async=lambda: result, cancel_goal_async=cancel)
    return result


def test_it_decides_only_while_it_is_active(start):
    node, calls = start(drive=True), []
    at(node, (2, 1, 0))
    accepted(node, 0, calls)
    node.trigger_deactivate()
    assert calls == ["cancel 0"]
    assert node.services["~/return_to_start"]().message == "the node is not active"
    at(node, (3, 1, 0))
    node.services["~/pause"](data=False)  # pausing and resuming does not activate
    node.tick()
    assert len(node._nav2.goals) == 1
    node.trigger_activate()
    node.tick()
    assert len(node._nav2.goals) == 2
    node.trigger_deactivate()
    node.trigger_cleanup()
    node.trigger_activate()
    node.tick()
    assert (node._planner, node.warnings) == (None, [])


def test_what_comes_while_it_decides_waits_for_nobody(start, monkeypatch):
    node, plan = start(drive=True), InProcess.plan

    def paused(self, *arguments):
        pausing = threading.Thread(target=lambda: node.services["~/pause"](data=True))
        pausing.start()
        pausing.join(timeout=20)
        assert not pausing.is_alive()
        return plan(self, *arguments)

    monkeypatch.setattr(InProcess, "plan", paused)
    at(node, (2, 1, 0))
    assert (node.published, node._nav2.goals) == ({}, [])


def test_a_parameter_that_the_planner_refuses_is_logged(start, monkeypatch):
    node = start(planner="nobody")
    assert "'nobody'" in node.errors[0]
    assert node._planner is None
    monkeypatch.setattr(ros.LifecycleNode, "parameters", {"planner": "nobody"})
    with pytest.raises(SystemExit, match=r"^error: the node cannot start; its log says why$"):
        sys.modules["dc2g_planner.node"].main()


@pytest.mark.slow
def test_the_planner_in_a_process_of_its_own():
    options = {"cell_size": 0.25, "sensing_range": REACH * 0.25, "largest": (18, 18)}
    refusal = functools.partial(refusal_of, Refused)
    refusal(lambda: planner_process.PlannerProcess("/no/python"), "/no/python", "cannot be started")
    refusal(lambda: planner_process.PlannerProcess("", **options, planner="nobody"), "'nobody'")
    alone, here = planner_process.PlannerProcess("", **options), InProcess("", **options)
    seen, robot = messages.map_of(map_message(CORRIDOR)), MapPose(*in_map(2, 1, 3), YAW)
    for _ in range(2):
        found, expected = (planner.plan(seen, robot, []) for planner in (alone, here))
        assert found == expected
        if found.subgoal:
            alone.set_aside(found.subgoal)
            here.set_aside(found.subgoal)
    assert (type(found), found.mode) == (Decision, "gave_up")
    refusal(lambda: alone.plan(seen, MapPose(99.0, 99.0, 0.0), []), "off the map")
    alone.close()
    refusal(lambda: alone.plan(seen, robot, []), "has ended")


@pytest.mark.slow
def test_the_test_of_the_package_passes_on_rclpy():
    """With stand-ins for tf2_ros and nav2_msgs only: parameters, states, topics and the helper process are real."""
    command = [ros.python_with_rclpy(), str(ROOT / "tests/support/ros_package_test.py")]
    planner = {"DC2G_PYTHON": sys.executable, "PYTHONPATH": str(ROOT)}
    environment = os.environ | ros.only_here(ros.free_domain()) | planner
    subprocess.run(command, env=environment, timeout=100, check=True)


def test_the_node_runs_in_the_python_of_ros():
    """Python 3.10 of ROS 2 Humble compiles its files, which import no `dc2g_jax` outside the planner's process."""
    for path in (ROOT / "ros2/dc2g_planner/dc2g_planner").glob("*.py"):
        ast.parse(path.read_text(), feature_version=(3, 10))
        assert re.findall(r"^(?:from|import) dc2g_jax", path.read_text(), flags=re.M) == [], path.name


def test_a_pause_stops_the_robot_until_it_is_resumed(start):
    node, calls = start(drive=True), []
    at(node, (2, 1, 0))
    result = accepted(node, 0, calls)
    assert node.services["~/pause"](data=True).success
    assert calls == ["cancel 0"]
    result.happens(status=5)  # canceled, as asked: no warning
    at(node, (3, 1, 0))
    assert (len(node._nav2.goals), node.warnings) == (1, [])
    node.services["~/pause"](data=False)
    node.tick()
    assert len(node._nav2.goals) == 2
    # Nav2 answers after the pause.
    node.services["~/pause"](data=True)
    accepted(node, 1, calls)
    assert calls == ["cancel 0", "cancel 1"]


def test_the_robot_returns_to_where_it_began(start):
    node, calls = start(drive=True), []
    assert node.services["~/return_to_start"]().message == "no decision has been made yet"
    at(node, (2, 1, 0))
    accepted(node, 0, calls)
    at(node, (4, 1, 0))
    assert node.services["~/return_to_start"]().success
    place = node._nav2.goals[-1][0].pose.position
    assert (place.x, place.y) == pytest.approx(in_map(2, 1, len(CORRIDOR)))
    count, result = len(node._nav2.goals), accepted(node, len(node._nav2.goals) - 1, calls)
    result.happens(status=4)
    at(node, (2, 1, 0))  # there, and it stays
    assert len(node._nav2.goals) == count
    watching = start()
    at(watching, (2, 1, 0))
    assert watching.services["~/return_to_start"]().message == "the parameter drive is false"


def test_the_display_of_rviz_shows_topics_of_the_node(start):
    shown = yaml.safe_load((ROOT / "ros2/dc2g_planner/config/dc2g_planner.rviz").read_text())
    topics = {each["Topic"]["Value"] for each in shown["Visualization Manager"]["Displays"] if "Topic" in each}
    node = start()
    at(node, (2, 1, 0))
    assert topics == {"/map", *(f"/dc2g_planner/{name}" for name in ("markers", "path", "frontiers"))}
    assert {name for name in topics if name != "/map"} <= {
        name.replace("~", "/dc2g_planner") for name in node.published
    }
    assert "config/{NAME}.rviz" in (ROOT / "ros2/dc2g_planner/setup.py").read_text()


def test_a_rejected_subgoal_is_sent_again_and_an_old_one_forgotten(start):
    node = start(drive=True)
    at(node, (2, 1, 0))
    node._nav2.goals[0][1].happens(accepted=False)
    node.tick()
    assert len(node._nav2.goals) == 2
    result = ros.Future()
    node._nav2.goals[1][1].happens(accepted=True, get_result_async=lambda: result)
    longer = np.pad(CORRIDOR[:, :-1], ((0, 0), (0, 4)), mode="edge")
    longer[1, -1] = 0
    at(node, (2, 1, 0), longer)
    assert len(node._nav2.goals) == 3
    result.happens(status=6)
    assert node.warnings[-1] == "Nav2 rejected the subgoal"


def test_the_robot_stops_in_front_of_the_door():
    wall = np.full((3, 6), HOUSE, np.uint8)
    wall[1, 1:5], wall[1, 5] = ROAD, 1
    planner = InProcess("", cell_size=0.25, sensing_range=1.0, largest=(18, 18))
    door, (x, y) = in_map(5, 1, 3), in_map(4, 1, 3)

    def place(column):
        robot = MapPose(*in_map(column, 1, 3), YAW)
        return messages.place_to_drive_to(planner.plan(messages.map_of(map_message(wall)), robot, [door]))

    assert place(1) == pytest.approx((x, y, YAW))
    assert place(4) is None
