"""A robot that searches for an object: camera -> map -> costs -> IT-MPC -> vehicle (Fig. 1 of the dense-cost paper).

The controller plans ten times a second, and the vehicle executes the first command of each plan. Every few control
periods the robot adds a camera frame to its map and asks its guide (`dc2g_jax.objectnav.guides`) for new costs. The
search ends when the guide leads to an object and at most `STOP` meters of the path are left.

All functions take one robot; `dc2g_jax.objectnav.searches` runs many.
"""

import dataclasses
import functools
import math
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt8

from dc2g_jax.mapping.camera import CameraPose, Intrinsics, level_camera
from dc2g_jax.mapping.scene import Scene
from dc2g_jax.mapping.simulator import render
from dc2g_jax.objectnav.classes import GOALS, NO_OBJECT
from dc2g_jax.objectnav.cost_maps import STOP, cost_lookup, dense_costs, distance_to_object
from dc2g_jax.objectnav.mapping import IndoorMap, IndoorMapSettings, empty_map, grid_cell, integrate, stood_on
from dc2g_jax.objectnav.starts import ROBOT_RADIUS
from dc2g_jax.objectnav.worlds import IndoorWorld, painted, scene
from dc2g_jax.programs import jit
from dc2g_jax.vehicles import mppi
from dc2g_jax.vehicles.footprint import Ground
from dc2g_jax.vehicles.mppi import CostOfPose, MPPISettings
from dc2g_jax.vehicles.robot import DRIVING, SimulatedRobot, is_driving, stopped_by_obstacles
from dc2g_jax.vehicles.vehicle import CONTROL_PERIOD, VehicleLimits, VehicleState, at_rest, drive, wrapped

#: The camera: height above the floor, meters; angle below the horizon, radians; horizontal field of view, degrees; rows
#: and columns of its image. It is as high as on the usual research robots. Level, it would see no floor nearer than
#: 1.2 m and leave a hole in the map around the start. At this angle the floor is in view from 0.6 m on, and walls up to
#: 1.5 m high from 2.0 m on.
INDOOR_CAMERA_HEIGHT, INDOOR_CAMERA_PITCH = 0.9, math.radians(20)
INDOOR_FIELD_OF_VIEW, INDOOR_IMAGE_SIZE = 90.0, (120, 160)

#: Floor within this distance counts as explored, meters. The camera never sees it, and robots would return to look.
FOOTROOM = 0.6

#: Limits of an indoor robot, about the speed of a person in a room.
LIMITS = VehicleLimits(
    max_speed=1.0, max_turn_rate=2.0, max_acceleration=1.5, max_turn_acceleration=8.0, radius=ROBOT_RADIUS
)

#: Settings of the controller. The number of samples was chosen on validation houses.
CONTROLLER = MPPISettings(limits=LIMITS, samples=128)

#: Costs of the controller in meters: of a blocked cell; of a cell beside known costs, in addition to theirs; of each
#: meter further away from known costs; and of leaving the local map. The first and last exceed what a shortcut through
#: a wall can save: a detour of up to 20 m at each of the horizon's steps, up to 50.
_COLLISION, _MARGIN, _SLOPE, _OUTSIDE = 2000.0, 1.0, 3.0, 2000.0

#: Time in which a vehicle that descends the costs turns to the direction of descent, seconds.
_TURNING_TIME = 0.3

#: Status of a robot that has declared to have reached the object.
DECLARED = 1


@struct.dataclass
class IndoorSite:
    """A true house. Sites of equal size can be stacked.

    Attributes:
      scene: scene for the simulated camera.
      paint: color of each cell, see `dc2g_jax.objectnav.worlds.painted`.
      free: free floor.
      distances: distance that the robot's center has to drive until an object of each of `GOALS` is at arm's length,
        meters; infinite where the robot does not fit or no path leads there. Only a privileged guide uses it.
    """

    scene: Scene
    paint: UInt8[Array, "h w 3"]
    free: Bool[Array, "h w"]
    distances: Float[Array, "goal h w"]


