"""A robot that searches for an object: camera -> map -> costs -> IT-MPC -> command (Fig. 1 of the dense-cost paper).

The controller plans ten times a second, and the vehicle executes the first command of each plan (`steer`). Every few
control periods the robot adds a camera frame to its map and asks its guide (`search.guides`) for new costs
(`look`). The search ends when the guide leads to an object and at most `STOP` meters of the path are left (`arrives`).

Nothing here knows the true house. `search.searches` simulates a robot in a house, and
`search.online` runs on a real one. All functions take one robot.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt8

from dc2g_jax.grid import NoiseLevels
from dc2g_jax.indoor.learning.networks import CostMapEstimator
from dc2g_jax.indoor.maps.cost_maps import ROBOT_RADIUS, STOP, cost_lookup, dense_costs
from dc2g_jax.indoor.maps.mapping import IndoorMap, IndoorMapSettings, empty_map, grid_cell, square, with_frame
from dc2g_jax.robot import (
    CONTROL_PERIOD,
    DRIVING,
    CostOfPose,
    Frame,
    Intrinsics,
    MPPISettings,
    SampledPlans,
    SimulatedRobot,
    VehicleLimits,
    VehicleState,
    drive,
    plan_controls,
    shifted_controls,
    wrapped,
)

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
class Guidance:
    """Costs of the cells of the local map.

    Attributes:
      distance: cost of each cell, usually meters to drive; infinite where the robot must not be.
      to_goal: whether the costs lead to an object of the wanted class. The robot declares success at their end.
    """

    distance: Float[Array, "n n"]
    to_goal: Bool[Array, ""]


#: The picture of a robot's camera, of robots that take some.
Picture = UInt8[Array, "48 64 3"] | None

#: Strategy that directs a robot: `(robot, picture of its camera, components) -> costs of its local map`.
Guide = Callable[["Searcher", Picture, "Agent"], Guidance]

#: Strategy that makes commands from costs: `(key, robot, costs, components) -> the robot's next plan [h 2]`. Its first
#: command is executed.
Steering = Callable[[Key[Array, ""], "Searcher", CostOfPose, "Agent"], Array]


@struct.dataclass
class Agent:
    """Components of a robot.

    Attributes:
      guide: directs the robot; a function of a module, for which programs are compiled once.
      steering: makes commands from the guide's costs; likewise.
      camera: intrinsics of the camera.
      estimator: predicts costs, for guides that follow them; only these robots take pictures.
      true_distance: distance that the robot's center has to drive until an object of each of `GOALS` is within reach,
        meters; infinite where the robot does not fit or no path leads there. Only for the guide that knows the house.
      mapping: settings of the map.
      controller: settings of the controller, with the limits of the vehicle.
      noise: noise of a simulated camera and pose.
      renewal: control periods between two camera frames, and between two sets of costs.
      margin: how much nearer than `maps.cost_maps.ARM` the path to an object ends, meters; for poses with errors.
    """

    guide: Guide = struct.field(pytree_node=False)
    steering: Steering = struct.field(pytree_node=False)
    camera: Intrinsics
    estimator: CostMapEstimator | None = None
    true_distance: Float[Array, "goal h w"] | None = None
    mapping: IndoorMapSettings = IndoorMapSettings()
    controller: MPPISettings = CONTROLLER
    noise: NoiseLevels = NoiseLevels()
    renewal: int = struct.field(pytree_node=False, default=5)
    margin: float = struct.field(pytree_node=False, default=0.0)


@struct.dataclass
class Searcher(SimulatedRobot):
    """A robot that searches, as it knows itself. Its status is `DRIVING` or `DECLARED`.

    Attributes:
      target: the wanted class, an index into `maps.classes.GOALS`.
      map: map of the house so far.
      local_middle: row and column in the world's grid of the cell in the middle of the local map, at half its side.
      guidance: last costs of the guide.
      costs: the same costs, with costs that lead back to them elsewhere.
      controls: plan of the controller.
    """

    target: Int[Array, ""]
    map: IndoorMap
    local_middle: Int[Array, "2"]
    guidance: Guidance
    costs: Float[Array, "n n"]
    controls: Float[Array, "h 2"]


_Robot = TypeVar("_Robot", bound=Searcher)


def with_mpc(key: Key[Array, ""], robot: Searcher, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
    """Steering with IT-MPC, see `weighed`."""
    return weighed(key, robot, costs, agent)[0]


def weighed(
    key: Key[Array, ""], robot: Searcher, costs: CostOfPose, agent: Agent
) -> tuple[Float[Array, "h 2"], SampledPlans]:
    """The next plan of IT-MPC, and the sampled plans that it is the weighted mean of.

    One of these is not random but descends the costs. Turning around takes a second or two. Random plans hardly ever
    stop for so long, and those that do not stop hit the wall ahead.
    """
    candidate = descent(robot.vehicle, costs, agent)
    return plan_controls(key, robot.controls, robot.vehicle, costs, agent.controller, candidate)


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


def look_around_first(key: Key[Array, ""], robot: Searcher, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
    """Steering that turns the robot once in place at the start, or until it has seen an object; then `with_mpc`.

    This adds nothing to the length of the path.
    """
    limits = agent.controller.limits
    looks = ~robot.guidance.to_goal & (robot.periods * CONTROL_PERIOD * limits.max_turn_rate < 2 * math.pi)
    turning = jnp.zeros_like(robot.controls).at[0, 1].set(limits.max_turn_rate)
    return jax.lax.cond(looks, lambda: turning, lambda: with_mpc(key, robot, costs, agent))


def random_until_seen(key: Key[Array, ""], robot: Searcher, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
    """Random commands until a path to an object is known, then `with_mpc`: the paper's privileged random agent.

    Speed and turn rate are drawn anew in each control period (section IV-A).
    """
    limits = agent.controller.limits

    def drawn() -> Float[Array, "h 2"]:
        least, most = jnp.array([0, -limits.max_turn_rate]), jnp.array([limits.max_speed, limits.max_turn_rate])
        return jax.random.uniform(key, robot.controls.shape, minval=least, maxval=most)

    return jax.lax.cond(robot.guidance.to_goal, lambda: with_mpc(key, robot, costs, agent), drawn)


def begin(key: Key[Array, ""], vehicle: VehicleState, target: Int[Array, ""], agent: Agent) -> Searcher:
    """The robot at its start, with an empty map."""
    side = agent.mapping.local
    return Searcher(
        key=key,
        vehicle=vehicle,
        periods=jnp.int32(0),
        status=jnp.int32(DRIVING),
        target=jnp.asarray(target, jnp.int32),
        map=empty_map(vehicle.position, agent.mapping),
        local_middle=grid_cell(vehicle.position, agent.mapping.cell_size),
        guidance=Guidance(jnp.full((side, side), jnp.inf, jnp.float32), jnp.bool_(False)),
        costs=jnp.zeros((side, side), jnp.float32),
        controls=jnp.zeros((agent.controller.horizon, 2), jnp.float32),
    )


def look(robot: _Robot, frame: Frame, image: Picture, agent: Agent) -> _Robot:
    """Add a camera frame to the map, and ask the guide for new costs."""
    position, cell_size = robot.vehicle.position, agent.mapping.cell_size
    robot = dataclasses.replace(
        robot,
        key=jax.random.split(robot.key)[0],
        map=with_frame(robot.map, frame, position, agent.camera, agent.mapping),
        local_middle=grid_cell(position, cell_size),
    )
    # A simulated robot is more than it knows of itself.
    known = Searcher(**{field.name: getattr(robot, field.name) for field in dataclasses.fields(Searcher)})
    guidance = agent.guide(known, image, agent)
    return dataclasses.replace(robot, guidance=guidance, costs=_filled_costs(guidance.distance, cell_size))


def steer(robot: _Robot, agent: Agent) -> tuple[_Robot, Float[Array, "2"]]:
    """Plan for one control period.

    Returns:
      The robot with its next plan, and the command to execute: speed, m/s, and turn rate, rad/s.
    """
    key, own_key = jax.random.split(robot.key)
    plan = agent.steering(own_key, robot, cost_of_pose(robot, agent), agent)
    return dataclasses.replace(robot, key=key, controls=shifted_controls(plan), periods=robot.periods + 1), plan[0]


def _costs_around(robot: Searcher, position: Float[Array, "2"], agent: Agent, side: int) -> Float[Array, "side side"]:
    cell = grid_cell(position, agent.mapping.cell_size) - robot.local_middle + agent.mapping.local // 2
    return square(robot.guidance.distance, cell - side // 2, side, jnp.inf)


def cost_at(robot: Searcher, position: Float[Array, "2"], agent: Agent) -> Float[Array, ""]:
    """The guide's last cost at a position (x and y, meters); infinite off the local map."""
    return _costs_around(robot, position, agent, 1)[0, 0]


