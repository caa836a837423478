"""Environment steps alone, random actions: ours, and those of other gridworlds in JAX."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.runtime.devices import cores

from ..baselines import environments
from ..baselines.environments import Environment
from .bench import SENSING_RANGE, Bench, own
from .programs import compile_program
from .rows import Row, growing

ENVIRONMENT_UNIT = "environment steps"

#: Steps of every environment in one call, after a reset that is timed with them and not counted: so the others are
#: usually measured, and so the compiler sees what is the same in all environments of a batch.
_STEPS = 32


def _stepped(bench: Bench, row: Row, batch: int, run: Callable[..., Any], *starts: Any) -> Row:
    """The row of a program that takes random actions, [steps batch], the same for everyone, from its starts."""
    actions = jnp.asarray(np.random.default_rng(0).integers(3, size=(_STEPS, batch)), jnp.int32)
    program, _ = compile_program(run, *starts, actions)
    return row.with_figures(bench.measure(lambda: program(*starts, actions)), float(_STEPS * batch))


def own_steps(bench: Bench, row: Row, batch: int) -> Row:
    """Steps of this package's gridworld in the benchmark's houses."""
    robots = bench.robots("frontier").batch(batch)
    sensing = bench.rules().sensing

    def run(world: World, pose: Pose, actions: jax.Array) -> Belief:
        def step(belief: Belief, action: jax.Array) -> tuple[Belief, None]:
            return gridworld.step(world, belief, action, sensing), None

        return jax.lax.scan(step, gridworld.reset(world, pose, sensing), actions)[0]

    return _stepped(bench, row, batch, run, robots.world, robots.belief.pose)


def _peer_steps(bench: Bench, make: Callable[[int, int], Environment], row: Row, batch: int) -> Row:
    environment = make(batch, bench.workload.cells)

    def run(key: jax.Array, actions: jax.Array) -> Any:
        def step(states: Any, action: jax.Array) -> tuple[Any, None]:
            return environment.step(states, action), None

        return environment.outcome(jax.lax.scan(step, environment.reset(key), actions)[0])

    return _stepped(bench, row, batch, run, jax.random.key(0))


def peers(bench: Bench, section: str, batches: Sequence[int]) -> Iterator[Row]:
    """Other environments with the same batches and side."""
    cells = bench.workload.cells
    view = 2 * SENSING_RANGE + 1
    made: dict[str, Callable[[int, int], Environment]] = {
        f"XLand-MiniGrid ({view} x {view} view)": functools.partial(environments.xland_minigrid, view=view),
        "NAVIX (first-person view)": environments.navix,
        "NAVIX (no observation)": functools.partial(environments.navix, observed=False),
    }
    for name, make in made.items():
        row = Row(section, "random actions", by=name, unit=ENVIRONMENT_UNIT, cells=cells)
        yield from growing(batches, row, functools.partial(_peer_steps, bench, make))


def environment_rows(bench: Bench) -> Iterator[Row]:
    """Environment steps a second, side by side."""
    batch = 64 if bench.quick else 1024
    row = own(
        "environment", "random actions", ENVIRONMENT_UNIT,
        batch=batch, cells=bench.workload.cells, sensing_range=SENSING_RANGE, cores=cores(),
    )  # fmt: skip
    yield own_steps(bench, row, batch)
    yield from peers(bench, "environment", [batch])
