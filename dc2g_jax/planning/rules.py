"""The values in which the paper's text and the authors' published code differ, and the named settings made of them."""

import dataclasses
import functools
from collections.abc import Callable

import jax.numpy as jnp

from dc2g_jax.errors import InputError
from dc2g_jax.grid import bitboard, search
from dc2g_jax.grid.bitboard import Board
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import PoseSet, every_heading, with_headings
from dc2g_jax.grid.sensing import MAX_SENSING_RANGE, Kernel, expanding_kernel, field_of_view, line_of_sight
from dc2g_jax.planning import frontiers


@dataclasses.dataclass(frozen=True)
class Rules:
    """What a robot sees and what its planner counts. Hashable, so a static value under `jit`.

    Attributes:
      sensing: the field of view.
      frontier_expanding: `(belief, reachable) ->` poses worth exploring from.
      goal_poses: `(belief, reachable goal cells, reachable) ->` poses to head for once a goal is reachable.
      expanding_range: range of the kernel in `frontier_expanding` in cells, where there is one.
      reach: cells farther away than this, in x or y, do not matter to whether a pose is worth exploring from, except
        for what is reachable; `None` where all may.
    """

    sensing: Kernel
    frontier_expanding: Callable[[Belief, Board], PoseSet]
    goal_poses: Callable[[Belief, Board, Board], PoseSet]
    expanding_range: int | None = None
    reach: int | None = None


def nearest_goal(belief: Belief, goals: Board, reachable: Board) -> PoseSet:
    """Every pose on a reachable observed goal cell: a shortest plan ends in the nearest."""
    del belief, reachable
    return every_heading(goals)


def first_goal(belief: Belief, goals: Board, reachable: Board) -> PoseSet:
    """The one pose the authors' code heads for: on the raster-first goal cell, in the heading it reaches soonest.

    Ties between headings go to the smaller index.
    """
    x, y = bitboard.first(goals)
    # Nothing is searched where there is nothing to find.
    free = jnp.where(bitboard.is_empty(goals), jnp.uint32(0), reachable)
    headings = search.first_headings(belief.pose, x, y, free)
    soonest = headings & (jnp.cumsum(headings, axis=0) == 1)
    return with_headings(soonest, bitboard.single(x, y, *reachable.shape[:2]))


@functools.cache
def complete_rules(sensing_range: int, view: Callable[[int], Kernel] = field_of_view) -> Rules:
    """The algorithm as the paper's text means it, with a guarantee that exploration ends.

    Args:
      sensing_range: reach of the 90-degree field of view, in cells.
      view: range -> what a robot sees: `field_of_view`, as in the paper, or `line_of_sight`.
    """
    sensing = view(sensing_range)
    return Rules(
        sensing=sensing,
        frontier_expanding=functools.partial(frontiers.complete, sensing=sensing),
        goal_poses=nearest_goal,
        reach=sensing.radius + 2,
    )


@functools.cache
def reference_rules(sensing_range: int, expanding_range: int | None = None) -> Rules:
    """What the authors' published code does, to the action.

    Args:
      sensing_range: reach of the 90-degree field of view, in cells.
      expanding_range: range of the frontier-expanding kernel, in cells; the sensing range where `None`.
    """
    expanding_range = sensing_range if expanding_range is None else expanding_range
    expanding = expanding_kernel(expanding_range)
    return Rules(
        sensing=field_of_view(sensing_range),
        frontier_expanding=functools.partial(frontiers.reference, expanding=expanding),
        goal_poses=first_goal,
        expanding_range=expanding_range,
        reach=expanding.radius + 1,
    )


@dataclasses.dataclass(frozen=True)
class Settings:
    """A named choice of rules.

    Attributes:
      name: what users call it.
      sensing_range: reach of the field of view in cells where an episode does not say.
      expanding_range: range of the frontier-expanding kernel in cells where an episode does not say; `None` for the
        sensing range.
      make_rules: `(sensing range, expanding range or None) ->` rules.
    """

    name: str
    sensing_range: int
    expanding_range: int | None
    make_rules: Callable[[int, int | None], Rules]

    def rules(self, sensing_range: int | None = None, expanding_range: int | None = None) -> Rules:
        """The rules for an episode that asks for these ranges, `None` for the setting's own.

        Another sensing range than the setting's own brings an expanding range of its own, where none is given.

        Raises:
          InputError: a range is out of bounds, or an expanding range is asked for and these rules have no
            frontier-expanding kernel.
        """
        if sensing_range is not None and not 1 <= sensing_range <= MAX_SENSING_RANGE:
            raise InputError(f"sensing range {sensing_range}: give 1 to {MAX_SENSING_RANGE} cells")
        if sensing_range in (None, self.sensing_range):
            sensing_range = self.sensing_range
            expanding_range = self.expanding_range if expanding_range is None else expanding_range
        rules = self.make_rules(sensing_range, expanding_range)
        if expanding_range is not None and rules.expanding_range is None:
            raise InputError(
                f"expanding range {expanding_range}: the settings {self.name!r} have no frontier-expanding kernel; "
                "leave expanding_range out, or take the settings 'published' or 'reference'"
            )
        return rules


#: What the 400 published episodes were run with; what the authors' code does at any range; what the paper's text says,
#: as it is, and where houses and trees hide what is behind them.
SETTINGS = {
    settings.name: settings
    for settings in (
        Settings("published", 5, 4, reference_rules),
        Settings("reference", 8, None, reference_rules),
        Settings("paper", 8, None, lambda sensing_range, _: complete_rules(sensing_range)),
        Settings("occluded", 8, None, lambda sensing_range, _: complete_rules(sensing_range, line_of_sight)),
    )
}


def named_settings(settings: str | Settings) -> Settings:
    """Settings by name; settings are returned as they are.

    Raises:
      InputError: none have this name.
    """
    if isinstance(settings, Settings):
        return settings
    if settings not in SETTINGS:
        raise InputError(f"no settings are called {settings!r}; known: {', '.join(SETTINGS)}")
    return SETTINGS[settings]
