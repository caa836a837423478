"""What all simulated robots share: a vehicle with a camera, and an episode of control periods."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax.sharding import Mesh
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Int, Key, UInt32

from dc2g_jax.robot.driving.footprint import Ground, blocked_around, clearance
from dc2g_jax.robot.driving.vehicle import VehicleState
from dc2g_jax.runtime import batched, deal, gather, jit, mesh_of, not_repeated, on_each, replicate, serve_paced

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


#: `(key, what it has of its own, site, components, a number that sets shapes) ->` the robot at its start.
Reset = Callable[[Any, Any, Any, Any, int], Any]

#: `(robot, site, components) ->` the robot one control period later, or some.
Step = Callable[[Any, Any, Any], Any]


def is_driving(robot: SimulatedRobot, limit: ArrayLike) -> Bool[Array, ""]:
    """Whether the episode has not ended and lasts less than `limit` control periods so far."""
    return (robot.status == DRIVING) & (robot.periods < limit)


def stopped_by_obstacles(
    before: VehicleState, after: VehicleState, ground: Ground, radius: float
) -> tuple[VehicleState, Bool[Array, ""]]:
    """Keep a vehicle from driving into obstacles: it stays where it was and loses its speed.

    It still turns, because a circular footprint covers no new ground. A vehicle that already touches an obstacle may
    move away from it.

    Returns:
      The vehicle at the end of the period, and whether it was stopped.
    """
    around = blocked_around(ground, before.position, radius + 2 * ground.cell_size)
    now, then = clearance(jnp.stack([before.position, after.position]), around)
    bumped = (then < radius) & (then < now)
    position, speed = jnp.where(bumped, before.position, after.position), jnp.where(bumped, 0, after.speed)
    return dataclasses.replace(after, position=position, speed=speed), bumped


def run_all(
    reset: Reset,
    step: Step,
    results: Callable[[Any], Any],
    own: Any,
    where: Int[Any, "robots"],
    sites: Any,
    components: Any,
    *,
    number: int,
    limit: int,
    first_steps: int,
    seed: int = 0,
    on_progress: Callable[[int], None] | None = None,
) -> Any:
    """Run robots to the ends of their episodes, on all devices.

    Args:
      reset: a function of a module, for which programs are compiled once, like `step`.
      step: see `Step`.
      results: what is returned of the robots.
      own: what each robot has of its own, stacked.
      where: number of each robot's site.
      sites: stacked sites.
      components: components of the robots.
      number: a number that sets shapes, for `reset`.
      limit: control periods after which an episode ends.
      first_steps: steps of the first call of the device.
      seed: seed of the robots' random keys.
      on_progress: called now and then with the number of episodes that have ended.
    """
    mesh, count = mesh_of(), len(where)
    keys = jax.random.key_data(jax.random.split(jax.random.key(seed), count))
    sites, components = replicate((sites, components), mesh)
    keys, own, where = deal((keys, own, where), count, mesh)
    robots = _at_starts(where, keys, own, sites, components, mesh=mesh, reset=reset, number=number)
    go_on = functools.partial(_go_on, where, not_repeated(count, mesh), sites, components, limit, mesh=mesh, step=step)
    return gather(results(serve_paced(robots, go_on, count, on_progress, first_steps=first_steps)), count)


@functools.partial(jit, static_argnames=("mesh", "reset", "number"))
def _at_starts(
    where: Int[Array, "devices own"], keys: UInt32[Array, "devices own key"], own: Any, sites: Any, components: Any,
    *, mesh: Mesh, reset: Reset, number: int,
) -> Any:  # fmt: skip
    """Robots at their starts, dealt out to all devices."""

    def on_device(dealt: tuple[Array, Array, Any], sites: Any, components: Any) -> Any:
        def one(place: Array, key: Array, own: Any) -> Any:
            site = jax.tree.map(lambda leaf: leaf[place], sites)
            return reset(jax.random.wrap_key_data(key), own, site, components, number)

        return batched(mesh)(one)(*dealt)

    return on_each(on_device, mesh, (where, keys, own), sites, components)


@functools.partial(jit, static_argnames=("mesh", "step"), donate_argnames=("robots",))
def _go_on(
    where: Int[Array, "devices own"], wanted: Bool[Array, "devices own"], sites: Any, components: Any, limit: ArrayLike,
    robots: SimulatedRobot, steps: ArrayLike, *, mesh: Mesh, step: Step,
) -> tuple[SimulatedRobot, Int[Array, "devices"]]:  # fmt: skip
    """Every robot so many steps later, or at the end of its episode; and how many of those wanted have ended."""

    def on_device(own: tuple[Array, Any], sites: Any, components: Any, limit: Array, steps: Array) -> Any:
        def one(number: Array, robot: Any) -> Any:
            site = jax.tree.map(lambda leaf: leaf[number], sites)
            return jax.lax.while_loop(
                lambda carry: is_driving(carry[0], limit) & (carry[1] < steps),
                lambda carry: (step(carry[0], site, components), carry[1] + 1),
                (robot, jnp.int32(0)),
            )[0]

        return batched(mesh)(one)(*own)

    robots = on_each(on_device, mesh, (where, robots), sites, components, jnp.asarray(limit), jnp.asarray(steps))
    goes_on = jax.vmap(jax.vmap(lambda robot: is_driving(robot, limit)))(robots)
    return robots, jnp.sum(wanted & ~goes_on, axis=1)