def arrives(robot: Searcher, position: Float[Array, "2"], agent: Agent) -> Bool[Array, ""]:
    """Whether the robot has reached the object at a position (x and y, meters).

    With a margin, it has also reached the object if it is within the margin and no adjacent cell is nearer.
    """
    near = _costs_around(robot, position, agent, 3)
    here = near[1, 1]
    enough = (here <= STOP) | (here <= STOP + agent.margin) & (here <= jnp.min(near))
    return robot.guidance.to_goal & enough


def _filled_costs(distance: Float[Array, "n n"], cell_size: float) -> Float[Array, "n n"]:
    """Costs for the controller: the distance where finite, elsewhere costs that lead back to such cells.

    A cell with infinite distance costs more than all of its neighbors with finite distance, so that a shorter distance
    on the other side of a wall has no effect.
    """
    known = jnp.isfinite(distance)
    around = jax.lax.reduce_window(jnp.where(known, distance, -jnp.inf), -jnp.inf, jax.lax.max, (3, 3), (1, 1), "SAME")
    rest = dense_costs(distance, cell_size, collision=_MARGIN, slope=_SLOPE)
    return jnp.where(known, distance, jnp.where(jnp.isfinite(around), around + _MARGIN, rest))


def cost_of_pose(robot: Searcher, agent: Agent) -> CostOfPose:
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