@struct.dataclass
class Guidance:
    """Costs of the cells of the local map.

    Attributes:
      distance: cost of each cell, usually meters to drive; infinite where the robot must not be.
      to_goal: whether the costs lead to an object of the wanted class. The robot declares success at their end.
    """

    distance: Float[Array, "n n"]
    to_goal: Bool[Array, ""]


class Guide(Protocol):
    """Strategy that directs a robot. Implementations are pytrees."""

    def guide(self, key: Key[Array, ""], robot: "IndoorRobot", site: IndoorSite, agent: "Agent") -> Guidance:
        """Costs of the cells of the robot's local map, which is centered on `IndoorRobot.local_middle`."""
        ...


class Steering(Protocol):
    """Strategy that makes commands from costs. Implementations are pytrees."""

    def plan(self, key: Key[Array, ""], robot: "IndoorRobot", costs: CostOfPose, agent: "Agent") -> Float[Array, "h 2"]:
        """The robot's next plan. Its first command is executed."""
        ...


@struct.dataclass
class Agent:
    """Components of a robot.

    Attributes:
      guide: directs the robot.
      steering: makes commands from the guide's costs.
      camera: intrinsics of the camera.
      mapping: settings of the map.
      controller: settings of the controller, with the limits of the vehicle.
      renewal: control periods between two camera frames, and between two sets of costs.
    """

    guide: Guide
    steering: Steering
    camera: Intrinsics
    mapping: IndoorMapSettings = IndoorMapSettings()
    controller: MPPISettings = CONTROLLER
    renewal: int = struct.field(pytree_node=False, default=5)


@struct.dataclass
class IndoorRobot(SimulatedRobot):
    """State of a robot. Its status is `DRIVING` or `DECLARED`.

    Attributes:
      target: the wanted class, an index into `GOALS`.
      map: map of the house so far.
      local_middle: row and column in the world's grid of the cell in the middle of the local map, at half its side.
      guidance: last costs of the guide.
      costs: the same costs, with costs that lead back to them elsewhere.
      controls: plan of the controller.
      bumps: control periods in which an obstacle stopped the robot.
      track: x, y, yaw, speed and turn rate at the start and after each control period; constant after the end.
    """

    target: Int[Array, ""]
    map: IndoorMap
    local_middle: Int[Array, "2"]
    guidance: Guidance
    costs: Float[Array, "n n"]
    controls: Float[Array, "h 2"]
    bumps: Int[Array, ""]
    track: Float[Array, "time 5"]


