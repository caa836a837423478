"""What all simulated robots share: a vehicle with a camera, and an episode of control periods."""

import dataclasses

import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Int, Key

from dc2g_jax.mapping.camera import CameraPose, level_camera
from dc2g_jax.vehicles.footprint import Ground, clearance, surroundings
from dc2g_jax.vehicles.vehicle import VehicleState

#: Status of a robot whose episode has not ended. Other values depend on the kind of robot.
DRIVING = 0


@struct.dataclass
class SimulatedRobot:
    """State that all kinds of robots have.

    Attributes:
      key: random key.
      vehicle: true state of the vehicle.
      periods: control periods since the start.
      status: `DRIVING`, or how the episode ended.
    """

    key: Key[Array, ""]
    vehicle: VehicleState
    periods: Int[Array, ""]
    status: Int[Array, ""]


def is_driving(robot: SimulatedRobot, limit: ArrayLike) -> Bool[Array, ""]:
    """Whether the episode has not ended and lasts less than `limit` control periods so far."""
    return (robot.status == DRIVING) & (robot.periods < limit)


def camera_pose(vehicle: VehicleState, height: float, pitch: float) -> CameraPose:
    """The pose of a camera above the center of a vehicle, which looks ahead.

    Args:
      vehicle: state of the vehicle.
      height: height of the camera above the ground, meters.
      pitch: angle of its optical axis below the horizon, radians.
    """
    x, y = vehicle.position
    return level_camera(x, y, height, vehicle.yaw, pitch)


def stopped_by_obstacles(
    before: VehicleState, after: VehicleState, ground: Ground, radius: float
) -> tuple[VehicleState, Bool[Array, ""]]:
    """Keep a vehicle from driving into obstacles: it stays where it was and loses its speed.

    It still turns, because a circular footprint covers no new ground. A vehicle that already touches an obstacle may
    move away from it.

    Args:
      before: the vehicle at the start of a control period.
      after: the vehicle at its end without obstacles.
      ground: allowed ground of the footprint.
      radius: radius of the footprint, meters.

    Returns:
      The vehicle at the end of the period, and whether it was stopped.
    """
    around = surroundings(ground, before.position, radius + 2 * ground.cell_size)
    now, then = clearance(jnp.stack([before.position, after.position]), around)
    bumped = (then < radius) & (then < now)
    position, speed = jnp.where(bumped, before.position, after.position), jnp.where(bumped, 0, after.speed)
    return dataclasses.replace(after, position=position, speed=speed), bumped
