"""The cost of exploring: the weights of `LearnedScore`, learned from paired rollouts.

At a decision of the current planner several candidates are tried: each is followed to the end of the search in the same
hidden map. The value of a candidate is the mean logarithm of the number of actions after which a target can be reached.
Targets are the goals; on maps without goals, all free cells, so that no random goal adds noise. The weights are a
least-squares fit of the differences between the candidates of a decision, in which the effect of the map cancels.
"""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.files.atomic import replacing, write_json
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import HEADINGS, Pose, make_pose, only
from dc2g_jax._src.grid.sensing import PAPER_DEGREES, check_degrees
from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore
from dc2g_jax._src.planning.planners import GAVE_UP, PlannerLike
from dc2g_jax._src.planning.rules import named_settings
from dc2g_jax._src.readers.starts import start_cells
from dc2g_jax._src.runtime.devices import batched, deal, gather, mesh_of, on_each
from dc2g_jax._src.runtime.errors import InputError, check_number
from dc2g_jax._src.runtime.plugins import plugins
from dc2g_jax._src.runtime.programs import ONE_OPERATION_OPTIONS, jit, one_operation
from dc2g_jax._src.training.cost_to_go_data import drawn_houses

#: Initial weights: the next best view (log gain less a tenth of the actions) and the cost-to-go.
START = {"actions": 1.0, "log_gain": -10.0, "kept": -2.0}

#: Weight of the last choice, in cells. Rollouts follow each choice to its end, so they cannot determine it.
_KEPT = TERMS.index("kept")

#: Candidates tried at a decision: the best, two of the best eight, and any.
_TRIED, _GOOD, _BEST = 6, 3, 8

#: Actions added to each count on maps without goals: about those between first seeing a target and reaching it.
_LAST_ACTIONS = 6

#: Actions after which a rollout ends, for each cell of a side of the map.
_LIMIT = 100

#: A `replan_fraction` that is never reached: choices are kept while their pose reveals something.
_NEVER = 1e3

#: Cells a side of the houses; limit of the number of rounds; size of a round's comparison as a share of its maps.
_HOUSE_CELLS, _MOST_ROUNDS, _JUDGED = 50, 1_000, 0.25

#: Candidates are tried at one of the first so many decisions, for each 50 cells of a side.
_DECISIONS = 16


@dataclasses.dataclass(frozen=True)
class ScoreConfig:
    """How the weights of the score are learned.

    Attributes:
      rounds: number of rounds. Each runs rollouts, fits the weights, and keeps them if they are better on fresh maps.
      maps: maps without classes in a round, for each size; one decision in each.
      houses: procedural houses in a round.
      starts: decisions in each house.
      sides: cells a side of the maps without classes.
      field_of_view: width of the robots' field of view in degrees.
      seed: seed of all random numbers.

    Raises:
      InputError: a number is out of bounds.
    """

    rounds: int = 2
    maps: int = 600
    houses: int = 200
    starts: int = 8
    sides: tuple[int, ...] = (50, 80)
    field_of_view: float = PAPER_DEGREES
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.sides:
            raise InputError("sides is empty; give the sides of the maps without classes, in cells")
        check_number("--rounds", self.rounds, whole=True, least=1, most=_MOST_ROUNDS - 1)
        for name in ("maps", "houses", "starts"):
            check_number(f"--{name}", getattr(self, name), whole=True, least=1)
        for side in self.sides:
            check_number("--sides", side, whole=True, least=40, most=300)
        check_degrees("--field-of-view", self.field_of_view)
        check_number("--seed", self.seed, whole=True, least=0, most=2**32 // (2 * _MOST_ROUNDS) - 1)


class Tried(NamedTuple):
    """Candidates of decisions and what came after.

    Attributes:
      terms: values of `TERMS` of each candidate.
      cost: its predicted cost-to-go, in cells.
      value: mean logarithm of the actions to each target that could not be reached before.
      share: share of the targets that could not be reached before: how often a search gets that far.
    """

    terms: Float[np.ndarray, "decision tried term"]
    cost: Float[np.ndarray, "decision tried"]
    value: Float[np.ndarray, "decision tried"]
    share: Float[np.ndarray, "decision"]


class Searches(NamedTuple):
    """Searches to start, distributed over the devices.

    Attributes:
      worlds: the world of each, all of one size.
      start: first poses.
      numbers: random numbers for each.
      total: number of searches.
    """

    worlds: World
    start: Pose
    numbers: Int[Array, "devices own number"]
    total: int


def searches_in(maps: Sequence[UInt8[np.ndarray, "h w"]], starts: int, seed: int) -> Searches:
    """Searches from random poses in maps of one size.

    Args:
      maps: class indices of each map.
      starts: number of searches in each.
      seed: of the poses.
    """
    rng, terrains, places = np.random.default_rng(seed), [], []
    for terrain in maps:
        cells = np.argwhere(start_cells(terrain) if np.any(terrain == FRONT_DOOR) else TRAVERSABLE[terrain])
        places += [cells[rng.integers(len(cells))] for _ in range(starts)]
        terrains += [terrain] * starts
    y, x = np.array(places, np.int32).T
    start = make_pose(x, y, rng.integers(HEADINGS, size=len(places)))
    stacked = World.from_terrain(np.stack(terrains, axis=-1))
    rows = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), -1, 0), stacked)
    numbers = rng.integers(0, 2**30, size=(len(places), 1 + _TRIED)).astype(np.int32)
    worlds, start, numbers = deal((rows, start, numbers), len(places), mesh_of(None))
    return Searches(worlds, start, numbers, len(places))


