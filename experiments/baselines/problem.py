"""Episodes as the plain programs take them: byte grids, lists of offsets, one row an episode."""

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from dc2g_jax._src.grid.sensing import expanding_kernel, field_of_view
from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE

#: `frontier_lazy` takes the same actions as `frontier` without the whole set of frontier-expanding poses at hand: it
#: searches outward from the robot and looks at each pose only when the search comes to it.
BaselineName = Literal["oracle", "frontier", "frontier_lazy"]
BASELINES: tuple[BaselineName, ...] = ("oracle", "frontier", "frontier_lazy")


class BaselineUnavailable(Exception):
    """A program to compare with cannot run here; the message says why."""


class HeadingOffsets(NamedTuple):
    """Offsets from the robot's cell for each heading.

    Attributes:
      first: index of each heading's first offset, and their number at the end, int32 [5].
      dx: columns, int32 [offsets].
      dy: rows, int32 [offsets].
    """

    first: npt.NDArray[np.int32]
    dx: npt.NDArray[np.int32]
    dy: npt.NDArray[np.int32]

    @classmethod
    def of(cls, kernel: Sequence[Sequence[tuple[int, int]]]) -> Self:
        """From the offsets `(dx, dy)` of each heading."""
        counts = [len(offsets) for offsets in kernel]
        flat = np.array([offset for offsets in kernel for offset in offsets], np.int32).reshape(-1, 2)
        return cls(
            first=np.cumsum([0, *counts]).astype(np.int32),
            dx=np.ascontiguousarray(flat[:, 0]),
            dy=np.ascontiguousarray(flat[:, 1]),
        )


@dataclasses.dataclass(frozen=True)
class Problem:
    """Episodes to run by the rules `reference`.

    Attributes:
      traversable: cells of each world a robot may drive on, 0 or 1, uint8 [worlds h w].
      goals: goal cells of each world, 0 or 1, uint8 [worlds h w].
      world: each episode's world, int32 [episodes].
      start: each episode's first x, y and heading, int32 [episodes 3].
      sensing: the field of view.
      expanding: kernel of the frontier-expanding poses.
      step_limit: actions after which an episode ends without success.
    """

    traversable: npt.NDArray[np.uint8]
    goals: npt.NDArray[np.uint8]
    world: npt.NDArray[np.int32]
    start: npt.NDArray[np.int32]
    sensing: HeadingOffsets
    expanding: HeadingOffsets
    step_limit: int


class Outcome(NamedTuple):
    """What came of the episodes.

    Attributes:
      steps: actions taken, int32 [episodes].
      success: was a goal reached? bool [episodes].
      actions: the actions, then -1, int8 [episodes step_limit].
    """

    steps: npt.NDArray[np.int32]
    success: npt.NDArray[np.bool_]
    actions: npt.NDArray[np.int8]


def make_problem(
    terrain: npt.NDArray[np.uint8],
    world: npt.ArrayLike,
    start: npt.ArrayLike,
    *,
    sensing_range: int,
    expanding_range: int | None = None,
    step_limit: int = 500,
) -> Problem:
    """Episodes in worlds given as class indices.

    Args:
      terrain: class indices, uint8 [worlds h w].
      world: each episode's world.
      start: each episode's first x, y and heading, [episodes 3].
      sensing_range: reach of the field of view, in cells.
      expanding_range: range of the expanding kernel in cells; the sensing range where `None`.
      step_limit: actions after which an episode ends without success.
    """
    return Problem(
        traversable=np.ascontiguousarray(TRAVERSABLE[terrain].astype(np.uint8)),
        goals=np.ascontiguousarray((terrain == FRONT_DOOR).astype(np.uint8)),
        world=np.ascontiguousarray(world, np.int32),
        start=np.ascontiguousarray(start, np.int32).reshape(-1, 3),
        sensing=HeadingOffsets.of(field_of_view(sensing_range).offsets),
        expanding=HeadingOffsets.of(expanding_kernel(expanding_range or sensing_range).offsets),
        step_limit=step_limit,
    )


def empty_outcome(problem: Problem) -> Outcome:
    """Room for the outcome of a problem."""
    episodes = len(problem.world)
    return Outcome(
        steps=np.zeros(episodes, np.int32),
        success=np.zeros(episodes, np.bool_),
        actions=np.full((episodes, problem.step_limit), -1, np.int8),
    )
