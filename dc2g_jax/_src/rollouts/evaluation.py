"""Evaluate planners from given starts in houses, relative to the oracle (paper, section IV-B)."""

import collections
import functools
import itertools
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, UInt8

from dc2g_jax._src.estimation.estimators import Estimator, trait
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.files.cache import keep_compiled_programs
from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.ground import connected_to_goal, largest_piece, longest_way
from dc2g_jax._src.grid.poses import Pose, make_pose
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.terrain import TRAVERSABLE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.named import NETWORK_PLANNERS, check_names, planner_with
from dc2g_jax._src.planning.planners import GAVE_UP, MODE_NAMES, Oracle, PlannerLike, sensing_of
from dc2g_jax._src.planning.rules import Rules, Settings, named_settings
from dc2g_jax._src.readers.houses import House, HouseDataset, open_dataset, stack_worlds
from dc2g_jax._src.readers.starts import Start, any_ground, check_starts, sample_starts, usable_houses
from dc2g_jax._src.rollouts.results import EpisodeResult, Results, action_letters
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT, Trajectories, rollout
from dc2g_jax._src.rollouts.statistics import extra_steps
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number, short
from dc2g_jax._src.runtime.progress import EpisodeProgress

#: Cells of a map per action of its step limit: the published maps, of 50 x 50 cells, have a limit of 500.
_CELLS_A_STEP = 50 * 50 // STEP_LIMIT

#: Actions for each cell of the longest way to a goal, at least.
_STEPS_A_CELL_OF_WAY = 4

#: An estimator, or the place of a trained network; `None` for the shipped network.
Network = Estimator | str | os.PathLike[str] | None

#: A planner's name, a planner, or a class or function that makes one from the rules of an episode.
PlannerSource = str | PlannerLike | Callable[[Rules], PlannerLike]

#: Names for `planner_with`; or a mapping from a name of your choice to one of these, or to another source.
Planners = Iterable[str] | Mapping[str, PlannerSource]


def episodes_from(starts: Sequence[Start], index: Mapping[str, int]) -> tuple[Int[Array, "episodes"], Pose]:
    """Index of the world and first pose of each episode, for `rollout`, given each house's index in the stack.

    Raises:
      InputError: a start is in another house.
    """
    for house in {start.house for start in starts} - index.keys():
        check_name("house of a start", house, index)
    table = np.array([(index[start.house], start.x, start.y, start.heading) for start in starts], np.int32)
    world, x, y, heading = table.reshape(-1, 4).T
    return jnp.asarray(world), make_pose(x, y, heading)


