"""Keeping clear of walls, lawn and people, beside whatever planned the path.

Two parts. `detour` looks ahead: if the straight way to the next point meets a person, it takes the direction next to it
that does not, in the short run (velocity obstacles: P. Fiorini and Z. Shiller, "Motion planning in dynamic environments
using velocity obstacles", 1998). `avoid` guards the command: of all that the vehicle can reach within one period, it
takes the admissible one next to what is wished for. Admissible is after what the vehicle can still brake to a stand
with its footprint on the ground where it may be, touching nobody (D. Fox, W. Burgard and S. Thrun, "The dynamic window
approach to collision avoidance", 1997). There a person may be anywhere between standing still from now on and walking
on as before, and somewhat aside of that.

Braking is itself one of the commands, so whoever begins with an admissible one always has the next: the vehicle touches
nothing that stands, whatever is wished for. That holds for the whole way, not only where a period ends.

All functions are for one vehicle; `jax.vmap` makes them take many.
"""

import math

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float

from dc2g_jax.vehicles.following import Following, Path, aim, steer
from dc2g_jax.vehicles.footprint import Ground, clearance, free_straight, needed_clearance, surroundings
from dc2g_jax.vehicles.vehicle import CONTROL_PERIOD, VehicleLimits, VehicleState, drive, reachable_command, wrapped


@struct.dataclass
class People:
    """Who is around, as far as the vehicle knows.

    Attributes:
      positions: of their middles, meters; far away those that only fill up the array.
      velocities: meters per second.
      radius: of the circle that each of them takes up, meters.
    """

    positions: Float[Array, "people 2"]
    velocities: Float[Array, "people 2"]
    radius: float = struct.field(pytree_node=False)


@struct.dataclass
class Avoidance:
    """How to keep clear.

    Attributes:
      speeds: how many speeds are tried, evenly over those that can be reached.
      turn_rates: how many turn rates.
      margin: clearance from people, meters.
      growth: how fast a person may turn aside of what is predicted, meters per second.
      directions: how many directions a detour may take, evenly over both sides.
      widest: furthest of them aside of the wished one, radians.
      horizon: how far ahead it matters whom a direction meets, seconds.
      looks: how many moments of that are looked at.
      squeeze: how much further aside a detour may be than one past somebody so near that it must slow down, radians.
      steadiness: how much an angle aside of the vehicle's yaw counts beside one aside of the wished direction.
    """

    speeds: int = struct.field(pytree_node=False, default=5)
    turn_rates: int = struct.field(pytree_node=False, default=9)
    margin: float = struct.field(pytree_node=False, default=0.05)
    growth: float = struct.field(pytree_node=False, default=0.2)
    directions: int = struct.field(pytree_node=False, default=25)
    widest: float = struct.field(pytree_node=False, default=1.8)
    horizon: float = struct.field(pytree_node=False, default=2.5)
    looks: int = struct.field(pytree_node=False, default=10)
    squeeze: float = struct.field(pytree_node=False, default=0.6)
    steadiness: float = struct.field(pytree_node=False, default=0.2)


def navigate(
    state: VehicleState, path: Path, ground: Ground, people: People, limits: VehicleLimits,
    following: Following | None = None, avoidance: Avoidance | None = None,
) -> Float[Array, "2"]:  # fmt: skip
    """The command that follows a path past people: speed (meters per second) and turn rate (radians per second).

    Args:
      state: of the vehicle.
      path: where to drive.
      ground: where its footprint may be.
      people: who is around.
      limits: of the vehicle.
      following: how the path is followed; None for the usual way.
      avoidance: how to keep clear; None for the usual way.
    """
    following = Following() if following is None else following
    avoidance = Avoidance() if avoidance is None else avoidance
    target = aim(state, path, ground, limits, following)
    target = detour(state, target, ground, people, limits, avoidance)
    return avoid(state, steer(state, target, path, limits, following), ground, people, limits, avoidance)


