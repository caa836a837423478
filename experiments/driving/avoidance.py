"""Collision avoidance with static obstacles and people, independent of the planner of the path.

Avoidance has two parts. `detour` looks ahead: if the straight line to the next point meets a person within a short
horizon, it takes the nearest direction that does not (velocity obstacles: P. Fiorini and Z. Shiller, "Motion planning
in dynamic environments using velocity obstacles", 1998). `avoid` guards the command: of the commands that the vehicle
can reach within one period, it takes the admissible one nearest to the desired one. A command is admissible if the
vehicle can brake to a stop after it with its footprint on allowed ground and without touching anybody (D. Fox,
W. Burgard and S. Thrun, "The dynamic window approach to collision avoidance", 1997). A person is assumed anywhere
between standing still from now on and walking on as before, plus a margin that grows with time.

Braking is one of the commands, so an admissible command is always followed by another one. The vehicle therefore
touches no static obstacle, whatever the desired commands are, along the whole path and not only at the ends of periods.

All functions take one vehicle; use `jax.vmap` for batches.
"""

import math

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float

from dc2g_jax.robot.driving.footprint import Ground, blocked_around, clearance
from dc2g_jax.robot.driving.vehicle import (
    CONTROL_PERIOD,
    VehicleLimits,
    VehicleState,
    drive,
    reachable_command,
    wrapped,
)
from experiments.driving.following import Path, aim, steer
from experiments.driving.lines import free_straight, needed_clearance

#: Numbers of speeds and turn rates that are tried, evenly spaced over the reachable ones.
_SPEEDS, _TURN_RATES = 5, 9

#: Clearance from people, meters, and growth of a person's possible deviation from the prediction, meters per second.
_MARGIN, _GROWTH = 0.05, 0.2

#: Number of directions that a detour may take, evenly spaced over both sides, and the largest angle to the desired
#: direction, radians.
_DIRECTIONS, _WIDEST = 25, 1.8

#: Time within which a direction must not meet anybody, seconds, and the number of moments that are checked in it.
_HORIZON, _MOMENTS = 2.5, 10

#: Additional angle of a detour that passes somebody so closely that the vehicle must slow down, radians.
_SQUEEZE = 0.6

#: Weight of a detour's angle to the vehicle's yaw relative to its angle to the desired direction.
_STEADINESS = 0.2


@struct.dataclass
class People:
    """People that the vehicle knows of.

    Attributes:
      positions: centers of the people, meters; entries that only pad the array are far away.
      velocities: velocities, meters per second.
      radius: radius of the circle that a person occupies, meters.
    """

    positions: Float[Array, "people 2"]
    velocities: Float[Array, "people 2"]
    radius: float = struct.field(pytree_node=False)


def navigate(
    state: VehicleState, path: Path, ground: Ground, people: People, limits: VehicleLimits
) -> Float[Array, "2"]:
    """The command that follows a path past people: speed (meters per second) and turn rate (radians per second)."""
    target = detour(state, aim(state, path, ground, limits), ground, people, limits)
    return avoid(state, steer(state, target, path, limits), ground, people, limits)


def detour(
    state: VehicleState, target: Float[Array, "2"], ground: Ground, people: People, limits: VehicleLimits,
) -> Float[Array, "2"]:  # fmt: skip
    """The point to drive to straight so as to meet nobody: the target if it is free or if no direction is better."""
    offset = target - state.position
    bearing = jnp.arctan2(offset[1], offset[0])
    aside = jnp.linspace(-_WIDEST, _WIDEST, _DIRECTIONS)
    bearings = bearing + aside
    directions = jnp.stack([jnp.cos(bearings), jnp.sin(bearings)], axis=-1)
    # People matter as far as the vehicle gets within the horizon; obstacles matter within its braking distance.
    reach = limits.max_speed**2 / (2 * limits.max_acceleration)
    distance = jnp.minimum(jnp.linalg.norm(offset), reach)
    around = blocked_around(ground, state.position, reach + limits.radius)
    pace = (state.speed + limits.max_speed) / 2

    def gap(direction: Float[Array, "2"]) -> Float[Array, ""]:
        """Smallest distance to any person along a direction, meters."""
        time = _HORIZON * (1 + jnp.arange(_MOMENTS)) / _MOMENTS
        driven = jnp.minimum(pace * time, jnp.linalg.norm(offset))
        apart = (state.position + driven[:, None] * direction)[:, None] - people.positions
        apart -= time[:, None, None] * people.velocities
        nearest = jnp.sqrt(jnp.min(apart[..., 0] ** 2 + apart[..., 1] ** 2, initial=jnp.inf))
        return nearest - limits.radius - people.radius - _MARGIN

    # What `avoid` asks for at full speed.
    roomy = _GROWTH * limits.max_speed / limits.max_acceleration
    gaps = jax.vmap(gap)(directions)
    free = (gaps > 0) & free_straight(state.position, distance * directions, around, limits.radius)
    cost = jnp.abs(aside) + _STEADINESS * jnp.abs(wrapped(bearings - state.yaw))
    cost += jnp.where(gaps > roomy, 0, _SQUEEZE)
    best = jnp.argmin(jnp.where(free, cost, jnp.inf))
    needless = ~jnp.any(free) | (gap(offset / jnp.maximum(jnp.linalg.norm(offset), 1e-6)) > roomy)
    return jnp.where(needless, target, state.position + distance * directions[best])


def braking(state: VehicleState, limits: VehicleLimits) -> Float[Array, "2"]:
    """The command that brakes as hard as possible along the same curve."""
    speed = jnp.maximum(state.speed - limits.max_acceleration * CONTROL_PERIOD, 0)
    return jnp.stack([speed, state.turn_rate * speed / jnp.maximum(state.speed, 1e-6)])