@struct.dataclass
class MPC:
    """Steering with IT-MPC. One of its sampled plans is not random but descends the costs.

    Turning around takes a second or two. Random plans hardly ever stop for so long, and those that do not stop hit the
    wall ahead.
    """

    def plan(self, key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
        """See `Steering`."""
        return self.weighed(key, robot, costs, agent)[0]

    @staticmethod
    def weighed(
        key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent
    ) -> tuple[Float[Array, "h 2"], mppi.SampledPlans]:
        """The next plan, and the sampled plans that it is the weighted mean of."""
        candidate = descent(robot.vehicle, costs, agent)
        return mppi.plan(key, robot.controls, robot.vehicle, costs, agent.controller, candidate)


def descent(vehicle: VehicleState, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
    """Commands over the horizon that turn the vehicle to the direction of steepest descent and drive it there."""
    limits, settings = agent.controller.limits, agent.controller
    steps = agent.mapping.cell_size * jnp.array([[1, 0], [-1, 0], [0, 1], [0, -1]], jnp.float32)

    def follow(vehicle: VehicleState, _: None) -> tuple[VehicleState, Float[Array, "2"]]:
        east, west, north, south = (costs(vehicle.position + step, vehicle.yaw) for step in steps)
        error = wrapped(jnp.arctan2(south - north, west - east) - vehicle.yaw)
        ahead = jnp.maximum(jnp.cos(error), 0) ** 2
        command = jnp.stack([limits.max_speed * ahead, error / _TURNING_TIME])
        return drive(vehicle, command, limits), command

    return jax.lax.scan(follow, vehicle, length=settings.horizon)[1]


@struct.dataclass
class LookAround:
    """Steering that turns the robot once in place at the start, or until it has seen an object.

    This adds nothing to the length of the path.

    Attributes:
      steering: used afterwards.
    """

    steering: Steering

    def plan(self, key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
        """See `Steering`."""
        limits = agent.controller.limits
        looks = ~robot.guidance.to_goal & (robot.periods * CONTROL_PERIOD * limits.max_turn_rate < 2 * math.pi)
        turning = jnp.zeros_like(robot.controls).at[0, 1].set(limits.max_turn_rate)
        return jax.lax.cond(looks, lambda: turning, lambda: self.steering.plan(key, robot, costs, agent))


@struct.dataclass
class RandomUntilSeen:
    """Random commands until a path to an object is known, then IT-MPC: the paper's privileged random agent.

    Speed and turn rate are drawn anew in each control period (section IV-A).
    """

    def plan(self, key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
        """See `Steering`."""
        limits = agent.controller.limits

        def drawn() -> Float[Array, "h 2"]:
            least, most = jnp.array([0, -limits.max_turn_rate]), jnp.array([limits.max_speed, limits.max_turn_rate])
            return jax.random.uniform(key, robot.controls.shape, minval=least, maxval=most)

        return jax.lax.cond(robot.guidance.to_goal, lambda: MPC().plan(key, robot, costs, agent), drawn)


def site_of(world: IndoorWorld, name: str, radius: float = ROBOT_RADIUS) -> IndoorSite:
    """The site of a house.

    Args:
      world: one house.
      name: name of the house, which seeds its random colors.
      radius: radius of the robots, meters.
    """
    return IndoorSite(
        scene=scene(world),
        paint=jnp.asarray(painted(world, np.random.default_rng([*name.encode()]))),
        free=jnp.asarray(world.free),
        distances=_object_distances(world.free, world.classes, radius, float(world.cell_size)),
    )


@functools.partial(jit, static_argnames=("radius", "cell_size"))
def _object_distances(free: Array, classes: Array, radius: float, cell_size: float) -> Float[Array, "goal h w"]:
    """Distance of each cell to each of `GOALS`. Cells that are neither free nor an object are walls, or outside."""
    walls = ~free & (classes == NO_OBJECT)
    return jax.lax.map(
        lambda goal: distance_to_object(~free, walls, classes == goal, radius=radius, cell_size=cell_size),
        jnp.array(GOALS, jnp.uint8),
    )


def reset(
    key: Key[Array, ""], start: Float[Array, "3"], target: Int[Array, ""], agent: Agent, limit: int
) -> IndoorRobot:
    """The robot at its start, with an empty map.

    Args:
      key: random key of the episode.
      start: x and y, meters, and yaw, radians.
      target: the wanted class, an index into `GOALS`.
      agent: components of the robot.
      limit: largest number of control periods.
    """
    vehicle = at_rest(start[:2], start[2])
    side, zero = agent.mapping.local, jnp.int32(0)
    return IndoorRobot(
        key=key,
        target=jnp.asarray(target, jnp.int32),
        vehicle=vehicle,
        map=empty_map(vehicle.position, agent.mapping),
        local_middle=grid_cell(vehicle.position, agent.mapping.cell_size),
        guidance=Guidance(jnp.full((side, side), jnp.inf, jnp.float32), jnp.bool_(False)),
        costs=jnp.zeros((side, side), jnp.float32),
        controls=mppi.standing_still(agent.controller),
        periods=zero,
        bumps=zero,
        status=jnp.int32(DRIVING),
        track=jnp.tile(_tracked(vehicle), (limit + 1, 1)),
    )


def indoor_camera(vehicle: VehicleState) -> CameraPose:
    """The pose of the camera of a vehicle."""
    x, y = vehicle.position
    return level_camera(x, y, INDOOR_CAMERA_HEIGHT, vehicle.yaw, INDOOR_CAMERA_PITCH)


def look_and_decide(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """The first part of a leg: add a camera frame to the map, and ask the guide for new costs."""
    position, cell_size = robot.vehicle.position, agent.mapping.cell_size
    frame = render(site.scene, agent.camera, indoor_camera(robot.vehicle), agent.mapping.reach)
    seen = integrate(robot.map, frame, agent.camera, agent.mapping)
    key, own_key = jax.random.split(robot.key)
    robot = dataclasses.replace(
        robot,
        key=key,
        map=stood_on(seen, position, FOOTROOM, agent.mapping),
        local_middle=grid_cell(position, cell_size),
    )
    guidance = agent.guide.guide(own_key, robot, site, agent)
    return dataclasses.replace(robot, guidance=guidance, costs=filled_costs(guidance.distance, cell_size))


def filled_costs(distance: Float[Array, "n n"], cell_size: float) -> Float[Array, "n n"]:
    """Costs for the controller: the distance where finite, elsewhere costs that lead back to such cells.

    A cell with infinite distance costs more than all of its neighbors with finite distance, so that a shorter distance
    on the other side of a wall has no effect.

    Args:
      distance: costs of the guide, meters; infinite where the robot must not be.
      cell_size: edge of a cell, meters.
    """
    known = jnp.isfinite(distance)
    around = jax.lax.reduce_window(jnp.where(known, distance, -jnp.inf), -jnp.inf, jax.lax.max, (3, 3), (1, 1), "SAME")
    rest = dense_costs(distance, cell_size, collision=_MARGIN, slope=_SLOPE)
    return jnp.where(known, distance, jnp.where(jnp.isfinite(around), around + _MARGIN, rest))


def act(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """One control period: plan, drive, and check whether the object is reached."""
    key, own_key = jax.random.split(robot.key)
    size, limits = agent.mapping.cell_size, agent.controller.limits
    first = robot.local_middle - agent.mapping.local // 2
    plan = agent.steering.plan(own_key, robot, cost_of_pose(robot, agent), agent)
    driven = drive(robot.vehicle, plan[0], limits)
    vehicle, bumped = stopped_by_obstacles(robot.vehicle, driven, Ground(site.free, size), limits.radius)
    row, column = grid_cell(vehicle.position, size) - first
    arrived = robot.guidance.to_goal & (robot.guidance.distance[row, column] <= STOP)
    periods = robot.periods + 1
    return dataclasses.replace(
        robot,
        key=key,
        vehicle=vehicle,
        controls=mppi.shift(plan),
        periods=periods,
        bumps=robot.bumps + bumped,
        status=jnp.where(arrived, DECLARED, robot.status).astype(jnp.int32),
        track=jnp.where(jnp.arange(len(robot.track))[:, None] < periods, robot.track, _tracked(vehicle)),
    )


def cost_of_pose(robot: IndoorRobot, agent: Agent) -> CostOfPose:
    """The controller's cost of a pose: the guide's costs, interpolated between cells, and a penalty for collisions.

    The penalty is not interpolated. Otherwise it would close gaps of a single cell, through which the robot just fits.
    """
    side, size = agent.mapping.local, agent.mapping.cell_size
    first = robot.local_middle - side // 2
    corner = first[::-1].astype(jnp.float32) * jnp.array([size, -size], jnp.float32)
    lookup, closed = cost_lookup(robot.costs, size, _OUTSIDE), ~jnp.isfinite(robot.guidance.distance)

    def cost(position: Float[Array, "2"], yaw: Float[Array, ""]) -> Float[Array, ""]:
        row, column = jnp.clip(grid_cell(position, size) - first, 0, side - 1)
        return lookup(position - corner, yaw) + jnp.where(closed[row, column], _COLLISION, 0)

    return cost


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
