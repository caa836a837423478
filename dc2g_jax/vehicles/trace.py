"""One robot's whole loop, frame by frame, to look at."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, UInt8

from dc2g_jax.mapping.camera import Frame
from dc2g_jax.mapping.simulator import picture
from dc2g_jax.programs import jit
from dc2g_jax.vehicles.drive import UNDER_WAY, Equipment, Robot, Site, believed, camera_pose, sensed, step
from dc2g_jax.vehicles.vehicle import CONTROL_PERIOD, VehicleState


class Moment(NamedTuple):
    """A frame, and the robot after the control periods that follow it; arrays on the host.

    Attributes:
      seconds: since the robot set out.
      picture: what the camera sees, in color.
      frame: what it delivers.
      robot: after it.
      believed: where it then takes itself to be.
      cost_to_go: what the planner expects of each cell, in the estimator's unit; `None` where it expects nothing.
    """

    seconds: float
    picture: UInt8[np.ndarray, "height width 3"]
    frame: Frame
    robot: Robot
    believed: VehicleState
    cost_to_go: Float[np.ndarray, "h w"] | None


@jit
def _next(robot: Robot, site: Site, equipment: Equipment) -> tuple[Robot, VehicleState, Frame, Array]:
    """The robot at the next frame, where it thinks that it is, the frame before that, and its picture."""
    frame, _ = sensed(robot, site, equipment)
    seen = picture(site.scene, equipment.camera, camera_pose(robot.vehicle))
    after = jax.lax.fori_loop(0, equipment.frame_periods, lambda _, now: step(now, site, equipment), robot)
    return after, believed(after), frame, seen


def moments(robot: Robot, site: Site, equipment: Equipment, time_limit: float) -> Iterator[Moment]:
    """Drive an episode to its end, and look at it at every frame.

    Args:
      robot: at its start.
      site: where it is.
      equipment: what it is made of.
      time_limit: seconds after which the episode ends without success.
    """
    while int(robot.status) == UNDER_WAY and int(robot.periods) < time_limit / CONTROL_PERIOD:
        seconds = float(robot.periods) * CONTROL_PERIOD
        robot, place, frame, seen = _next(robot, site, equipment)
        cost_to_go = getattr(robot.planner_state, "cost_to_go", None)
        yield Moment(seconds, *jax.device_get((seen, frame, robot, place, cost_to_go)))