def _missing(world: World, state: Any) -> Float[Array, "1"]:
    """Number of targets that cannot be reached yet: 1 until any goal can; without goals, such free cells."""
    reachable = getattr(state, "reachable", state)
    no_goal_yet = (~bitboard.intersects(reachable, world.goals)).astype(jnp.float32)
    cells = bitboard.count(world.traversable & ~reachable).astype(jnp.float32)
    return jnp.where(bitboard.is_empty(world.goals), cells, no_goal_yet)


def _follow(
    planner: PlannerLike, world: World, belief: Belief, state: Any, going: Any, limit: int
) -> tuple[Belief, Any, Float[Array, "1"], Bool[Array, "1"]]:
    """Follow a planner while `going(belief, state)` and a target is missing.

    Returns:
      The belief, the planner's state, the sum over new targets of the logarithm of the actions, and whether the planner
      gave up.
    """

    def go_on(carry: Any) -> Bool[Array, ""]:
        belief, state, _, gave_up = carry
        return (~gave_up & going(belief, state) & (belief.steps < limit) & (_missing(world, state) > 0))[0]

    def step(carry: Any) -> Any:
        belief, state, total, _ = carry
        plan, later = planner.plan(belief, state)
        new = _missing(world, state) - _missing(world, later)
        # The plan to a goal begins with this action.
        left = jnp.where(bitboard.is_empty(world.goals), _LAST_ACTIONS, jnp.maximum(plan.length, 1))
        total += new * jnp.log((belief.steps + left).astype(jnp.float32))
        belief = gridworld.step(world, belief, plan.action, planner.rules.sensing)
        return belief, later, total, plan.mode == GAVE_UP

    return jax.lax.while_loop(go_on, step, (belief, state, jnp.zeros(1), jnp.zeros(1, bool)))


def _value(planner: PlannerLike, world: World, belief: Belief, state: Any, limit: int) -> Float[Array, "1"]:
    """Mean logarithm of the actions to the targets that cannot be reached yet."""
    before = _missing(world, state)
    _, state, total, _ = _follow(planner, world, belief, state, lambda *_: jnp.ones(1, bool), limit)
    return (total + _missing(world, state) * jnp.log(jnp.float32(limit))) / jnp.maximum(before, 1)


def _on_each_search(function: Any, planner: PlannerLike, dealt: Any) -> Any:
    """`function(planner, *parts)` for the parts of each search, one robot a core."""
    mesh = mesh_of(None)

    def own(dealt: Any, planner: PlannerLike) -> Any:
        def each(dealt: Any, planner: PlannerLike) -> Any:
            def one(*parts: Any) -> Any:
                return function(planner, *jax.tree.map(lambda leaf: leaf[..., None], parts))

            return batched(mesh)(one)(*dealt)

        return one_operation(each, dealt, planner)

    return on_each(own, mesh, dealt, planner)


@functools.partial(jit, static_argnames="limit", compiler_options=ONE_OPERATION_OPTIONS)
def _values(planner: PlannerLike, worlds: World, start: Pose, *, limit: int) -> Array:
    def value(planner: PlannerLike, world: World, start: Pose) -> Array:
        return _value(planner, world, gridworld.reset(world, start, planner.rules.sensing), planner.init(world), limit)

    return _on_each_search(value, planner, (worlds, start))