def avoid(
    state: VehicleState, wished: Float[Array, "2"], ground: Ground, people: People, limits: VehicleLimits,
) -> Float[Array, "2"]:  # fmt: skip
    """The admissible command nearest to the desired one; braking if there is none.

    Args:
      state: state of the vehicle.
      wished: desired speed (meters per second) and turn rate (radians per second).
      ground: allowed ground of the footprint. A vehicle that already touches other cells may move as long as it does
        not go deeper into them.
      people: people around the vehicle.
      limits: limits of the vehicle.
    """
    commands = _commands(state, wished, limits)
    path, start = _braking_paths(state, commands, limits), state.position
    admissible = _stays_on_ground(start, path, ground, limits) & _touches_nobody(start, path, people, limits)
    change = (commands - commands[0]) / jnp.array([limits.max_speed, limits.max_turn_rate], jnp.float32)
    best = jnp.argmin(jnp.where(admissible, jnp.sum(change**2, axis=-1), jnp.inf))
    return jnp.where(jnp.any(admissible), commands[best], commands[1])


def _commands(state: VehicleState, wished: Float[Array, "2"], limits: VehicleLimits) -> Float[Array, "commands 2"]:
    """Reachable commands: the one nearest to the desired one, then braking, then a grid over all reachable ones."""

    def within_reach(command: Float[Array, "2"]) -> Float[Array, "2"]:
        return reachable_command(state, command, limits, CONTROL_PERIOD)

    lowest, highest = (within_reach(jnp.full(2, bound, jnp.float32)) for bound in (-jnp.inf, jnp.inf))
    speeds = jnp.linspace(lowest[0], highest[0], _SPEEDS)
    turn_rates = jnp.linspace(lowest[1], highest[1], _TURN_RATES)
    grid = jnp.stack(jnp.meshgrid(speeds, turn_rates), axis=-1).reshape(-1, 2)
    return jnp.concatenate([jnp.stack([within_reach(wished), within_reach(braking(state, limits))]), grid])


def _periods(limits: VehicleLimits) -> int:
    """Largest number of periods until the vehicle has stopped."""
    # A hair less, so that rounding adds no period.
    return 1 + math.ceil(limits.max_speed / (limits.max_acceleration * CONTROL_PERIOD) - 1e-6)


def _braking_paths(state: VehicleState, commands: Float[Array, "commands 2"], limits: VehicleLimits) -> VehicleState:
    """The vehicle after a period under each command, and after each period of braking to a stop from then on.

    Its leaves are `[periods commands ...]`.
    """

    def brake(before: VehicleState, _: None) -> tuple[VehicleState, VehicleState]:
        after = jax.vmap(lambda one: drive(one, braking(one, limits), limits))(before)
        return after, after

    first = jax.vmap(drive, in_axes=(None, 0, None))(state, commands, limits)
    _, later = jax.lax.scan(brake, first, length=_periods(limits) - 1)
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), first, later)


def _stays_on_ground(
    start: Float[Array, "2"], path: VehicleState, ground: Ground, limits: VehicleLimits
) -> Bool[Array, "commands"]:
    """Whether the footprint stays on allowed ground along the whole path, from its start on."""
    longest = limits.max_speed * CONTROL_PERIOD * (_periods(limits) + 1) / 2
    around = blocked_around(ground, start, longest + limits.radius)
    now = clearance(start, around)
    needed = needed_clearance(limits.radius, path.speed * CONTROL_PERIOD, path.turn_rate * CONTROL_PERIOD, now)
    # A period begins where one ends that is at least as long and as bent, and needs as much clearance.
    return jnp.all(clearance(path.position, around) >= needed, axis=0) & (now >= needed[0])


def _touches_nobody(
    start: Float[Array, "2"], path: VehicleState, people: People, limits: VehicleLimits
) -> Bool[Array, "commands"]:
    """Whether the footprint keeps clear of everybody while the vehicle moves, at all their possible positions.

    People are expected to walk around a vehicle that has stopped.
    """
    places = jnp.concatenate([jnp.broadcast_to(start, (1, *path.position.shape[1:])), path.position])
    x, y = places[..., 0], places[..., 1]
    of_arcs = path.speed * CONTROL_PERIOD, path.turn_rate * CONTROL_PERIOD
    traveled, turned = (jnp.concatenate([values[:1], values]) for values in of_arcs)
    # Where a period ends, the next one begins: everybody may have come as far as they do until that is over.
    time = CONTROL_PERIOD * (1 + jnp.arange(len(places), dtype=jnp.float32))[:, None]

    def clear_of(clear: Array, person: tuple[Array, Array]) -> tuple[Array, None]:
        position, velocity = person
        apart = people.radius + _MARGIN
        now = jnp.linalg.norm(position - start) - apart
        off_x, off_y = x - position[0], y - position[1]
        speed_squared = jnp.maximum(jnp.sum(velocity**2), 1e-6)
        since = jnp.clip((off_x * velocity[0] + off_y * velocity[1]) / speed_squared, 0, time)
        squared = (off_x - since * velocity[0]) ** 2 + (off_y - since * velocity[1]) ** 2
        needed = needed_clearance(limits.radius, traveled, turned, now) + apart + _GROWTH * time
        return clear & ((squared >= needed**2) | (traveled == 0)), None

    clear, _ = jax.lax.scan(clear_of, jnp.ones(x.shape, bool), (people.positions, people.velocities))
    return jnp.all(clear, axis=0)
