"""Simulated searches: robots with a camera in true houses, many at once, from their starts to their ends.

Results are in `search.evaluation`.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt8

from dc2g_jax.grid import HEADINGS
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.houses.worlds import IndoorWorld, padded_alike, painted, sample_starts, scene
from dc2g_jax.indoor.maps.camera import camera_pose, view
from dc2g_jax.indoor.maps.classes import GOALS, TARGETS
from dc2g_jax.indoor.search.agent import DECLARED, Agent, Searcher, arrives, begin, look, steer
from dc2g_jax.indoor.search.guides import true_costs, true_distance
from dc2g_jax.robot import (
    CONTROL_PERIOD,
    CameraPose,
    Ground,
    Scene,
    VehicleState,
    at_rest,
    drift_on,
    drifted,
    drive,
    is_driving,
    noisy_frame,
    render,
    run_all,
    stopped_by_obstacles,
)
from dc2g_jax.runtime import InputError, check_name

#: Control periods of an episode: 50 s (section III-C).
TIME_LIMIT = 500

#: Legs of a robot that the first call of the device drives.
_FIRST_LEGS = 5

#: Folded into a robot's key for the keys of its noise. Without noise, other random numbers thus stay as they are.
_NOISE = 1_000_003


@struct.dataclass
class IndoorSite:
    """A true house. Sites of equal size can be stacked.

    Attributes:
      scene: scene for the simulated camera.
      paint: color of each cell, see `houses.worlds.painted`.
      free: free floor.
      true_distance: that of privileged agents, see `search.agent.Agent`; `None` for all others.
    """

    scene: Scene
    paint: UInt8[Array, "h w 3"]
    free: Bool[Array, "h w"]
    true_distance: Float[Array, "goal h w"] | None


@struct.dataclass
class IndoorRobot(Searcher):
    """State of a simulated robot. Its `vehicle` is at the estimated pose.

    Attributes:
      true: the true state of the vehicle.
      drift: error of the estimated pose.
      moved: distance driven since the last frame, meters, plus quarter turns.
      collisions: control periods in which an obstacle stopped the robot.
      track: true x, y, yaw, speed and turn rate at the start and after each control period; constant after the end.
    """

    true: VehicleState
    drift: Float[Array, "3"]
    moved: Float[Array, ""]
    collisions: Int[Array, ""]
    track: Float[Array, "time 5"]


def site_of(world: IndoorWorld, name: str, agent: Agent) -> IndoorSite:
    """The site of a house, whose random colors depend on its name."""
    return IndoorSite(
        scene=scene(world),
        paint=jnp.asarray(painted(world, np.random.default_rng([*name.encode()]))),
        free=jnp.asarray(world.free),
        true_distance=true_distance(world, agent) if agent.guide is true_costs else None,
    )


def reset(
    key: Key[Array, ""], search: tuple[Float[Array, "3"], Int[Array, ""]], agent: Agent, limit: int
) -> IndoorRobot:
    """The robot at its start (x and y, meters, and yaw, radians), with an empty map, for `limit` control periods."""
    start, target = search
    searcher = begin(key, at_rest(start[:2], start[2]), target, agent)
    track = jnp.tile(_tracked(searcher.vehicle), (limit + 1, 1))
    return IndoorRobot(
        **vars(searcher),
        true=searcher.vehicle,
        drift=jnp.zeros(3, jnp.float32),
        moved=jnp.float32(0),
        collisions=jnp.int32(0),
        track=track,
    )


def at_start(key: Key[Array, ""], search: Any, site: IndoorSite, agent: Agent, limit: int) -> IndoorRobot:
    """`reset` as `run_all` calls it, with the house, which robots do not know."""
    return reset(key, search, agent, limit)


def _camera_of(robot: IndoorRobot) -> CameraPose:
    x, y = robot.true.position
    return camera_pose(x, y, robot.true.yaw)


def _estimated(vehicle: VehicleState, drift: Float[Array, "3"]) -> VehicleState:
    return dataclasses.replace(vehicle, position=vehicle.position + drift[:2], yaw=vehicle.yaw + drift[2])


def picture(robot: IndoorRobot, site: IndoorSite) -> UInt8[Array, "48 64 3"]:
    """The picture of the robot's camera."""
    return view(site.scene, site.paint, _camera_of(robot)).image