def values(planner: PlannerLike, searches: Searches) -> Float[np.ndarray, "searches"]:
    """Mean logarithm of a planner's actions to each target, for each search.

    Args:
      planner: the planner; its state has `reachable` cells, or is the set of these.
      searches: the searches.
    """
    found = _values(planner, searches.worlds, searches.start, limit=_LIMIT * searches.worlds.width)
    return np.asarray(gather(found, searches.total))[:, 0]


@functools.partial(jit, static_argnames=("limit", "decisions"), compiler_options=ONE_OPERATION_OPTIONS)
def _tried(planner: LearnedScore, worlds: World, start: Pose, numbers: Array, *, limit: int, decisions: int) -> Any:
    def tried(planner: LearnedScore, world: World, start: Pose, numbers: Array) -> Any:
        at = numbers[0] % decisions

        def going(belief: Belief, state: Any) -> Bool[Array, "1"]:
            return ~(planner.look(belief, state)[1][0] & (state.choices >= at))

        first = gridworld.reset(world, start, planner.rules.sensing), planner.init(world)
        belief, state, _, gave_up = _follow(planner, world, *first, going, limit)
        chosen = planner.choose((belief, *planner.look(belief, state)[1][1:]), state, planner.ask)
        found = chosen.candidates
        count = jnp.sum(found.present, axis=0, dtype=jnp.int32)
        # Rank of each candidate: the number of those that are better, or as good and before it.
        order, index = jnp.where(found.present, found.score, jnp.inf)[:, 0], jnp.arange(found.present.shape[0])
        before = (order[None] < order[:, None]) | ((order[None] == order[:, None]) & (index[None] < index[:, None]))
        rank = jnp.sum(before.astype(jnp.int32), axis=1)

        def of(number: Array) -> tuple[Array, ...]:
            among = jnp.where(number < _GOOD, jnp.minimum(count, _BEST), jnp.maximum(count, 1))
            place = jnp.where(number == 0, 0, numbers[1 + number] % among)
            square = jnp.argmax((rank == place) & found.present[:, 0]).astype(jnp.int32)
            pose = jax.tree.map(lambda values: values[square], found.pose)
            forced = chosen._replace(subgoals=only(pose, *world.goals.shape[:2]))
            value = _value(planner, world, belief, forced, limit)
            return found.terms[:, square, 0], found.cost[square, 0], value[0]

        terms, cost, value = jax.lax.map(of, jnp.arange(_TRIED))
        targets = jnp.maximum(_missing(world, jnp.zeros_like(world.goals)), 1)
        share = _missing(world, chosen) / targets
        return terms, cost, value, share[0], (~gave_up & (count > 1) & (share > 0))[0]

    return _on_each_search(tried, planner, (worlds, start, numbers))


