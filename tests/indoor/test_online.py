"""A robot's decisions from recorded frames: those of the simulated search that the frames are from."""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax.indoor.maps.camera import camera_pose
from dc2g_jax.indoor.maps.classes import GOALS, PLANT
from dc2g_jax.indoor.search.agent import DECLARED, LIMITS, look_around_first
from dc2g_jax.indoor.search.guides import promising_frontier, true_costs, until_seen
from dc2g_jax.indoor.search.online import OnlineSearcher
from dc2g_jax.indoor.search.searches import act, is_active, look_and_decide, picture, reset, site_of
from dc2g_jax.robot.mapping.camera import Frame
from dc2g_jax.robot.mapping.simulator import render
from tests.support.refusals import refusal
from tests.support.two_rooms import AGENT, two_rooms

START, LIMIT, SEED = (0.6, -2.9, 3.0), 120, 5


class Moment(NamedTuple):
    """One control period of a simulated search: what the robot had, the speeds it then drove at, and what led it."""

    pose: np.ndarray
    speeds: np.ndarray
    frame: Frame | None
    image: np.ndarray | None
    driven: np.ndarray
    to_goal: bool


@struct.dataclass
class PicturesMatter:
    """Predicts costs that depend on the picture and on the direction of the camera."""

    def estimate(self, maps, target, heading, image):
        cost = (jnp.mean(image / 255) - 0.5) * jnp.arange(maps.shape[-1]) + 0.1 * heading
        return jnp.broadcast_to(cost - jnp.min(cost), maps.shape[1:])


AGENTS = {
    "frontier": AGENT.replace(steering=look_around_first),
    "promising": AGENT.replace(guide=until_seen(promising_frontier), estimator=PicturesMatter()),
}


@functools.cache
def recording(name: str) -> tuple[list[Moment], np.ndarray]:
    """A simulated search in the house of two rooms until the robot says that it is there, and its last pose."""
    agent, house = AGENTS[name], two_rooms()
    site = site_of(house.world, house.name, agent)
    render_at = lambda pose: render(site.scene, agent.camera, pose, agent.mapping.reach)  # noqa: E731
    take, photograph = jax.jit(render_at), jax.jit(lambda robot: picture(robot, site))
    look, drive = (jax.jit(lambda robot, step=step: step(robot, site, agent)) for step in (look_and_decide, act))
    robot = reset(jax.random.key(SEED), (jnp.array(START), jnp.int32(GOALS.index(PLANT))), agent, LIMIT)
    moments: list[Moment] = []
    while is_active(robot):
        x, y, yaw, *speeds = np.asarray(robot.track[len(moments)])
        frame = image = None
        if len(moments) % agent.renewal == 0:
            frame, image = jax.tree.map(np.asarray, (take(camera_pose(x, y, yaw)), photograph(robot)))
            robot = look(robot)
        before, robot = robot, drive(robot)
        assert int(robot.collisions) == 0
        driven = np.asarray(robot.track[robot.periods, 3:])
        to_goal = bool(before.guidance.to_goal)
        moments.append(Moment(np.array([x, y, yaw]), np.array(speeds), frame, image, driven, to_goal))
    assert int(robot.status) == DECLARED
    return moments, np.asarray(robot.track[-1, :3])


@functools.cache
def searcher_of(name: str) -> OnlineSearcher:
    return OnlineSearcher(AGENTS[name])


@pytest.fixture
def compiled():
    """Names of the steps of compilation that JAX takes while a test runs."""
    events: list[str] = []
    listen = lambda event, seconds, **facts: events.append(event) if "compile" in event else None  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(listen)
    yield events
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.parametrize("name", AGENTS)
def test_recorded_frames_lead_to_the_decisions_of_the_simulated_search(name, compiled):
    moments, end = recording(name)
    assert 30 < len(moments) < LIMIT
    assert {moment.to_goal for moment in moments} == {True, False}
    searcher = searcher_of(name)
    compiled.clear()
    memory = searcher.init(START, seed=SEED)
    for moment in moments:
        decision, memory = searcher.decide(memory, "plant", moment.pose, moment.speeds, moment.frame, moment.image)
        assert decision.mode == ("to_goal" if moment.to_goal else "explore")
        np.testing.assert_allclose(decision[:2], moment.driven, atol=1e-5)
    decision, memory = searcher.decide(memory, "plant", end, moments[-1].driven)
    assert (decision.mode, decision.why) == ("arrived", "arrived: the plant is within reach")
    assert decision.speed == max(0, moments[-1].driven[0] - 0.1 * LIMITS.max_acceleration)
    assert compiled == []
    jax.jit(lambda: 1)()
    assert compiled


def test_the_map_is_kept_when_the_target_changes():
    searcher, (moments, _) = searcher_of("frontier"), recording("frontier")
    memory = searcher.init(START)
    for moment in moments[:21]:  # once around, with the bed in view
        seen = moment.pose, moment.speeds, moment.frame
        decision, memory = searcher.decide(memory, "bed", *seen)
    cells = np.asarray(memory.map.cells)
    refusal(lambda: searcher.decide(memory, "plant", *seen[:2]), "'plant' is new", "no frame", "give one")
    other, memory = searcher.decide(memory, "plant", *seen)
    np.testing.assert_array_equal(memory.map.cells, cells)
    assert (decision.mode, other.mode) == ("to_goal", "explore")
    assert decision.why == f"to goal: a bed is on the map, {decision.cost:.1f} m to drive"
    assert other.why == f"explore: no path to a plant is known, the guide's cost is {other.cost:.1f} here"


def test_robots_take_turns_with_one_searcher():
    searcher, (moments, _) = searcher_of("frontier"), recording("frontier")
    memories = [searcher.init(START, seed=seed) for seed in (SEED, SEED)]
    for moment in moments[:7]:
        decisions = []
        for number in range(2):
            decision, memories[number] = searcher.decide(memories[number], "plant", *moment[:4])
            decisions.append(decision)
        assert decisions[0] == decisions[1]


@pytest.mark.parametrize(
    ("wrong", "mentions"),
    [
        ({"target": "car"}, ("'car'", "bed, chair, sink, plant, couch")),
        ({"pose": (1.0, 2.0)}, ("pose is (1.0, 2.0)", "finite numbers")),
        ({"pose": (1.0, np.nan, 0.0)}, ("pose", "finite numbers")),
        ({"speeds": "fast"}, ("speeds is 'fast'", "finite numbers")),
        ({"image": None}, ("picture is missing", "uint8 [48, 64, 3]")),
        ({"image": np.zeros((48, 64, 3))}, ("picture is of dtype float64", "uint8 [48, 64, 3]")),
        ({"depth": np.zeros((30, 41), np.float32)}, ("depth has shape (30, 41)", "(30, 40)")),
        ({"classes": np.zeros((30, 40), np.int64)}, ("classes int64", "uint8")),
    ],
)
def test_bad_input_is_refused(wrong, mentions):
    searcher, first = searcher_of("promising"), recording("promising")[0][0]
    given = {"target": "plant", "pose": first.pose, "speeds": first.speeds, "image": first.image} | wrong
    images = {name: given.pop(name) for name in ("depth", "classes") if name in given}
    frame = dataclasses.replace(first.frame, **images)
    refusal(lambda: searcher.decide(searcher.init(START), frame=frame, **given), *mentions)


def test_agents_that_know_the_house_are_refused():
    refusal(lambda: OnlineSearcher("true_cost"), "'true_cost'", "promising, predicted, frontier")
    refusal(lambda: OnlineSearcher(AGENT.replace(guide=true_costs)), "true_costs", "ahead of time", "another one")
