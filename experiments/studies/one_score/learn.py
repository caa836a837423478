"""What exploring costs, from paired rollouts, and the weights of the score that follow from it.

At a decision of the current planner, several candidates are tried, each followed to the end in the same hidden map by
the current planner. The goal may be on any free cell, so a rollout goes on until all is explored, and counts for every
cell as the goal: the value of a candidate is the mean logarithm of the actions after which each cell can be reached.
The weights are a least-squares fit of the differences between candidates of a decision, in which the map cancels.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import HEADINGS, Pose, make_pose
from dc2g_jax._src.grid.terrain import FREE, OCCUPIED
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import GAVE_UP, Frontier
from dc2g_jax._src.runtime.devices import batched, deal, gather, mesh_of, on_each
from dc2g_jax._src.runtime.programs import ONE_OPERATION_OPTIONS, jit, one_operation

from .maps import KINDS, Free, draw_map
from .planner import TERMS, Scored

#: Candidates tried at a decision: the best, two of the best eight, and any.
_TRIED, _GOOD, _BEST = 6, 3, 8

#: Actions added to each count: about those from the first sight of a cell to it.
_LAST_ACTIONS = 6

#: Actions after which a rollout ends, for each cell of a side of the map.
_LIMIT = 100

#: A share of the field of view that is never new.
_NEVER = 1e3

#: The terms that maps without classes tell the weights of.
_PLAIN = [number for number, term in enumerate(TERMS) if term not in ("cost", "kept")]


class Tried(NamedTuple):
    """Candidates of decisions and what came after.

    Attributes:
      terms: terms of each candidate.
      value: mean logarithm of the actions to each cell that could not be reached before.
      share: share of the free cells that could not be reached before: how often a search comes that far.
    """

    terms: Float[np.ndarray, "decision tried term"]
    value: Float[np.ndarray, "decision tried"]
    share: Float[np.ndarray, "decision"]


class Maps(NamedTuple):
    """Maps, dealt out to the devices, with a start in each.

    Attributes:
      worlds: worlds without a goal.
      start: first poses.
      numbers: random numbers for each map.
      kinds: kind of each map.
    """

    worlds: World
    start: Pose
    numbers: Int[Array, "devices own number"]
    kinds: tuple[str, ...]


def maps_of(free: Sequence[Free], kinds: Sequence[str], seed: int) -> Maps:
    """Maps of these free cells, all of one size, each with a random start."""
    rng = np.random.default_rng(seed)
    cells = [np.argwhere(cells) for cells in free]
    y, x = np.array([own[rng.integers(len(own))] for own in cells], np.int32).T
    start = make_pose(x, y, rng.integers(HEADINGS, size=len(free)))
    worlds = World.from_terrain(np.where(np.stack(free, axis=-1), np.uint8(FREE), np.uint8(OCCUPIED)))
    numbers = rng.integers(0, 2**30, size=(len(free), 1 + _TRIED)).astype(np.int32)
    rows = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), -1, 0), worlds)
    worlds, start, numbers = deal((rows, start, numbers), len(free), mesh_of(None))
    return Maps(worlds, start, numbers, tuple(kinds))


def drawn(count: int, seed: int, side: int) -> Maps:
    """So many maps of each kind."""
    kinds = list(KINDS) * count
    return maps_of([draw_map(kind, (seed, side, number), side) for number, kind in enumerate(kinds)], kinds, seed)


def _reached(state: Any) -> Int[Array, "1"]:
    """Number of cells known to be reachable."""
    return bitboard.count(getattr(state, "reachable", state))


def _follow(
    planner: Scored | Frontier, world: World, belief: Belief, state: Any, going: Any, limit: int
) -> tuple[Belief, Any, Float[Array, "1"], Bool[Array, "1"]]:
    """Follow a planner while `going(belief, state)`.

    Returns:
      The belief, the planner's state, the sum over newly reachable cells of the logarithm of the actions, and whether
      the planner gave up.
    """

    def go_on(carry: Any) -> Bool[Array, ""]:
        belief, state, _, done = carry
        return (~done & going(belief, state) & (belief.steps < limit))[0]

    def step(carry: Any) -> Any:
        belief, state, total, _ = carry
        plan, later = planner.plan(belief, state)
        new = (_reached(later) - _reached(state)).astype(jnp.float32)
        total += new * jnp.log(belief.steps.astype(jnp.float32) + _LAST_ACTIONS)
        belief = gridworld.step(world, belief, plan.action, planner.rules.sensing)
        return belief, later, total, plan.mode == GAVE_UP

    return jax.lax.while_loop(go_on, step, (belief, state, jnp.zeros(1), jnp.zeros(1, bool)))


def _value(planner: Scored | Frontier, world: World, belief: Belief, state: Any, limit: int) -> Float[Array, "1"]:
    """Mean logarithm of the actions to the cells that cannot be reached yet."""
    before, area = _reached(state), bitboard.count(world.traversable)
    _, state, total, _ = _follow(planner, world, belief, state, lambda *_: jnp.ones(1, bool), limit)
    total += (area - _reached(state)).astype(jnp.float32) * jnp.log(jnp.float32(limit))
    return total / jnp.maximum(area - before, 1)


def _on_each_map(function: Any, planner: Scored | Frontier, dealt: Any) -> Any:
    """`function(planner, *parts)` for the parts of each map, one robot a core."""
    mesh = mesh_of(None)

    def own(dealt: Any, planner: Scored | Frontier) -> Any:
        def each(dealt: Any, planner: Scored | Frontier) -> Any:
            def one(*parts: Any) -> Any:
                return function(planner, *jax.tree.map(lambda leaf: leaf[..., None], parts))

            return batched(mesh)(one)(*dealt)

        return one_operation(each, dealt, planner)

    return on_each(own, mesh, dealt, planner)


@functools.partial(jit, static_argnames="limit", compiler_options=ONE_OPERATION_OPTIONS)
def _values(planner: Scored | Frontier, worlds: World, start: Pose, *, limit: int) -> Array:
    def value(planner: Scored | Frontier, world: World, start: Pose) -> Array:
        return _value(planner, world, gridworld.reset(world, start, planner.rules.sensing), planner.init(world), limit)

    return _on_each_map(value, planner, (worlds, start))


def values(planner: Scored | Frontier, maps: Maps) -> Float[np.ndarray, "maps"]:
    """Mean logarithm of a planner's actions to each free cell of each map.

    Args:
      planner: the planner; its state has `reachable` cells, or is these.
      maps: the maps.
    """
    found = _values(planner, maps.worlds, maps.start, limit=_LIMIT * maps.worlds.width)
    return np.asarray(gather(found, len(maps.kinds)))[:, 0]


@functools.partial(jit, static_argnames=("limit", "decisions"), compiler_options=ONE_OPERATION_OPTIONS)
def _tried(planner: Scored, worlds: World, start: Pose, numbers: Array, *, limit: int, decisions: int) -> Any:
    def tried(planner: Scored, world: World, start: Pose, numbers: Array) -> Any:
        at = numbers[0] % decisions

        def going(belief: Belief, state: Any) -> Bool[Array, "1"]:
            return ~(planner.look(belief, state)[1][0] & (state.choices >= at))

        first = gridworld.reset(world, start, planner.rules.sensing), planner.init(world)
        belief, state, _, ended = _follow(planner, world, *first, going, limit)
        chosen = planner.choose((belief, *planner.look(belief, state)[1][1:]), state, planner.ask)
        count = jnp.sum(chosen.present, axis=0, dtype=jnp.int32)
        squares, most = chosen.present.shape[0], jnp.iinfo(jnp.int32).max

        def next_best(place: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            score, places = carry
            best = (jnp.arange(squares) == jnp.argmin(score, axis=0)[0])[:, None]
            return jnp.where(best, most, score), jnp.where(best & (score < most), place, places)

        places = jax.lax.fori_loop(0, squares, next_best, (chosen.score, jnp.full((squares, 1), -1)))[1]

        def of(number: Array) -> tuple[Array, Array]:
            among = jnp.where(number < _GOOD, jnp.minimum(count, _BEST), jnp.maximum(count, 1))
            place = jnp.where(number == 0, 0, numbers[1 + number] % among)
            square = jnp.argmax(places == place, axis=0).astype(jnp.int32)
            value = _value(planner, world, belief, state._replace(forced=square), limit)
            return jnp.take_along_axis(chosen.terms, square[None, None], axis=1)[:, 0, 0], value[0]

        terms, value = jax.lax.map(of, jnp.arange(_TRIED))
        share = 1 - _reached(state) / bitboard.count(world.traversable)
        return terms, value, share[0], (~ended & (count > 1))[0]

    return _on_each_map(tried, planner, (worlds, start, numbers))


def try_candidates(planner: Scored, maps: Maps) -> Tried:
    """Try candidates at a random decision in each map.

    Each choice is followed until its pose reveals nothing more: a planner that soon chooses anew would tell nothing
    about distant candidates.
    """
    side = maps.worlds.width
    planner = dataclasses.replace(planner, replan_fraction=_NEVER)
    found = _tried(planner, maps.worlds, maps.start, maps.numbers, limit=_LIMIT * side, decisions=side)
    terms, value, share, useful = (np.asarray(gather(part, len(maps.kinds))) for part in found)
    return Tried(terms[useful], value[useful], share[useful])


def fitted(parts: Sequence[Tried], before: Float[np.ndarray, "term"]) -> Float[np.ndarray, "term"]:
    """Weights by least squares on differences within decisions; those of `cost` and `kept` stay.

    Each part, such as the decisions in maps of one size, counts the same.
    """
    rows, targets = [], []
    for part in parts:
        difference = part.terms[:, :, _PLAIN] - part.terms[:, :, _PLAIN].mean(axis=1, keepdims=True)
        target = part.value - part.value.mean(axis=1, keepdims=True)
        weight = np.sqrt(part.share / np.sum(part.share))[:, None]
        rows.append((difference * weight[..., None]).reshape(-1, len(_PLAIN)))
        targets.append((target * weight).ravel())
    after = np.array(before, np.float64)
    after[_PLAIN] = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
    return after.astype(np.float32)