def try_candidates(planner: LearnedScore, searches: Searches) -> Tried:
    """Try candidates at a random decision of each search.

    Each choice is followed until its pose reveals nothing more. If the planner soon chose again, distant candidates
    would never be tested.
    """
    side = searches.worlds.width
    planner = dataclasses.replace(planner, replan_fraction=_NEVER)
    found = _tried(
        planner, searches.worlds, searches.start, searches.numbers,
        limit=_LIMIT * side, decisions=max(1, _DECISIONS * side // 50),
    )  # fmt: skip
    *parts, useful = (np.asarray(gather(part, searches.total)) for part in found)
    return Tried(*(part[useful] for part in parts))


def _differences(tried: Tried, values: Float[np.ndarray, "decision tried ..."]) -> Float[np.ndarray, "row ..."]:
    """Differences from the mean of a decision's candidates, weighted so that every part counts the same."""
    weight = np.sqrt(tried.share / np.sum(tried.share)).reshape(-1, *(1,) * (values.ndim - 1))
    return ((values - values.mean(axis=1, keepdims=True)) * weight).reshape(-1, *values.shape[2:])


def fitted(plain: Sequence[Tried], houses: Sequence[Tried]) -> Float[np.ndarray, "term"]:
    """Weights in cells, by least squares on the differences within decisions.

    Decisions on maps without classes determine the weights of the terms, in logarithms of actions. Those in houses
    determine what a cell of cost-to-go is worth relative to the weighted sum.

    Args:
      plain: decisions on maps without classes. Each part, such as those on maps of one size, counts the same.
      houses: decisions in houses, likewise.

    Raises:
      InputError: the cost-to-go or the weighted sum does not predict what searches in houses cost.
    """
    learned = [number for number in range(len(TERMS)) if number != _KEPT]
    terms = np.concatenate([_differences(part, part.terms[..., learned]) for part in plain])
    weights = np.zeros(len(TERMS))
    weights[learned] = np.linalg.lstsq(terms, np.concatenate([_differences(one, one.value) for one in plain]))[0]
    both = [_differences(part, np.stack([part.cost, part.terms @ weights], axis=-1)) for part in houses]
    targets = np.concatenate([_differences(part, part.value) for part in houses])
    of_cell, of_sum = np.linalg.lstsq(np.concatenate(both), targets)[0]
    if not of_cell > 0 or not of_sum > 0:
        raise InputError(
            f"the network's cost-to-go does not tell what searches in houses cost (weights {of_cell:.3g} and "
            f"{of_sum:.3g}); train it longer, or give more --houses"
        )
    weights *= of_sum / of_cell
    weights[_KEPT] = START["kept"]
    return weights.astype(np.float32)


class Round(NamedTuple):
    """A round of learning.

    Attributes:
      decisions: number of decisions tried.
      change: change of the mean logarithm of the actions on fresh maps with the new weights.
      error: its standard error.
      kept: whether the new weights are kept.
      weights: the weights after this round.
    """

    decisions: int
    change: float
    error: float
    kept: bool
    weights: dict[str, float]


def _searches(config: ScoreConfig, seed: int, part: int, share: float = 1.0) -> Searches:
    """Fresh searches on maps without classes of one size; in the last part, in procedural houses."""
    if part == len(config.sides):
        houses = drawn_houses("s", "train", max(1, round(share * config.houses)), seed, _HOUSE_CELLS)
        return searches_in([house.terrain for house in houses], config.starts, seed)
    count = max(1, round(share * config.maps))
    return searches_in(plugins("training_maps")["plain"].load()(count, seed, config.sides[part]), 1, seed)


def _compared(
    planner: LearnedScore, weights: Float[np.ndarray, "term"], config: ScoreConfig, seed: int
) -> tuple[float, float]:
    """Change of the mean logarithm of the actions on fresh maps by other weights, and its standard error over maps."""
    changed, changes = dataclasses.replace(planner, weights=jnp.asarray(weights)), []
    for part in range(len(config.sides) + 1):
        searches = _searches(config, seed, part, _JUDGED)
        starts = config.starts if part == len(config.sides) else 1
        changes.append((values(changed, searches) - values(planner, searches)).reshape(-1, starts).mean(axis=1))
    error = np.sqrt(np.sum([np.var(part) / len(part) for part in changes])) / len(changes)
    return float(np.mean([np.mean(part) for part in changes])), float(error)


def learn_score(out: Path, network: NetworkCostToGo, config: ScoreConfig) -> list[Round]:
    """Learn the weights of the score in rounds. Those whose files are in the folder are not run again.

    Args:
      out: folder for `round-*.json` and the decisions `round-*.npz`.
      network: network whose cost-to-go is part of the score.
      config: how to learn.

    Raises:
      InputError: see `fitted`.
    """
    n_parts, rounds = len(config.sides) + 1, list[Round]()
    tried: list[list[Tried]] = [[] for _ in range(n_parts)]
    weights = np.array([START.get(term, 0.0) for term in TERMS], np.float32)
    for number in range(1, config.rounds + 1):
        seed = 2 * (config.seed * _MOST_ROUNDS + number)
        rules = named_settings("paper", config.field_of_view).rules()
        planner = LearnedScore(rules, jnp.asarray(weights), network)
        for part in range(n_parts):
            path = out / f"round-{number}-{part + 1}.npz"
            if not path.exists():
                found = try_candidates(planner, _searches(config, seed, part))
                print(f"Round {number}, part {part + 1} of {n_parts}: {len(found.value)} decisions")
                with replacing(path) as unfinished:
                    np.savez(unfinished, **found._asdict())
            with np.load(path) as file:
                tried[part].append(Tried(**file))
        done = out / f"round-{number}.json"
        if not done.exists():
            better = fitted([one for part in tried[:-1] for one in part], tried[-1])
            change, error = _compared(planner, better, config, seed + 1)
            after = better if change < 0 else weights
            named = dict(zip(TERMS, map(float, after), strict=True))
            write_json(done, Round(sum(len(p[-1].value) for p in tried), change, error, change < 0, named)._asdict())
        rounds.append(Round(**read_object(done, "give another folder")))
        weights = np.array([rounds[-1].weights[term] for term in TERMS], np.float32)
        print(
            f"Round {number}: {100 * rounds[-1].change:+.1f} +- {100 * rounds[-1].error:.1f} % actions on fresh maps, "
            f"{'kept' if rounds[-1].kept else 'not kept'}"
        )
    return rounds
