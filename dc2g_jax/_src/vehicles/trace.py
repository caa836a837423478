"""An episode of one robot frame by frame, for figures and recordings."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, UInt8

from dc2g_jax._src.mapping.camera import Frame
from dc2g_jax._src.mapping.simulator import picture
from dc2g_jax._src.programs import jit
from dc2g_jax._src.vehicles.drive import Equipment, Robot, Site, believed, outdoor_camera, sensed, step
from dc2g_jax._src.vehicles.robot import is_driving
from dc2g_jax._src.vehicles.vehicle import CONTROL_PERIOD, VehicleState


class Moment(NamedTuple):
    """A camera frame, and the robot after the control periods that follow it; arrays on the host.

    Attributes:
      seconds: time since the start.
      picture: color image of the camera, without people.
      frame: depth and classes that the robot gets.
      robot: the robot afterwards.
      believed: the vehicle at its estimated pose then.
      cost_to_go: the planner's estimate for each cell, in the estimator's unit; `None` without estimator.
    """

    seconds: float
    picture: UInt8[np.ndarray, "height width 3"]
    frame: Frame
    robot: Robot
    believed: VehicleState
    cost_to_go: Float[np.ndarray, "h w"] | None


@jit
def _next(robot: Robot, site: Site, equipment: Equipment) -> tuple[Robot, VehicleState, Frame, Array]:
    """The robot at the next frame, its estimated pose there, the frame before, and its picture."""
    frame, _ = sensed(robot, site, equipment)
    seen = picture(site.scene, equipment.camera, outdoor_camera(robot.vehicle))
    after = jax.lax.fori_loop(0, equipment.frame_periods, lambda _, now: step(now, site, equipment), robot)
    return after, believed(after), frame, seen


def moments(robot: Robot, site: Site, equipment: Equipment, time_limit: float) -> Iterator[Moment]:
    """Drive an episode to its end, frame by frame.

    Args:
      robot: the robot at its start.
      site: the true house.
      equipment: components of the robot.
      time_limit: seconds after which the episode ends without success.
    """
    while is_driving(robot, time_limit / CONTROL_PERIOD):
        seconds = float(robot.periods) * CONTROL_PERIOD
        robot, place, frame, seen = _next(robot, site, equipment)
        cost_to_go = getattr(robot.planner_state, "cost_to_go", None)
        yield Moment(seconds, *jax.device_get((seen, frame, robot, place, cost_to_go)))
