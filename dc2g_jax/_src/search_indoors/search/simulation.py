"""Simulated robots that search for objects in true houses: the camera, the vehicle, and the end of a search.

All functions take one robot; `search.searches` runs many.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt8

from dc2g_jax._src.mapping.camera import CameraPose
from dc2g_jax._src.mapping.scene import Scene
from dc2g_jax._src.mapping.simulator import render
from dc2g_jax._src.search_indoors.houses.worlds import IndoorWorld, painted, scene
from dc2g_jax._src.search_indoors.maps.camera import camera_pose, view
from dc2g_jax._src.search_indoors.search.agent import DECLARED, Agent, Searcher, arrives, begin, look, steer
from dc2g_jax._src.vehicles.footprint import Ground
from dc2g_jax._src.vehicles.robot import is_driving, stopped_by_obstacles
from dc2g_jax._src.vehicles.vehicle import VehicleState, at_rest, drive


@struct.dataclass
class IndoorSite:
    """A true house. Sites of equal size can be stacked.

    Attributes:
      scene: scene for the simulated camera.
      paint: color of each cell, see `houses.worlds.painted`.
      free: free floor.
      known: what the agent's guide knows ahead of time, see `search.agent.Guide.init`.
    """

    scene: Scene
    paint: UInt8[Array, "h w 3"]
    free: Bool[Array, "h w"]
    known: Any


@struct.dataclass
class IndoorRobot(Searcher):
    """State of a simulated robot.

    Attributes:
      collisions: control periods in which an obstacle stopped the robot.
      track: x, y, yaw, speed and turn rate at the start and after each control period; constant after the end.
    """

    collisions: Int[Array, ""]
    track: Float[Array, "time 5"]


def site_of(world: IndoorWorld, name: str, agent: Agent) -> IndoorSite:
    """The site of a house.

    Args:
      world: one house.
      name: name of the house, which seeds its random colors.
      agent: components of the robots.
    """
    return IndoorSite(
        scene=scene(world),
        paint=jnp.asarray(painted(world, np.random.default_rng([*name.encode()]))),
        free=jnp.asarray(world.free),
        known=agent.guide.init(world, agent.controller.limits.radius),
    )


def reset(
    key: Key[Array, ""], start: Float[Array, "3"], target: Int[Array, ""], agent: Agent, limit: int
) -> IndoorRobot:
    """The robot at its start, with an empty map.

    Args:
      key: random key of the episode.
      start: x and y, meters, and yaw, radians.
      target: the wanted class, an index into `maps.classes.GOALS`.
      agent: components of the robot.
      limit: largest number of control periods.
    """
    searcher = begin(key, at_rest(start[:2], start[2]), target, agent)
    track = jnp.tile(_tracked(searcher.vehicle), (limit + 1, 1))
    return IndoorRobot(**vars(searcher), collisions=jnp.int32(0), track=track)


def _camera_of(robot: Searcher) -> CameraPose:
    """The pose of the robot's camera."""
    x, y = robot.vehicle.position
    return camera_pose(x, y, robot.vehicle.yaw)


def picture(robot: Searcher, site: IndoorSite) -> UInt8[Array, "48 64 3"]:
    """The picture of the robot's camera."""
    return view(site.scene, site.paint, _camera_of(robot)).image


def look_and_decide(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """The first part of a leg: add a camera frame to the map, and ask the guide for new costs."""
    frame = render(site.scene, agent.camera, _camera_of(robot), agent.mapping.reach)
    image = picture(robot, site) if agent.guide.uses_image else None
    return look(robot, frame, image, site.known, agent)


def act(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """One control period: plan, drive, and check whether the object is reached."""
    limits = agent.controller.limits
    robot, command = steer(robot, agent)
    driven = drive(robot.vehicle, command, limits)
    ground = Ground(site.free, agent.mapping.cell_size)
    vehicle, bumped = stopped_by_obstacles(robot.vehicle, driven, ground, limits.radius)
    return dataclasses.replace(
        robot,
        vehicle=vehicle,
        collisions=robot.collisions + bumped,
        status=jnp.where(arrives(robot, vehicle.position, agent), DECLARED, robot.status).astype(jnp.int32),
        track=jnp.where(jnp.arange(len(robot.track))[:, None] < robot.periods, robot.track, _tracked(vehicle)),
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
    """A row of `IndoorRobot.track`."""
    return jnp.stack([*vehicle.position, vehicle.yaw, vehicle.speed, vehicle.turn_rate])
