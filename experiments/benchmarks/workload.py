"""What is measured with: houses, starts, and robots in the middle of their episodes."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Int

from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import Planner
from dc2g_jax._src.readers.houses import House, HouseDataset, stack_worlds
from dc2g_jax._src.readers.starts import Start, sample_starts, why_no_episode
from dc2g_jax._src.rollouts.evaluation import episodes_from
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit

from ..baselines.problem import Problem, make_problem

#: Robots are looked at after 0 to so many actions.
_MOST_ACTIONS = 96


@dataclasses.dataclass(frozen=True, eq=False)
class Workload:
    """Episodes in houses that no result is reported on.

    Attributes:
      dataset: what to call the houses.
      houses: training and validation houses in which episodes can be run, all of one size.
      starts: first poses.
    """

    dataset: str
    houses: tuple[House, ...]
    starts: tuple[Start, ...]

    @functools.cached_property
    def terrain(self) -> npt.NDArray[np.uint8]:
        """Class indices, [houses h w]."""
        return np.stack([house.terrain for house in self.houses])

    @functools.cached_property
    def worlds(self) -> World:
        """The houses as worlds, along the last axis."""
        return stack_worlds(self.houses)

    @functools.cached_property
    def episodes(self) -> tuple[Int[jax.Array, "episodes"], Pose]:
        """Index of the house and first pose of all episodes."""
        return episodes_from(self.starts, {house.name: number for number, house in enumerate(self.houses)})

    @property
    def cells(self) -> int:
        """Side of the houses, in cells."""
        return self.terrain.shape[-1]

    def problem(self, *, sensing_range: int, step_limit: int, every: int = 1) -> Problem:
        """The same episodes for the plain programs, rules `reference`; or every n-th of them."""
        index, pose = self.episodes
        return make_problem(
            self.terrain,
            np.asarray(index)[::every],
            np.stack([pose.x, pose.y, pose.heading], axis=-1)[::every],
            sensing_range=sensing_range,
            step_limit=step_limit,
        )


def make_workload(dataset: HouseDataset, *, per_house: int, most_houses: int | None = None) -> Workload:
    """Sampled starts in training and validation houses, never in test houses.

    Args:
      dataset: the houses.
      per_house: starts in each.
      most_houses: use the first ones only.

    Raises:
      InputError: if no episode can be run in any of them.
    """
    houses = [house for house in dataset.houses if house.split != "test" and why_no_episode(house) is None]
    if not houses:
        raise InputError(
            f"{dataset.name}: no episode can be run in any training or validation house, and test houses are not "
            "measured with; give --dataset a folder with others"
        )
    houses = houses[:most_houses]
    starts = sample_starts(houses, per_house, seed=0)
    # Houses take turns, so that every n-th start is a fair sample too.
    starts = [starts[index] for turn in range(per_house) for index in range(turn, len(starts), per_house)]
    return Workload(dataset=dataset.name, houses=tuple(houses), starts=tuple(starts))


def resized(workload: Workload, cells: int, *, count: int) -> Workload:
    """Neighborhoods of another size: houses side by side, cut to a square of so many cells.

    Args:
      workload: where the houses come from.
      cells: side of the square, in cells.
      count: how many neighborhoods, with one start in each.
    """
    tiles = -(-cells // workload.cells)
    rng = np.random.default_rng(cells)
    houses: list[House] = []
    starts: list[Start] = []
    while len(houses) < count:
        chosen = workload.terrain[rng.integers(len(workload.houses), size=(tiles, tiles))]
        grid = np.block([[chosen[row, column] for column in range(tiles)] for row in range(tiles)])
        left, top = rng.integers(grid.shape[0] - cells + 1, size=2)
        house = House(f"{cells}-{len(houses)}", "train", grid[top : top + cells, left : left + cells])
        if why_no_episode(house) is None:
            houses.append(house)
            starts += sample_starts([house], 1, seed=0)
    return Workload(dataset=workload.dataset, houses=tuple(houses), starts=tuple(starts))


class Robots(NamedTuple):
    """Robots in the middle of their episodes, along the last axis.

    Attributes:
      world: where each of them is.
      belief: what each knows.
      state: what each one's planner keeps.
    """

    world: World
    belief: Belief
    state: Any

    def batch(self, size: int, number: int = 0) -> "Robots":
        """So many of them, those of one batch differing from those of the next; over and over where they run out."""
        index = (number * size + np.arange(size)) % self.belief.steps.shape[-1]
        return jax.tree.map(lambda leaf: leaf[..., index], self)


def cycle(planner: Planner, sensing: Kernel, robots: Robots) -> Robots:
    """One planner step of every robot: plan, act, observe."""
    plan, state = planner.plan(robots.belief, robots.state)
    return Robots(robots.world, gridworld.step(robots.world, robots.belief, plan.action, sensing), state)


def cycles(planner: Planner, sensing: Kernel, count: int) -> Callable[[Robots], Robots]:
    """A program of so many planner steps of every robot, all of whose outcome is kept."""

    def run(robots: Robots) -> Robots:
        return jax.lax.fori_loop(0, count, lambda _, now: cycle(planner, sensing, now), robots)

    return run


def active_robots(workload: Workload, leader: Planner, sensing: Kernel, count: int) -> Robots:
    """Robots led by a planner, each after a random number of actions, none of them at its goal.

    Args:
      workload: where they start.
      leader: who leads them.
      sensing: the field of view.
      count: how many.
    """
    rng = np.random.default_rng(0)
    starts = np.arange(count) % len(workload.starts)
    moments = jnp.asarray(rng.integers(_MOST_ACTIONS, size=count), jnp.int32)
    world_index, pose = jax.tree.map(lambda leaf: leaf[starts], workload.episodes)
    world = jax.tree.map(lambda leaf: leaf[..., world_index], workload.worlds)

    @jit
    def run(world: World, pose: Pose, moments: jax.Array) -> Robots:
        first = Robots(world, gridworld.reset(world, pose, sensing), leader.init(world))

        def advance(robots: Robots) -> Robots:
            later = cycle(leader, sensing, robots)
            go_on = (robots.belief.steps < moments) & ~gridworld.at_goal(world, later.belief.pose)
            return jax.tree.map(lambda new, old: jnp.where(go_on, new, old), later, robots)

        return jax.lax.fori_loop(0, _MOST_ACTIONS, lambda _, robots: advance(robots), first)

    return run(world, pose, moments)