def look_and_decide(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """The first part of a leg: add a camera frame to the map, and ask the guide for new costs."""
    agent = dataclasses.replace(agent, true_distance=site.true_distance)
    drift_key, frame_key = jax.random.split(jax.random.fold_in(robot.key, _NOISE))
    drift, pose = drift_on(drift_key, robot.drift, agent.noise, robot.moved), _camera_of(robot)
    frame = noisy_frame(frame_key, render(site.scene, agent.camera, pose, agent.mapping.reach), agent.noise)
    frame = dataclasses.replace(frame, pose=drifted(pose, drift))
    robot = dataclasses.replace(
        robot, vehicle=_estimated(robot.true, drift), drift=drift, moved=jnp.zeros_like(robot.moved)
    )
    image = picture(robot, site) if agent.estimator is not None else None
    return look(robot, frame, image, agent)


def act(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """One control period: plan, drive, and check whether the object is reached."""
    limits = agent.controller.limits
    robot, command = steer(robot, agent)
    driven = drive(robot.true, command, limits)
    ground = Ground(site.free, agent.mapping.cell_size)
    true, bumped = stopped_by_obstacles(robot.true, driven, ground, limits.radius)
    vehicle = _estimated(true, robot.drift)
    moved = CONTROL_PERIOD * (true.speed + jnp.abs(true.turn_rate) / (2 * jnp.pi / HEADINGS))
    return dataclasses.replace(
        robot,
        vehicle=vehicle,
        true=true,
        moved=robot.moved + moved,
        collisions=robot.collisions + bumped,
        status=jnp.where(arrives(robot, vehicle.position, agent), DECLARED, robot.status).astype(jnp.int32),
        track=jnp.where(jnp.arange(len(robot.track))[:, None] < robot.periods, robot.track, _tracked(true)),
    )


def leg(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """Look, decide, and act for `Agent.renewal` control periods or to the end of the episode."""
    return act_on(look_and_decide(robot, site, agent), site, agent)


def act_on(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """The second part of a leg: its actions."""
    end = robot.periods + agent.renewal
    return jax.lax.while_loop(
        lambda robot: is_active(robot) & (robot.periods < end), lambda robot: act(robot, site, agent), robot
    )


def is_active(robot: IndoorRobot) -> Bool[Array, ""]:
    """Whether the robot has neither declared success nor run out of time."""
    return is_driving(robot, robot.track.shape[0] - 1)


def _tracked(vehicle: VehicleState) -> Float[Array, "5"]:
    return jnp.stack([*vehicle.position, vehicle.yaw, vehicle.speed, vehicle.turn_rate])


class Search(NamedTuple):
    """A search to be made.

    Attributes:
      house: name of the house.
      target: name of the wanted class.
      x: of the start, meters.
      y: of the start, meters.
      yaw: where the robot faces there, radians.
    """

    house: str
    target: str
    x: float
    y: float
    yaw: float


@struct.dataclass
class Searches:
    """What robots did, in the order of the episodes.

    Attributes:
      track: see `IndoorRobot`.
      declared: did the robot say that it was there?
      steps: control periods.
      collisions: of these, those in which it ran into something.
    """

    track: Float[np.ndarray, "episodes time 5"]
    declared: Bool[np.ndarray, "episodes"]
    steps: Int[np.ndarray, "episodes"]
    collisions: Int[np.ndarray, "episodes"]


def sample_episodes(
    houses: Sequence[IndoorHouse], per_house: int, *, seed: int = 0, target: str | None = None
) -> list[Search]:
    """Random starts with a target each (section III-C).

    Houses in which no object of any class can be reached are passed over.

    Args:
      houses: where.
      per_house: episodes in each.
      seed: of starts and targets; what is drawn in a house does not depend on the others.
      target: name of the wanted class; by default a random one each, of the classes that can be reached in the house.

    Raises:
      InputError: there is no episode at all, or the target is no goal class or cannot be reached in a house.
    """
    if target is not None:
        check_name("class of objects to search for", target, TARGETS)
    episodes: list[Search] = []
    for house in houses:
        rng = np.random.default_rng([seed, *house.name.encode()])
        starts = {
            name: sample_starts(house.world, goal, per_house, rng=rng)
            for goal, name in zip(GOALS, TARGETS, strict=True)
        }
        there = [name for name, drawn in starts.items() if len(drawn)]
        if target is not None and target not in there:
            known = ", ".join(there)
            raise InputError(f"{house.name}: no {target} can be searched for; give one of {known}, or another house")
        targets = [target] * per_house if target else rng.choice(there, per_house).tolist() if there else []
        for number, name in enumerate(targets):
            episodes.append(Search(house.name, name, *starts[name][number].tolist()))
    if not episodes:
        raise InputError(f"no object can be searched for in {len(houses)} houses; give others, or more of them")
    return episodes


def search_all(
    agent: Agent,
    houses: Sequence[IndoorHouse],
    episodes: Sequence[Search],
    *,
    limit: int = TIME_LIMIT,
    seed: int = 0,
    on_progress: Callable[[int], None] | None = None,
) -> Searches:
    """Run every episode to its end, on all devices.

    Args:
      agent: what the robots are made of.
      houses: those of the episodes; cells as large as those of the agent's map.
      episodes: at least one.
      limit: control periods after which an episode ends.
      seed: of all random numbers of the robots.
      on_progress: called now and then with the number of episodes that have ended.
    """
    worlds = padded_alike([house.world for house in houses])
    made = [site_of(world, house.name, agent) for house, world in zip(houses, worlds, strict=True)]
    sites = jax.tree.map(lambda *leaves: jnp.stack(leaves), *made)
    numbers = {house.name: number for number, house in enumerate(houses)}
    starts = np.array([(episode.x, episode.y, episode.yaw) for episode in episodes], np.float32)
    own = starts, np.array([TARGETS.index(episode.target) for episode in episodes], np.int32)
    where = np.array([numbers[episode.house] for episode in episodes], np.int32)
    track, status, steps, collisions = run_all(
        at_start, leg, lambda robots: (robots.track, robots.status, robots.periods, robots.collisions),
        own, where, sites, agent,
        seed=seed, number=limit, limit=limit, first_steps=_FIRST_LEGS, on_progress=on_progress,
    )  # fmt: skip
    return Searches(track=track, declared=status == DECLARED, steps=steps, collisions=collisions)