def detour(
    state: VehicleState, target: Float[Array, "2"], ground: Ground, people: People, limits: VehicleLimits,
    avoidance: Avoidance,
) -> Float[Array, "2"]:  # fmt: skip
    """Where to drive straight instead, so as to meet nobody: the target itself if it can be, or if nowhere is better.

    Args:
      state: of the vehicle.
      target: where it would go, meters.
      ground: where its footprint may be.
      people: who is around, taken to walk on as they do.
      limits: of the vehicle.
      avoidance: how to keep clear.
    """
    offset = target - state.position
    bearing = jnp.arctan2(offset[1], offset[0])
    aside = jnp.linspace(-avoidance.widest, avoidance.widest, avoidance.directions)
    bearings = bearing + aside
    directions = jnp.stack([jnp.cos(bearings), jnp.sin(bearings)], axis=-1)
    # As far as the vehicle would get within the horizon, it is people that matter; walls do as far as it can brake.
    reach = limits.max_speed**2 / (2 * limits.max_acceleration)
    distance = jnp.minimum(jnp.linalg.norm(offset), reach)
    around = surroundings(ground, state.position, reach + limits.radius)
    pace = (state.speed + limits.max_speed) / 2

    def gap(direction: Float[Array, "2"]) -> Float[Array, ""]:
        """How near it comes to anybody, meters."""
        time = avoidance.horizon * (1 + jnp.arange(avoidance.looks)) / avoidance.looks
        driven = jnp.minimum(pace * time, jnp.linalg.norm(offset))
        apart = (state.position + driven[:, None] * direction)[:, None] - people.positions
        apart -= time[:, None, None] * people.velocities
        nearest = jnp.sqrt(jnp.min(apart[..., 0] ** 2 + apart[..., 1] ** 2, initial=jnp.inf))
        return nearest - limits.radius - people.radius - avoidance.margin

    # What `avoid` asks for at full speed.
    roomy = avoidance.growth * limits.max_speed / limits.max_acceleration
    gaps = jax.vmap(gap)(directions)
    free = (gaps > 0) & free_straight(state.position, distance * directions, around, limits.radius)
    cost = jnp.abs(aside) + avoidance.steadiness * jnp.abs(wrapped(bearings - state.yaw))
    cost += jnp.where(gaps > roomy, 0, avoidance.squeeze)
    best = jnp.argmin(jnp.where(free, cost, jnp.inf))
    needless = ~jnp.any(free) | (gap(offset / jnp.maximum(jnp.linalg.norm(offset), 1e-6)) > roomy)
    return jnp.where(needless, target, state.position + distance * directions[best])


def braking(state: VehicleState, limits: VehicleLimits) -> Float[Array, "2"]:
    """The command that slows down as fast as possible, along the same curve."""
    speed = jnp.maximum(state.speed - limits.max_acceleration * CONTROL_PERIOD, 0)
    return jnp.stack([speed, state.turn_rate * speed / jnp.maximum(state.speed, 1e-6)])


def avoid(
    state: VehicleState, wished: Float[Array, "2"], ground: Ground, people: People, limits: VehicleLimits,
    avoidance: Avoidance,
) -> Float[Array, "2"]:  # fmt: skip
    """The admissible command next to the wished one; braking if there is none.

    Args:
      state: of the vehicle.
      wished: speed (meters per second) and turn rate (radians per second).
      ground: where the footprint may be. A vehicle that touches other cells already may drive where it touches them
        no more deeply.
      people: who is around.
      limits: of the vehicle.
      avoidance: how to keep clear.
    """
    commands = _commands(state, wished, limits, avoidance)
    ways = _ways_to_a_stand(state, commands, limits)
    admissible = _stays_on_ground(ways, ground, limits) & _touches_nobody(ways, people, limits, avoidance)
    change = (commands - commands[0]) / jnp.array([limits.max_speed, limits.max_turn_rate], jnp.float32)
    best = jnp.argmin(jnp.where(admissible, jnp.sum(change**2, axis=-1), jnp.inf))
    return jnp.where(jnp.any(admissible), commands[best], commands[1])


def _commands(
    state: VehicleState, wished: Float[Array, "2"], limits: VehicleLimits, avoidance: Avoidance
) -> Float[Array, "commands 2"]:
    """Commands within reach: the wished one, as far as it is, then braking, then a grid over all."""

    def within_reach(command: Float[Array, "2"]) -> Float[Array, "2"]:
        return reachable_command(state, command, limits, CONTROL_PERIOD)

    lowest, highest = (within_reach(jnp.full(2, bound, jnp.float32)) for bound in (-jnp.inf, jnp.inf))
    speeds = jnp.linspace(lowest[0], highest[0], avoidance.speeds)
    turn_rates = jnp.linspace(lowest[1], highest[1], avoidance.turn_rates)
    grid = jnp.stack(jnp.meshgrid(speeds, turn_rates), axis=-1).reshape(-1, 2)
    return jnp.concatenate([jnp.stack([within_reach(wished), within_reach(braking(state, limits))]), grid])


