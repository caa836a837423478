"""The vehicle: a unicycle with a circular footprint and limits on velocities and accelerations.

It drives in the ground plane of the world of `mapping.camera`: meters, x along the map's columns, y against
its rows, yaw counter-clockwise from +x. It never drives backward, where its camera does not look. It can always turn in
place, because a circular footprint then covers no new ground.

All functions take one vehicle; use `jax.vmap` for batches.
"""

import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float

#: Seconds between two commands, 10 Hz.
CONTROL_PERIOD = 0.1


@struct.dataclass
class VehicleState:
    """Pose and velocities of a vehicle.

    Attributes:
      position: center of the footprint, meters.
      yaw: direction of the vehicle, counter-clockwise from +x, radians, -pi to pi.
      speed: forward speed, meters per second.
      turn_rate: turn rate, counter-clockwise, radians per second.
    """

    position: Float[Array, "2"]
    yaw: Float[Array, ""]
    speed: Float[Array, ""]
    turn_rate: Float[Array, ""]


@struct.dataclass
class VehicleLimits:
    """Limits of a vehicle. Defaults are typical of a sidewalk delivery robot. Static under `jit`.

    Attributes:
      max_speed: largest forward speed, meters per second.
      max_turn_rate: largest turn rate in either direction, radians per second.
      max_acceleration: largest acceleration and deceleration, meters per second squared.
      max_turn_acceleration: largest change of the turn rate in either direction, radians per second squared.
      radius: radius of the footprint, meters.
    """

    max_speed: float = struct.field(pytree_node=False, default=1.5)
    max_turn_rate: float = struct.field(pytree_node=False, default=2.0)
    max_acceleration: float = struct.field(pytree_node=False, default=1.5)
    max_turn_acceleration: float = struct.field(pytree_node=False, default=8.0)
    radius: float = struct.field(pytree_node=False, default=0.3)


def at_rest(position: ArrayLike, yaw: ArrayLike) -> VehicleState:
    """The state of a vehicle at rest; x and y, meters, and yaw, radians."""
    still = jnp.float32(0)
    return VehicleState(
        position=jnp.asarray(position, jnp.float32),
        yaw=wrapped(jnp.asarray(yaw, jnp.float32)),
        speed=still,
        turn_rate=still,
    )


def wrapped(angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The angle wrapped to [-pi, pi), radians."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi


def reachable_command(
    state: VehicleState, command: Float[Array, "2"], limits: VehicleLimits, seconds: float
) -> Float[Array, "2"]:
    """The speed and turn rate nearest to a command that a vehicle can reach within its limits in `seconds`."""
    speed_change, turn_change = limits.max_acceleration * seconds, limits.max_turn_acceleration * seconds
    speed = jnp.clip(command[0], state.speed - speed_change, state.speed + speed_change)
    turn_rate = jnp.clip(command[1], state.turn_rate - turn_change, state.turn_rate + turn_change)
    return jnp.stack(
        [jnp.clip(speed, 0, limits.max_speed), jnp.clip(turn_rate, -limits.max_turn_rate, limits.max_turn_rate)]
    )


def _along_arc(
    position: Float[Array, "*n 2"], yaw: Float[Array, "*n"], traveled: Float[Array, "*n"], turned: Float[Array, "*n"]
) -> Float[Array, "*n 2"]:
    """Position and direction at the end of a circular arc.

    The chord of an arc of length s that turns by a has length s sin(a / 2) / (a / 2) and the direction half-way through
    the turn. This is exact for every turn, including 0.
    """
    # jnp.sinc(x) is sin(pi x) / (pi x), and 1 at 0.
    chord = traveled * jnp.sinc(turned / (2 * jnp.pi))
    direction = yaw + turned / 2
    return position + chord[..., None] * jnp.stack([jnp.cos(direction), jnp.sin(direction)], axis=-1)


def drive(
    state: VehicleState, command: Float[Array, "2"], limits: VehicleLimits, seconds: float = CONTROL_PERIOD
) -> VehicleState:
    """The vehicle after `seconds` under one command.

    The model changes speed and turn rate at once, as far as the accelerations allow in that time, and then drives the
    arc.

    Args:
      state: state of the vehicle.
      command: desired speed (meters per second) and turn rate (radians per second).
      limits: limits of the vehicle.
      seconds: duration.
    """
    speed, turn_rate = reachable_command(state, command, limits, seconds)
    return VehicleState(
        position=_along_arc(state.position, state.yaw, speed * seconds, turn_rate * seconds),
        yaw=wrapped(state.yaw + turn_rate * seconds),
        speed=speed,
        turn_rate=turn_rate,
    )