def _default_step_limit(terrain: UInt8[np.ndarray, "h w"]) -> int:
    """Actions that a map may need by its size, its ground, and its longest way to a goal."""
    to_goal = connected_to_goal(terrain)
    ground = max(int(np.sum(to_goal)), int(np.sum(largest_piece(TRAVERSABLE[terrain] & ~to_goal))))
    return max(min(terrain.size // _CELLS_A_STEP, ground), _STEPS_A_CELL_OF_WAY * longest_way(terrain))


def _estimates_nan(
    estimator: Estimator, world: World, start: Pose, actions: Int[Array, "t"], *, sensing: Kernel
) -> bool:
    """Whether an estimate is NaN after these actions. Planners give up then, as where nothing is left to explore."""

    def act(belief: Belief, action: Array) -> tuple[Belief, None]:
        return gridworld.step(world, belief, action, sensing), None

    belief, _ = jax.lax.scan(act, gridworld.reset(world, start, sensing), actions)
    part = trait(estimator, "extent").part(belief.terrain, belief.pose)
    return bool(jnp.any(jnp.isnan(estimator.estimate(part, estimator.init(world)))))


class Runner:
    """Runs planners from given starts in the houses of one dataset, all episodes of a planner at once.

    Args:
      dataset: the houses.
      settings: rules by sensing range.
      step_limit: actions after which an episode ends without success; `None` for the most that any map needs: an action
        for every five cells, but no more than for every cell of ground that leads to a goal, or of the largest ground
        cut off from all goals; four for every cell of its longest way to a goal; 500, as on the published maps.
      progress: called as `progress(planner, finished, episodes)` between calls of the device.

    Attributes:
      step_limit: actions after which an episode ends without success.

    Raises:
      InputError: the step limit is less than 1.
    """

    def __init__(
        self,
        dataset: HouseDataset,
        settings: Settings,
        *,
        step_limit: int | None = None,
        progress: Callable[[str, int, int], None] | None = None,
    ):
        self._dataset = dataset
        # All houses of a size, even unused ones, so that the same compiled program serves all calls.
        by_size: dict[tuple[int, ...], list[House]] = collections.defaultdict(list)
        for house in dataset.houses:
            by_size[house.terrain.shape].append(house)
        self._worlds = {size: stack_worlds(houses) for size, houses in by_size.items()}
        self._size = {house.name: house.terrain.shape for house in dataset.houses}
        self._index = {house.name: number for houses in by_size.values() for number, house in enumerate(houses)}
        self._settings = settings
        if step_limit is None:
            step_limit = max([STEP_LIMIT, *(_default_step_limit(house.terrain) for house in dataset.houses)])
        check_number("step limit", step_limit, whole=True, least=1, hint="(--step-limit)")
        self.step_limit = step_limit
        self._progress = progress
        self._oracle_steps: dict[tuple[Rules, tuple[Start, ...]], list[int | None]] = {}

    def rules(self, start: Start) -> Rules:
        """The rules of an episode.

        Raises:
          InputError: the start has an expanding range, and the rules have no frontier-expanding kernel.
        """
        return self._settings.rules(start.sensing_range, start.expanding_range)

    def trajectories(self, planner: PlannerLike, rules: Rules, starts: Sequence[Start], name: str = "") -> Trajectories:
        """Run one planner from every start, ignoring the ranges of the starts.

        Args:
          planner: the planner.
          rules: rules with the robots' field of view.
          starts: first poses, in houses of one size.
          name: name for progress reports.

        Raises:
          InputError: no episode can start at one of the starts, the houses differ in size, or the planner lacks a part
            of the protocol, or gives up because its estimator estimates NaN.
        """
        check_starts(starts, self._dataset, ground_of=any_ground)
        sizes = {self._size[start.house] for start in starts}
        if len(sizes) != 1:
            raise InputError(f"starts in houses of {len(sizes)} sizes; give starts in houses of one size")
        worlds = self._worlds[sizes.pop()]
        for needed in ("init", "plan"):
            if not hasattr(planner, needed):
                who = name or type(planner).__name__
                raise InputError(f"planner {who!r}: has no {needed}; dc2g_jax.check_planner tells what a planner needs")
        index, poses = episodes_from(starts, self._index)

        def report(finished: int) -> None:
            if self._progress is not None:
                self._progress(name, finished, len(starts))

        report(0)  # before minutes of compilation, perhaps
        done = rollout(
            planner, worlds, index, poses, sensing=rules.sensing, step_limit=self.step_limit, on_progress=report
        )
        estimator, gave_up = getattr(planner, "estimator", None), np.flatnonzero(done.mode == GAVE_UP)
        if estimator is not None and gave_up.size:
            first = int(gave_up[0])
            world = jax.tree.map(lambda leaf: leaf[..., index[first]], worlds)
            pose = jax.tree.map(lambda leaf: leaf[first], poses)
            actions = jnp.asarray(done.actions[first][: done.steps[first]], jnp.int32)
            if _estimates_nan(estimator, world, pose, actions, sensing=rules.sensing):
                raise InputError(
                    f"planner {name or type(planner).__name__}: {type(estimator).__name__} estimates NaN in house "
                    f"{starts[first].house} after {len(actions)} actions; give an estimator of numbers"
                )
        return done

    def run(
        self, starts: Sequence[Start], planners: Planners, network: Estimator | Mapping[str, Estimator] | None = None
    ) -> list[EpisodeResult]:
        """Run planners from every start. Where no goal can be reached, the robot explores until it gives up.

        Args:
          starts: first poses; each may have its own ranges.
          planners: see `Planners`. The name `oracle` is reserved for the oracle of the package.
          network: network of the planners that need one, or several by name, see `by_name`.

        Returns:
          Results, planner by planner in the given order, each in the order of the starts.

        Raises:
          InputError: no episode can start at one of the starts, a planner is unknown or was made for another field of
            view, another planner is called `oracle`, the oracle does not reach a goal in reach within the step limit,
            or a start has an expanding range and the rules have no frontier-expanding kernel.
        """
        named = by_name(planners, network)
        if named.get("oracle", "oracle") != "oracle":
            raise InputError(
                "planner oracle: the name is reserved for the oracle that all are compared with; use another"
            )
        check_starts(starts, self._dataset, ground_of=any_ground)
        together: dict[tuple[Any, ...], list[int]] = collections.defaultdict(list)
        for number, start in enumerate(starts):
            together[start.sensing_range, start.expanding_range, self._size[start.house]].append(number)
        results: dict[tuple[str, int], EpisodeResult] = {}
        for numbers in together.values():
            chosen = tuple(starts[number] for number in numbers)
            rules = self.rules(chosen[0])
            oracle: Trajectories | None = None
            if "oracle" in named or (rules, chosen) not in self._oracle_steps:
                oracle = self.trajectories(Oracle(), rules, chosen, "oracle")
                too_far = ~oracle.success & (oracle.mode != GAVE_UP)
                if np.any(too_far):
                    raise InputError(
                        f"{chosen[int(np.argmax(too_far))]}: even with the map known no goal is reached within "
                        f"{self.step_limit} actions; give a larger step limit, or start elsewhere"
                    )
                reached = zip(oracle.steps.tolist(), oracle.success, strict=True)
                self._oracle_steps[rules, chosen] = [steps if success else None for steps, success in reached]
            for name, source in named.items():
                done = oracle if name == "oracle" else None
                if done is None:
                    done = self.trajectories(_made(name, source, rules), rules, chosen, name)
                steps = zip(done.steps.tolist(), self._oracle_steps[rules, chosen], strict=True)
                for row, (number, (taken, shortest)) in enumerate(zip(numbers, steps, strict=True)):
                    extra = None if shortest is None else extra_steps(taken, shortest)
                    results[name, number] = EpisodeResult(
                        *chosen[row][:4], rules.sensing.radius, rules.expanding_range, name, bool(done.success[row]),
                        taken, shortest, extra, MODE_NAMES[done.mode[row]], action_letters(done, row),
                    )  # fmt: skip
        return [results[name, number] for name in named for number in range(len(starts))]


def by_name(planners: Planners, network: Estimator | Mapping[str, Estimator] | None = None) -> dict[str, PlannerSource]:
    """Planners by the names that they have in results, each once.

    Planners that need a network get it. If there are several networks by name, there is one for each, called
    `planner (network)`.
    """
    named = planners if isinstance(planners, Mapping) else {name: name for name in planners}
    networks = network if isinstance(network, Mapping) else {"": network}
    found: dict[str, PlannerSource] = {}
    for name, source in named.items():
        if not isinstance(source, str) or source not in NETWORK_PLANNERS:
            found[name] = source
            continue
        for label, estimator in networks.items():
            label = f"{name} ({label})" if label else name
            found[label] = functools.partial(planner_with, source, estimator=estimator)
    return found


def open_networks(
    networks: Network | Mapping[str, Network] | Sequence[str | os.PathLike[str]],
) -> Estimator | dict[str, Estimator]:
    """Load one network, or several by name. Several places are called by as much of their end as differs.

    Raises:
      InputError: a network cannot be read, or there is no network or one twice.
    """
    if isinstance(networks, Sequence) and not isinstance(networks, str):
        if len(networks) == 1:
            return load_network(networks[0])
        networks = _labels(networks)
    if not isinstance(networks, Mapping):
        return load_network(networks)
    if not networks:
        raise InputError("network: give one at least, or None for the shipped one")
    return {label: load_network(place) for label, place in networks.items()}


def _labels(places: Sequence[str | os.PathLike[str]]) -> dict[str, str | os.PathLike[str]]:
    """Places by their last parts, as many of them as tell all places apart; for means, by those of each network."""
    members = [tuple(Path(one).parts for one in str(place).split(",")) for place in places]
    if len(set(members)) < len(members):
        raise InputError(f"networks {short(list(map(str, places)))}: give each once")

    def labels(count: int) -> list[str]:
        return [",".join("/".join(parts[-count:]) for parts in own) for own in members]

    count = next(count for count in itertools.count(1) if len({*labels(count)}) == len(places))
    return dict(zip(labels(count), places, strict=True))


def evaluate(
    planners: str | Planners | PlannerLike,
    dataset: HouseDataset | str | os.PathLike[str] | None = None,
    *,
    split: str = "test",
    starts: Sequence[Start] | None = None,
    starts_per_house: int = 10,
    seed: int = 0,
    settings: str | Settings = "paper",
    sensing_range: int | None = None,
    field_of_view: float | None = None,
    network: Network | Mapping[str, Network] | Sequence[str | os.PathLike[str]] = None,
    step_limit: int | None = None,
    progress: Callable[[str, int, int], None] | bool = True,
) -> Results:
    """Run planners from the same starts and compare each episode with the oracle's.

    Compiled programs are kept on disk, see `files.cache.keep_compiled_programs`.

    ```
    results = dc2g_jax.evaluate(["frontier", "dc2g"], "procedural", split="val")
    results = dc2g_jax.evaluate({"mine": MyPlanner, "frontier": "frontier"}, "procedural", split="val")
    print(results)
    ```

    Args:
      planners: names, each one of `dc2g_jax.PLANNERS` or `package.module:Class`; or a mapping from a name of your
        choice to one of these, to a planner, or to a function or class that makes a planner from the rules.
      dataset: houses, a folder of them, or a name such as `procedural`; `None` for the published ones, see
        `open_dataset`.
      split: split of the houses to sample starts in: `train`, `val` or `test`.
      starts: first poses; `None` to sample them.
      starts_per_house: number of sampled starts in each house.
      seed: seed of the sampled starts.
      settings: the rules, one of `dc2g_jax.SETTINGS` or its name.
      sensing_range: range of the field of view in cells, for starts without one; `None` for the settings' default.
      field_of_view: width of the field of view in degrees, 1 to 360; `None` for that of the settings, 90.
      network: network of the planners that need one: an estimator or the folder of a trained network; `None` for the
        shipped network. Several of them, as a mapping from a name of your choice or as a list of folders, are compared:
        planners that need a network are run with each, and called `dc2g (name)` in the results.
      step_limit: actions after which an episode ends without success; `None` for the default for the maps' size, see
        `Runner`.
      progress: whether to show a progress bar for each planner in the error stream; or a function, called as
        `progress(planner, finished, episodes)` between calls of the device.

    Raises:
      InputError: an argument is invalid, no episode can be run in any house, or a planner was made for another field of
        view than that of the episodes.
    """
    keep_compiled_programs()
    if isinstance(planners, str) or not isinstance(planners, Iterable):
        planners = [planners]
    if not isinstance(planners, Mapping):
        for name in (planners := list(planners)):
            if not isinstance(name, str):
                raise InputError(f"planner {short(name)}: is no name; give a mapping, such as {{'mine': MyPlanner}}")
        planners = {name: name for name in planners}
    sources = [source for source in planners.values() if isinstance(source, str)]
    check_names(sources)
    settings = named_settings(settings, field_of_view)
    settings.rules(sensing_range)
    estimator = open_networks(network) if NETWORK_PLANNERS.keys() & set(sources) else None
    if not isinstance(dataset, HouseDataset | str | os.PathLike | None):
        raise InputError(f"dataset {short(type(dataset).__name__)}: give a `HouseDataset`, a folder of maps, or a name")
    if not isinstance(dataset, HouseDataset):
        dataset = open_dataset(dataset, split=split if starts is None else None)
    if starts is None:
        houses = usable_houses(dataset, split, instead="use another split")
        starts = sample_starts(houses, starts_per_house, seed=seed)
    else:
        check_starts(starts, dataset)
    if sensing_range is not None:
        starts = [start._replace(sensing_range=start.sensing_range or sensing_range) for start in starts]
    told = progress if callable(progress) else EpisodeProgress(leave=False) if progress else None
    runner = Runner(dataset, settings, step_limit=step_limit, progress=told)
    return Results(runner.run(starts, planners, estimator))


def _made(name: str, source: PlannerSource, rules: Rules) -> PlannerLike:
    """Make a planner and check that it uses the episodes' field of view."""
    if isinstance(source, str):
        return planner_with(source, rules)
    ready = hasattr(source, "plan") and not isinstance(source, type)
    planner: Any = source if ready else source(rules)  # type: ignore[operator]
    sensing_of(planner, rules.sensing, name)
    return planner
