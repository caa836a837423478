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

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import require_positive
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax.indoor.houses.dataset import indoor_house, indoor_houses
from dc2g_jax.indoor.maps.classes import GOALS, TARGETS
from dc2g_jax.indoor.maps.mapping import IndoorMapSettings
from dc2g_jax.indoor.search.agent import DECLARED
from dc2g_jax.indoor.search.evaluation import results_of
from dc2g_jax.indoor.search.guides import AgentName, agent_with, true_distance
from dc2g_jax.indoor.search.searches import Searches, reset, sample_episodes, site_of
from experiments.support.commands import HouseOption
from experiments.support.search_figures import RecordedSearch, animate_search, plot_prediction, plot_search
from experiments.support.search_moments import choose_legs, moment_of, prediction_at, run_search
from experiments.support.search_recording import record_search
from experiments.support.searches import AGENT_TITLES, CostMapOptions, SearchOptions

#: Number of moments in the figure.
_COLUMNS = 5


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(SearchOptions, CostMapOptions):
    """Search a house for an object and draw the search.

    Attributes:
      house: name of the house, such as `val-3`; the first one of the split by default.
      target: class of the object: bed, chair, sink, plant or couch; by default a random class in the house.
      agent: the agent that searches; see python -m experiments.objectnav_table1.
    """

    house: HouseOption = None
    target: Annotated[str | None, tyro.conf.arg(metavar="CLASS", help_behavior_hint="")] = None
    agent: AgentName = "promising"


def main(options: Options) -> None:
    """Search, draw, record and print the result."""
    require_positive(options, "samples", "limit")
    where, cell_size = (options.dataset, options.split), IndoorMapSettings.cell_size
    if options.house is None:
        house = indoor_houses(*where, count=1, cell_size=cell_size)[0]
    else:
        house = indoor_house(options.house, *where, cell_size=cell_size)
    (episode,) = sample_episodes([house], 1, seed=options.seed, target=options.target)
    agent = agent_with(options.agent, options.network, samples=options.samples, noise=options.noise)
    out = output_folder(options, "objectnav_fig5")
    site = site_of(house.world, house.name, agent)
    start, goal = jnp.array([episode.x, episode.y, episode.yaw], jnp.float32), TARGETS.index(episode.target)
    first = reset(jax.random.key(options.seed), (start, jnp.int32(goal)), agent, options.limit)
    print("Compiling, half a minute or so; then it searches.", file=sys.stderr)
    begun, robot = run_search(first, site, agent)

    track, steps = np.asarray(robot.track), int(robot.periods)
    ends = Searches(track[None], *(np.array([one]) for one in (robot.status == DECLARED, steps, robot.collisions)))
    (result,) = results_of(options.agent, [house], [episode], ends)
    to_goal = np.array([bool(one.guidance.to_goal) for one in begun])
    every = [moment_of(one, agent, options.agent) for one in begun]
    moments = [every[number] for number in choose_legs(to_goal, _COLUMNS)]
    search = RecordedSearch(house.world, GOALS[goal], track, every)
    plot_search(out / "fig5", dataclasses.replace(search, moments=moments))
    search_name = f"{house.name}, {episode.target}, {AGENT_TITLES[options.agent]}"
    if agent.estimator is not None:
        last = begun[max(np.flatnonzero(~to_goal), default=0)]
        knowing = dataclasses.replace(agent, true_distance=true_distance(house.world, agent))
        prediction = prediction_at(last, site, knowing)
        plot_prediction(out / "fig4", prediction, f"{search_name}, step {int(last.periods)}")
    animate_search(out / "search.gif", search)
    record_search(out / "search.rrd", search_name, search)
    facts = {
        **result._asdict(),
        "goal_reacher_leads": [int(one.periods) for one in begun if one.guidance.to_goal],
        "moments": [{"step": moment.step, "doing": moment.doing} for moment in moments],
    }
    write_json(out / "search.json", facts)
    outcome = "success" if result.success else "declared too early" if result.declared else "not found in time"
    print(f"{search_name}: {outcome} after {steps} steps ({steps / 10:g} s)")
    print(f"driven {result.driven:.1f} m, shortest path {result.shortest:.1f} m, collisions {result.collisions}")
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
