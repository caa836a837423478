"""Rules in which the paper's text and the authors' published code differ, and named settings of them."""

import dataclasses
import functools
import inspect
from collections.abc import Callable

import jax.numpy as jnp

from dc2g_jax._src.grid import bitboard, search
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import PoseSet, every_heading, with_headings
from dc2g_jax._src.grid.sensing import (
    PAPER_DEGREES,
    Kernel,
    check_degrees,
    check_sensing_range,
    expanding_kernel,
    field_of_view,
    line_of_sight,
)
from dc2g_jax._src.planning import frontiers
from dc2g_jax._src.runtime.errors import InputError, short
from dc2g_jax._src.runtime.own_parts import own_part


@dataclasses.dataclass(frozen=True)
class Rules:
    """Field of view, frontiers and goals of a planner. Hashable, so that it can be a static argument of `jit`.

    Attributes:
      sensing: the field of view.
      frontier_expanding: `(belief, reachable) ->` poses worth exploring from.
      goal_poses: `(belief, reachable goal cells, reachable) ->` poses to head for when a goal is reachable.
      expanding_range: range of the kernel of `frontier_expanding` in cells, if it has one.
      reach: distance in cells, along x or y, beyond which only reachability matters to whether a pose is worth
        exploring from; and nothing matters to which pose of a goal is headed for. `None` if there is no such limit.
    """

    sensing: Kernel
    frontier_expanding: Callable[[Belief, Board], PoseSet] = dataclasses.field(repr=False)
    goal_poses: Callable[[Belief, Board, Board], PoseSet] = dataclasses.field(repr=False)
    expanding_range: int | None = None
    reach: int | None = None


def nearest_goal(belief: Belief, goals: Board, reachable: Board) -> PoseSet:
    """All poses on reachable observed goal cells. A shortest plan ends at the nearest."""
    del belief, reachable
    return every_heading(goals)


def first_goal(belief: Belief, goals: Board, reachable: Board) -> PoseSet:
    """The pose that the authors' code heads for: on the first goal cell in raster order, in the nearest heading.

    Ties between headings go to the smaller index.
    """
    x, y = bitboard.first(goals)
    # Skip the search if there is no goal.
    free = jnp.where(bitboard.is_empty(goals), jnp.uint32(0), reachable)
    headings = search.first_headings(belief.pose, x, y, free)
    soonest = headings & (jnp.cumsum(headings, axis=0) == 1)
    return with_headings(soonest, bitboard.single(x, y, *reachable.shape[:2]))


@functools.cache
def complete_rules(
    sensing_range: int, view: Callable[[int, float], Kernel] = field_of_view, degrees: float = PAPER_DEGREES
) -> Rules:
    """The rules of the paper's text, with a guarantee that exploration ends.

    Args:
      sensing_range: range of the field of view, in cells.
      view: `(range, degrees) ->` field of view: `field_of_view`, as in the paper, or `line_of_sight`.
      degrees: width of the field of view, 1 to 360.
    """
    return _complete_rules(view(sensing_range, degrees))


@functools.cache  # so that equal fields of view share their programs
def _complete_rules(sensing: Kernel) -> Rules:
    return Rules(
        sensing=sensing,
        frontier_expanding=functools.partial(frontiers.complete, sensing=sensing),
        goal_poses=nearest_goal,
        reach=sensing.radius + 2,
    )


@functools.cache
def reference_rules(sensing_range: int, expanding_range: int | None = None) -> Rules:
    """The rules of the authors' published code: `Frontier` with them repeats its actions exactly, `DC2G` does not.

    Args:
      sensing_range: range of the 90-degree field of view, in cells.
      expanding_range: range of the frontier-expanding kernel, in cells; `None` for the sensing range.
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
      name: name for users.
      sensing_range: default range of the field of view, in cells.
      expanding_range: default range of the frontier-expanding kernel, in cells; `None` for the sensing range.
      make_rules: `(sensing range, expanding range or None) ->` rules. If it has an argument
        `degrees`, it also gets the width of the field of view.
      field_of_view: width of the field of view in degrees, 1 to 360.
    """

    name: str
    sensing_range: int
    expanding_range: int | None
    make_rules: Callable[..., Rules] = dataclasses.field(repr=False)
    field_of_view: float = PAPER_DEGREES

    def rules(self, sensing_range: int | None = None, expanding_range: int | None = None) -> Rules:
        """The rules for these ranges. `None` stands for the default.

        The default expanding range only applies together with the default sensing range; for other sensing ranges it
        equals the sensing range.

        Raises:
          InputError: a range or the field of view is out of bounds, the rules do not take another field of view, or an
            expanding range is given for rules without a frontier-expanding kernel.
        """
        if sensing_range is not None:
            check_sensing_range("sensing range", sensing_range)
        if sensing_range in (None, self.sensing_range):
            sensing_range = self.sensing_range
            expanding_range = self.expanding_range if expanding_range is None else expanding_range
        rules = self._make(sensing_range, expanding_range)
        if expanding_range is not None and rules.expanding_range is None:
            raise InputError(
                f"expanding range {expanding_range}: the settings {self.name!r} have no frontier-expanding kernel; "
                "leave expanding_range out, or take the settings 'published' or 'reference'"
            )
        return rules

    @functools.cached_property
    def _make(self) -> Callable[[int, int | None], Rules]:
        """`make_rules` with the field of view."""
        check_degrees("field of view", self.field_of_view)
        try:
            inspect.signature(self.make_rules).bind(1, None, degrees=self.field_of_view)
        except (TypeError, ValueError):  # it has no such argument, or no signature
            if self.field_of_view == PAPER_DEGREES:
                return self.make_rules
            raise InputError(
                f"field of view {self.field_of_view:g}: the settings {self.name!r} have {PAPER_DEGREES:g} degrees "
                "only; take the settings 'paper' or 'occluded'"
            ) from None
        return functools.partial(self.make_rules, degrees=float(self.field_of_view))


def _paper(view: Callable[[int, float], Kernel]) -> Callable[..., Rules]:
    """`Settings.make_rules` of the paper's text."""
    return lambda sensing_range, _, degrees=PAPER_DEGREES: complete_rules(sensing_range, view, degrees)


#: Settings by name: those of the 400 published episodes; the authors' code at any range; the paper's text; and the
#: paper's text with occlusion by houses and trees.
SETTINGS = {
    settings.name: settings
    for settings in (
        Settings("published", 5, 4, reference_rules),
        Settings("reference", 8, None, reference_rules),
        Settings("paper", 8, None, _paper(field_of_view)),
        Settings("occluded", 8, None, _paper(line_of_sight)),
    )
}


def named_settings(settings: str | Settings, field_of_view: float | None = None) -> Settings:
    """Settings by name, one of `SETTINGS` or `package.module:Name`. `Settings` are returned as they are.

    Args:
      settings: the name, or `Settings`.
      field_of_view: width of the field of view in degrees, 1 to 360; `None` for that of the settings.

    Raises:
      InputError: the name is unknown, there are no `Settings` of that name, or their rules do not take this field of
        view.
    """
    if isinstance(settings, Settings):
        found = settings
    else:
        found = SETTINGS.get(settings) or own_part("set of rules", settings, SETTINGS)
    if not isinstance(found, Settings):
        raise InputError(
            f"set of rules {settings!r}: is {short(found)}; give an instance of dc2g_jax.planning.Settings"
        )
    if field_of_view is None:
        return found
    found = dataclasses.replace(found, field_of_view=field_of_view)
    found.rules()  # so that an invalid width raises here
    return found
