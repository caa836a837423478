"""Houses to drive in, and one episode of a robot in the whole loop, frame by frame for figures."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from dc2g_jax.grid import Pose, belief_from_map
from dc2g_jax.planning import assess, complete_rules
from dc2g_jax.robot.driving.robot import is_driving
from dc2g_jax.robot.driving.vehicle import CONTROL_PERIOD, VehicleState
from dc2g_jax.robot.mapping.camera import Frame
from dc2g_jax.robot.mapping.scene import scene_from_terrain
from dc2g_jax.robot.mapping.simulator import picture
from dc2g_jax.runtime import InputError, jit
from experiments.driving.drive import Equipment, Robot, Site, believed, outdoor_camera, sensed, step


def sites_of(terrains: Sequence[UInt8[np.ndarray, "h w"]]) -> Site:
    """Houses of one size in three dimensions, stacked along the first axis.

    Args:
      terrains: class index of every cell, house after house.

    Raises:
      InputError: there is no house, or two differ in size.
    """
    shapes = sorted({terrain.shape for terrain in terrains})
    if len(shapes) != 1:
        found = " and ".join(f"{width} x {height}" for height, width in shapes[:2])
        raise InputError(f"houses of {found or 'no'} cells: give one at least, all of one size")
    sites = [Site(terrain=jnp.asarray(terrain), scene=scene_from_terrain(terrain)) for terrain in terrains]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *sites)


class Moment(NamedTuple):
    """A camera frame, and the robot after the control periods that follow it; arrays on the host.

    Attributes:
      seconds: time since the start.
      picture: color image of the camera, without people.
      frame: depth and classes that the robot gets.
      robot: the robot afterwards.
      believed: the vehicle at its estimated pose then.
      cost_to_go: the planner's estimate for each cell at its last decision, in the estimator's unit; `None` without
        estimator.
    """

    seconds: float
    picture: UInt8[np.ndarray, "height width 3"]
    frame: Frame
    robot: Robot
    believed: VehicleState
    cost_to_go: Float[np.ndarray, "h w"] | None


@jit
def _next(
    robot: Robot, site: Site, equipment: Equipment
) -> tuple[Array, Frame, Robot, VehicleState, Float[Array, "h w"] | None]:
    """All of the next `Moment` but its time."""
    frame, _ = sensed(robot, site, equipment)
    seen = picture(site.scene, equipment.camera, outdoor_camera(robot.vehicle))
    after = jax.lax.fori_loop(0, equipment.frame_periods, lambda _, now: step(now, site, equipment), robot)
    return seen, frame, after, believed(after), _predicted(after, equipment)


def _predicted(robot: Robot, equipment: Equipment) -> Float[Array, "h w"] | None:
    """The planner's cost-to-go of every cell at the robot's last decision; `None` for planners without one."""
    # On the map of that decision, the planner has nothing to estimate anew. The rules do not matter to costs.
    column, row = robot.decided_in
    belief = belief_from_map(robot.decided_on, Pose(x=column, y=row, heading=jnp.zeros_like(row)))
    rules = complete_rules(equipment.sensing.radius)
    return assess(equipment.planner, belief, robot.planner_state, rules)[0].cost_to_go


def moments(robot: Robot, site: Site, equipment: Equipment, time_limit: float) -> Iterator[Moment]:
    """Drive an episode to its end, frame by frame, for `time_limit` seconds at most."""
    while is_driving(robot, time_limit / CONTROL_PERIOD):
        seconds = float(robot.periods) * CONTROL_PERIOD
        moment = _next(robot, site, equipment)
        robot = moment[2]
        yield Moment(seconds, *jax.device_get(moment))