@struct.dataclass
class _Ways:
    """One period under each command, and then braking to a stand.

    Attributes:
      start: where all begin, meters.
      ends: where each period ends, meters.
      traveled: length of its arc, meters.
      turned: its turn, radians.
    """

    start: Float[Array, "2"]
    ends: Float[Array, "periods commands 2"]
    traveled: Float[Array, "periods commands"]
    turned: Float[Array, "periods commands"]


def _periods(limits: VehicleLimits) -> int:
    """How many periods a way to a stand takes at most."""
    # A hair less, so that rounding adds no period.
    return 1 + math.ceil(limits.max_speed / (limits.max_acceleration * CONTROL_PERIOD) - 1e-6)


def _ways_to_a_stand(state: VehicleState, commands: Float[Array, "commands 2"], limits: VehicleLimits) -> _Ways:
    """Where each command leads if nothing but braking follows it."""

    def brake(before: VehicleState, _: None) -> tuple[VehicleState, VehicleState]:
        after = jax.vmap(lambda one: drive(one, braking(one, limits), limits))(before)
        return after, after

    first = jax.vmap(drive, in_axes=(None, 0, None))(state, commands, limits)
    _, later = jax.lax.scan(brake, first, length=_periods(limits) - 1)
    states = jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), first, later)
    return _Ways(
        start=state.position,
        ends=states.position,
        traveled=states.speed * CONTROL_PERIOD,
        turned=states.turn_rate * CONTROL_PERIOD,
    )


def _stays_on_ground(ways: _Ways, ground: Ground, limits: VehicleLimits) -> Bool[Array, "commands"]:
    """Does the footprint stay where it may be, all the way?"""
    longest = limits.max_speed * CONTROL_PERIOD * (_periods(limits) + 1) / 2
    around = surroundings(ground, ways.start, longest + limits.radius)
    now = clearance(ways.start, around)
    needed = needed_clearance(limits.radius, ways.traveled, ways.turned, now)
    # A period begins where one ends that is at least as long and as bent, and needs as much clearance.
    return jnp.all(clearance(ways.ends, around) >= needed, axis=0) & (now >= needed[0])


def _touches_nobody(
    ways: _Ways, people: People, limits: VehicleLimits, avoidance: Avoidance
) -> Bool[Array, "commands"]:
    """Does the footprint keep clear of everybody while the vehicle moves, wherever they are between here and there?

    Once it stands, it is for them to walk around it.
    """
    starts = jnp.broadcast_to(ways.start, (1, *ways.ends.shape[1:]))
    places = jnp.concatenate([starts, ways.ends])
    x, y = places[..., 0], places[..., 1]
    traveled, turned = (jnp.concatenate([values[:1], values]) for values in (ways.traveled, ways.turned))
    # Where a period ends, the next one begins: everybody may have come as far as they do until that is over.
    time = CONTROL_PERIOD * (1 + jnp.arange(len(places), dtype=jnp.float32))[:, None]

    def clear_of(clear: Array, person: tuple[Array, Array]) -> tuple[Array, None]:
        position, velocity = person
        apart = people.radius + avoidance.margin
        now = jnp.linalg.norm(position - ways.start) - apart
        off_x, off_y = x - position[0], y - position[1]
        speed_squared = jnp.maximum(jnp.sum(velocity**2), 1e-6)
        since = jnp.clip((off_x * velocity[0] + off_y * velocity[1]) / speed_squared, 0, time)
        squared = (off_x - since * velocity[0]) ** 2 + (off_y - since * velocity[1]) ** 2
        needed = needed_clearance(limits.radius, traveled, turned, now) + apart + avoidance.growth * time
        return clear & ((squared >= needed**2) | (traveled == 0)), None

    clear, _ = jax.lax.scan(clear_of, jnp.ones(x.shape, bool), (people.positions, people.velocities))
    return jnp.all(clear, axis=0)
