"""What the commands for object goals share: options, agents by name, `episodes.csv`, and what is said in the end."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from dc2g_jax.cli.common import NetworkOption
from dc2g_jax.cli.episodes import EpisodeProgress
from dc2g_jax.cli.outputs import CommandOptions
from dc2g_jax.datasets.houses import PROCEDURAL
from dc2g_jax.errors import InputError
from dc2g_jax.files.atomic import write_json
from dc2g_jax.files.digests import tree_sha256
from dc2g_jax.files.resources import resource
from dc2g_jax.objectnav.agent import (
    CONTROLLER,
    MPC,
    Agent,
    Guide,
    LookAround,
    RandomUntilSeen,
    Steering,
    usual_camera,
)
from dc2g_jax.objectnav.evaluation import Difference, SearchResult, difference, results_of
from dc2g_jax.objectnav.guides import GoalReacher, NearestFrontier, NoIdea, Predicted, PromisingFrontier, TrueCost
from dc2g_jax.objectnav.houses import IndoorHouse, indoor_houses
from dc2g_jax.objectnav.mapping import IndoorMapSettings
from dc2g_jax.objectnav.networks import CostMapEstimator
from dc2g_jax.objectnav.predicted_costs import PredictedCosts, load_costs
from dc2g_jax.objectnav.searches import TIME_LIMIT, Search, sample_episodes, search_all
from dc2g_jax.rollouts.results import ResumableTable

#: The network that comes with the package, and its encoder.
SHIPPED_INDOOR_NETWORK = "weights/cost_maps_indoors"

#: What may be an agent.
AgentName = Literal["true_cost", "random", "frontier", "predicted", "promising"]

#: Those that go by a network.
ON_NETWORK = ("promising", "predicted")

#: What tables call an agent.
AGENT_TITLES = {
    "true_cost": "true cost map",
    "random": "privileged random",
    "frontier": "frontier",
    "predicted": "predicted cost map",
    "promising": "predicted, at frontiers",
}


#: What is said under every table.
CAVEAT = (
    "The paper's houses differ from these (they are scanned homes, Matterport3D in the Habitat simulator), and so do "
    "its robot's speed and camera; its agent with true costs stops as soon as it sees the object: compare its lines "
    "with each other, not with ours."
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchOptions(CommandOptions):
    """Where objects are searched for.

    Attributes:
      houses: folder of ProcTHOR houses (`train`, `val` and `test`.jsonl.gz, `asset_boxes.json`), or `procedural` for
        the procedural floor plans.
      split: `test`, or `val` while anything is still being chosen.
      strict: refuse a file of houses for its first line that is none, instead of skipping it.
      count: houses, the first ones of the split.
      episodes: searches in each house, of random starts and targets.
      samples: copies of the plan that the controller drives at each step.
      limit: steps of 0.1 s after which a search ends without success.
      seed: of starts, targets and the robots' noise.
      resamples: draws of houses for the bootstrap intervals.
    """

    houses: Annotated[str, tyro.conf.arg(metavar="FOLDER")] = PROCEDURAL
    split: Literal["val", "test"] = "test"
    strict: bool = False
    count: int = 8
    episodes: int = 40
    samples: int = CONTROLLER.samples
    limit: int = TIME_LIMIT
    seed: int = 0
    resamples: int = 10_000

    def check(self) -> None:
        """Refuse numbers that are none.

        Raises:
          InputError: names the option.
        """
        for name in ("count", "episodes", "samples", "limit", "resamples"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name} {getattr(self, name)}: give 1 or more")

    def places(self) -> tuple[list[IndoorHouse], list[Search]]:
        """The houses, and the searches to be made in them."""
        houses = indoor_houses(
            self.houses, self.split, count=self.count, cell_size=IndoorMapSettings.cell_size, strict=self.strict
        )
        return houses, sample_episodes(houses, self.episodes, seed=self.seed)

    @property
    def described(self) -> str:
        """The houses in words."""
        kind = "procedural floor plans" if self.houses == PROCEDURAL else f"houses of {self.houses}"
        return f"{self.count} {kind}, {self.split}"


def open_costs(folder: NetworkOption) -> PredictedCosts[CostMapEstimator]:
    """The network in a folder, or the one that comes with the package."""
    return load_costs(resource(SHIPPED_INDOOR_NETWORK) if folder is None else folder)


def costs_for(agents: Iterable[str], folder: NetworkOption) -> PredictedCosts[CostMapEstimator] | None:
    """The network in a folder, see `open_costs`, if one of these agents goes by a network."""
    return open_costs(folder) if set(ON_NETWORK) & set(agents) else None


def digests(houses: Sequence[IndoorHouse], **networks: Any) -> dict[str, str]:
    """SHA-256 by option of what searches depend on and a folder may hold another of when they are resumed.

    Args:
      houses: searched.
      networks: by option, `PredictedCosts` or a mapping of them; those that are `None` are left out.
    """
    given = {"houses": [house.world for house in houses], **networks}
    return {name: tree_sha256(tree) for name, tree in given.items() if tree is not None}


def agent_with(name: str, costs: PredictedCosts | None, samples: int = CONTROLLER.samples) -> Agent:
    """An agent. Those that explore by a rule look around first.

    Args:
      name: one of `AgentName`.
      costs: of the network, for agents that go by one.
      samples: copies of the plan that the controller drives at each step.
    """
    steering: Steering = LookAround(MPC())
    guide: Guide
    if name == "true_cost":
        guide, steering = TrueCost(), MPC()
    elif name == "random":
        guide, steering = GoalReacher(NoIdea()), RandomUntilSeen()
    elif name == "frontier":
        guide = GoalReacher(NearestFrontier())
    elif costs is None:
        raise InputError(f"the agent {name} goes by a network; give one")
    else:
        guide = GoalReacher(Predicted(costs) if name == "predicted" else PromisingFrontier(costs))
    return Agent(
        guide=guide,
        steering=steering,
        camera=usual_camera(),
        controller=dataclasses.replace(CONTROLLER, samples=samples),
    )


class SearchTable(ResumableTable[SearchResult]):
    """`episodes.csv`: one line a search and agent, written anew whenever an agent has made all of its searches.

    Args:
      path: the file.

    Raises:
      InputError: the file is there and cannot be read.
    """

    def __init__(self, path: Path):
        super().__init__(path, SearchResult)

    def run(
        self,
        name: str,
        agent: Callable[[], Agent],
        houses: Sequence[IndoorHouse],
        episodes: Sequence[Search],
        options: SearchOptions,
    ) -> list[SearchResult]:
        """Results of an agent's searches, made now or earlier.

        Args:
          name: of the agent, its column in the table.
          agent: makes it; not called for searches that are there.
          houses: those of the episodes.
          episodes: the searches.
          options: time limit and seed.

        Raises:
          InputError: the file holds other searches.
        """
        progress = EpisodeProgress()

        def search() -> list[SearchResult]:
            searches = search_all(
                agent(), houses, episodes, limit=options.limit, seed=options.seed,
                on_progress=lambda finished: progress(name, finished, len(episodes)),
            )  # fmt: skip
            return results_of(name, houses, episodes, searches)

        return self.next_results([(*episode, name) for episode in episodes], search)


def conclude(
    out: Path,
    options: SearchOptions,
    houses: Sequence[IndoorHouse],
    results: Mapping[str, Sequence[SearchResult]],
    titles: Mapping[str, str],
    table: str,
    facts: Mapping[str, Any],
) -> None:
    """Print a table and how the last of its lines compares with the others, and write `results.json`.

    Args:
      out: folder to write to.
      options: of the command.
      houses: where the searches were made.
      results: the same searches for each line of the table, by its name.
      titles: what the lines are called, by name.
      table: as text.
      facts: what `results.json` holds beside houses, split and differences.
    """
    *others, last = results
    gains = {name: difference(results[last], results[name], resamples=options.resamples) for name in others}
    print(f"\n{table}\n{CAVEAT}")
    for name, gain in gains.items():
        print(f"{titles[last]} against {titles[name]}: {_in_words(gain)}")
    found = {
        "houses": [house.name for house in houses],
        "split": options.split,
        "note": CAVEAT,
        **facts,
        "differences": {name: gain._asdict() for name, gain in gains.items()},
    }
    write_json(out / "results.json", found)
    print(f"Written to {out}: {', '.join(sorted(path.name for path in out.iterdir()))}")


def _in_words(one: Difference) -> str:
    success, spl = (
        f"{gain:+.3f} ({low:+.3f} to {high:+.3f})"
        for gain, (low, high) in ((one.success, one.success_interval), (one.spl, one.spl_interval))
    )
    return f"success {success}, SPL {spl}"
