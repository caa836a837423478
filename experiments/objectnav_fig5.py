"""Draw a search for an object, as in Figs. 4 and 5 of the paper on dense cost maps.

`python -m experiments.objectnav_fig5`. For several moments, Fig. 5 shows the house, the robot's map, and the costs and
sampled plans of its controller. For an agent with a network, Fig. 4 shows its last prediction before an object of the
wanted class is in the map, next to the truth.
"""

import dataclasses
import sys
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from dc2g_jax.cli.common import HouseOption, command_line
from dc2g_jax.cli.options import NetworkOptions, require_positive
from dc2g_jax.cli.outputs import output_folder, print_files
from dc2g_jax.cli.searches import AGENT_TITLES, AgentName, SearchOptions, agent_with, costs_for
from dc2g_jax.datasets.houses import PROCEDURAL
from dc2g_jax.errors import InputError
from dc2g_jax.files.atomic import write_json
from dc2g_jax.inspection.search_figures import plot_prediction, plot_search
from dc2g_jax.inspection.search_moments import choose_legs, moment_of, prediction_at, run_search
from dc2g_jax.objectnav.agent import DECLARED, reset, site_of
from dc2g_jax.objectnav.classes import GOALS, OBJECT_CLASSES
from dc2g_jax.objectnav.evaluation import results_of
from dc2g_jax.objectnav.houses import IndoorHouse, indoor_houses
from dc2g_jax.objectnav.mapping import IndoorMapSettings
from dc2g_jax.objectnav.searches import Search, Searches, sample_episodes
from dc2g_jax.objectnav.starts import sample_starts

#: Number of moments in the figure.
_COLUMNS = 5


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(SearchOptions, NetworkOptions):
    """Search a house for an object and draw the search.

    Networks come from experiments.objectnav_train.

    Attributes:
      house: name of the house, such as `val-3`; the first one of the split by default.
      target: class of the object: bed, chair, sink, plant or couch; by default a random class in the house.
      agent: the agent that searches; see experiments.objectnav_table1.
    """

    house: HouseOption = None
    target: Annotated[str | None, tyro.conf.arg(metavar="CLASS", help_behavior_hint="")] = None
    agent: AgentName = "promising"


def house_of(options: Options) -> IndoorHouse:
    """The house to search in.

    Raises:
      InputError: no house of the split has that name.
    """
    count = 1 if options.house is None else None
    if options.houses == PROCEDURAL and options.house is not None:
        split, _, number = options.house.rpartition("-")
        if split != options.split or not number.isdecimal():
            raise InputError(
                f"--house {options.house}: the procedural houses of the split {options.split} are called "
                f"{options.split}-0, {options.split}-1 and so on; give one of these, or another --split"
            )
        count = int(number) + 1  # procedural houses are unlimited
    houses = indoor_houses(options.houses, options.split, count=count, cell_size=IndoorMapSettings.cell_size)
    for house in houses:
        if options.house in (None, house.name):
            return house
    raise InputError(
        f"--house {options.house}: {options.houses} has no such house in its split {options.split}; "
        f"give one from {houses[0].name} to {houses[-1].name}"
    )


def episode_in(house: IndoorHouse, options: Options) -> Search:
    """The search to run.

    Raises:
      InputError: the target is not a goal class, or the house has no reachable object of this class.
    """
    if options.target is None:
        return sample_episodes([house], 1, seed=options.seed)[0]
    rng = np.random.default_rng([options.seed, *house.name.encode()])
    starts = {OBJECT_CLASSES[goal]: sample_starts(house.world, goal, 1, rng=rng) for goal in GOALS}
    there = [name for name, drawn in starts.items() if len(drawn)]
    if options.target not in there:
        raise InputError(
            f"--target {options.target}: cannot be searched for in {house.name}; "
            f"give one of: {', '.join(there)}; or another --house"
        )
    return Search(house.name, options.target, *starts[options.target][0].tolist())


def main(options: Options) -> None:
    """Search, draw and print the result."""
    require_positive(options, "samples", "limit")
    house = house_of(options)
    episode = episode_in(house, options)
    costs = costs_for([options.agent], options.network)
    agent = agent_with(options.agent, costs, options.samples)
    out = output_folder(options, "objectnav_fig5")
    site = site_of(house.world, house.name, agent.controller.limits.radius)
    target = OBJECT_CLASSES.index(episode.target)
    start, goal = jnp.array([episode.x, episode.y, episode.yaw], jnp.float32), jnp.int32(GOALS.index(target))
    first = reset(jax.random.key(options.seed), start, goal, agent, options.limit)
    print("Compiling, half a minute or so; then it searches.", file=sys.stderr)
    begun, robot = run_search(first, site, agent)

    track, steps = np.asarray(robot.track), int(robot.periods)
    ends = Searches(track[None], *(np.array([one]) for one in (robot.status == DECLARED, steps, robot.bumps)))
    (result,) = results_of(options.agent, [house], [episode], ends)
    to_goal = np.array([bool(one.guidance.to_goal) for one in begun])
    moments = [moment_of(begun[number], agent, options.agent) for number in choose_legs(to_goal, _COLUMNS)]
    plot_search(out / "fig5", house.world, target, track, moments)
    search_name = f"{house.name}, {episode.target}, {AGENT_TITLES[options.agent]}"
    if costs is not None:
        last = begun[max(np.flatnonzero(~to_goal), default=0)]
        plot_prediction(
            out / "fig4", prediction_at(last, site, agent, costs), f"{search_name}, step {int(last.periods)}"
        )
    facts = {
        **result._asdict(),
        "goal_reacher_leads": [int(one.periods) for one in begun if one.guidance.to_goal],
        "moments": [{"step": moment.step, "doing": moment.doing} for moment in moments],
    }
    write_json(out / "search.json", facts)
    outcome = "success" if result.success else "declared too early" if result.declared else "not found in time"
    print(f"{search_name}: {outcome} after {steps} steps ({steps / 10:g} s)")
    print(f"driven {result.driven:.1f} m, shortest path {result.shortest:.1f} m, bumps {result.bumps}")
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
