"""What all simulated robots share: a vehicle with a camera, and an episode of control periods."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from flax import struct
from jax.sharding import Mesh
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Int, Key, UInt32

from dc2g_jax._src.programs import jit
from dc2g_jax._src.rollouts.devices import batched, mesh_of, not_repeated, on_each, serve_paced
from dc2g_jax._src.vehicles.footprint import Ground, clearance, surroundings
from dc2g_jax._src.vehicles.vehicle import VehicleState

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


_Robot = TypeVar("_Robot", bound=SimulatedRobot)

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


@functools.partial(jit, static_argnames=("mesh", "reset", "number"))
def at_starts(
    keys: UInt32[Array, "devices own key"], own: Any, shared: Any, *, mesh: Mesh, reset: Callable[..., Any], number: int
) -> Any:
    """Robots at their starts, dealt out to all devices.

    Args:
      keys: key of each robot, as data.
      own: what each robot has of its own, `[devices own ...]`.
      shared: what all robots share.
      mesh: the devices.
      reset: a function of a module, for which programs are compiled once: `(key, own, shared, number) ->` the robot.
      number: a number that sets shapes, for `reset`.
    """

    def on_device(dealt: tuple[Array, Any], shared: Any) -> Any:
        def one(key: Array, own: Any) -> Any:
            return reset(jax.random.wrap_key_data(key), own, shared, number)

        return batched(mesh)(one)(*dealt)

    return on_each(on_device, mesh, (keys, own), shared)


def run_to_end(
    robots: _Robot,
    step: Step,
    where: Int[Array, "devices own"],
    sites: Any,
    components: Any,
    *,
    limit: int,
    count: int,
    first_steps: int,
    on_progress: Callable[[int], None] | None = None,
) -> _Robot:
    """Run robots that are dealt out to all devices to the ends of their episodes.

    Args:
      robots: the robots at their starts, `[devices own ...]`.
      step: a function of a module, for which programs are compiled once.
      where: number of each robot's site.
      sites: stacked sites.
      components: components of the robots.
      limit: control periods after which an episode ends.
      count: number of robots without repetitions.
      first_steps: steps of the first call of the device.
      on_progress: called now and then with the number of episodes that have ended.
    """
    mesh = mesh_of()
    go_on = functools.partial(_go_on, where, not_repeated(count, mesh), sites, components, limit, mesh=mesh, step=step)
    return serve_paced(robots, go_on, count, on_progress, first_steps=first_steps)


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
