"""The vehicle: a unicycle with a circular footprint and limits on how fast it drives, turns and changes either.

It drives in the ground plane of the world of `dc2g_jax.mapping.camera`: meters, x along the map's columns, y against
its rows, yaw counter-clockwise from +x. It never drives backwards, where its camera does not look; turning on the spot,
a circular footprint covers no new ground, so it can always face about.

All functions are for one vehicle; `jax.vmap` makes them take many.
"""

import dataclasses

import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from dc2g_jax.errors import InputError

#: Seconds between two commands, 10 Hz.
CONTROL_PERIOD = 0.1


@struct.dataclass
class VehicleState:
    """Where a vehicle is and how it moves.

    Attributes:
      position: of the footprint's center, meters.
      yaw: where it faces, counter-clockwise from +x, radians, -pi to pi.
      speed: ahead, meters per second.
      turn_rate: counter-clockwise, radians per second.
    """

    position: Float[Array, "2"]
    yaw: Float[Array, ""]
    speed: Float[Array, ""]
    turn_rate: Float[Array, ""]


@struct.dataclass
class VehicleLimits:
    """What a vehicle can do: by default about what a sidewalk delivery robot can. Known when programs are compiled.

    Attributes:
      max_speed: ahead, meters per second.
      max_turn_rate: either way, radians per second.
      max_acceleration: speeding up and braking, meters per second squared.
      max_turn_acceleration: of the turn rate, either way, radians per second squared.
      radius: of the footprint, meters.

    Raises:
      InputError: a limit is not above 0.
    """

    max_speed: float = struct.field(pytree_node=False, default=1.5)
    max_turn_rate: float = struct.field(pytree_node=False, default=2.0)
    max_acceleration: float = struct.field(pytree_node=False, default=1.5)
    max_turn_acceleration: float = struct.field(pytree_node=False, default=8.0)
    radius: float = struct.field(pytree_node=False, default=0.3)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if not getattr(self, field.name) > 0:
                raise InputError(f"{field.name} of the vehicle is {getattr(self, field.name)}; give a number above 0")


def at_rest(position: ArrayLike, yaw: ArrayLike) -> VehicleState:
    """A vehicle that stands.

    Args:
      position: x and y, meters.
      yaw: where it faces, radians.
    """
    still = jnp.float32(0)
    return VehicleState(
        position=jnp.asarray(position, jnp.float32),
        yaw=wrapped(jnp.asarray(yaw, jnp.float32)),
        speed=still,
        turn_rate=still,
    )


def wrapped(angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The same angle, radians, at least -pi and below pi."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi


def reachable_command(
    state: VehicleState, command: Float[Array, "2"], limits: VehicleLimits, seconds: float
) -> Float[Array, "2"]:
    """What a vehicle makes of a command: the nearest speed and turn rate that its limits let it reach in `seconds`."""
    speed_change, turn_change = limits.max_acceleration * seconds, limits.max_turn_acceleration * seconds
    speed = jnp.clip(command[0], state.speed - speed_change, state.speed + speed_change)
    turn_rate = jnp.clip(command[1], state.turn_rate - turn_change, state.turn_rate + turn_change)
    return jnp.stack(
        [
            jnp.clip(speed, 0, limits.max_speed),
            jnp.clip(turn_rate, -limits.max_turn_rate, limits.max_turn_rate),
        ]
    )


def along_arc(
    position: Float[Array, "*n 2"], yaw: Float[Array, "*n"], traveled: Float[Array, "*n"], turned: Float[Array, "*n"]
) -> Float[Array, "*n 2"]:
    """Where the arc of a circle ends.

    The chord of an arc of length s that turns by a is s sin(a / 2) / (a / 2) long and points half-way through the turn.
    That is exact for every turn, none included.

    Args:
      position: where it begins, meters.
      yaw: its direction there, radians.
      traveled: its length, meters.
      turned: by how much its direction turns, radians.
    """
    # jnp.sinc(x) is sin(pi x) / (pi x), and 1 at 0.
    chord = traveled * jnp.sinc(turned / (2 * jnp.pi))
    direction = yaw + turned / 2
    return position + chord[..., None] * jnp.stack([jnp.cos(direction), jnp.sin(direction)], axis=-1)


def drive(
    state: VehicleState, command: Float[Array, "2"], limits: VehicleLimits, seconds: float = CONTROL_PERIOD
) -> VehicleState:
    """The vehicle after `seconds` under one command.

    It takes on the speed and turn rate at once, as far as its accelerations allow in that time, and drives the arc.

    Args:
      state: of the vehicle.
      command: wished speed (meters per second) and turn rate (radians per second).
      limits: of the vehicle.
      seconds: for how long.
    """
    speed, turn_rate = reachable_command(state, command, limits, seconds)
    return VehicleState(
        position=along_arc(state.position, state.yaw, speed * seconds, turn_rate * seconds),
        yaw=wrapped(state.yaw + turn_rate * seconds),
        speed=speed,
        turn_rate=turn_rate,
    )
