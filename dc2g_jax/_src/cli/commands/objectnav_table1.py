"""Search houses for objects, as in Table I of the paper on dense cost maps: `python -m experiments.objectnav_table1`.

All agents run the same searches: the same houses, starts and targets. The paper used other houses (Matterport3D) and
another simulator, so its figures are shown for orientation only.
"""

import dataclasses
import functools
import time

from dc2g_jax._src.cli.common import command_line, digests
from dc2g_jax._src.cli.options import NetworkOptions
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.cli.searches import ComparisonOptions, conclude, run_searches
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.files.digests import tree_sha256
from dc2g_jax._src.rollouts.results import ResumableTable
from dc2g_jax._src.search_indoors.search.evaluation import AGENT_TITLES, PAPER_TABLE1, SearchResult, summarize, table1
from dc2g_jax._src.search_indoors.search.named import AgentName, agent_with, costs_for


@dataclasses.dataclass(frozen=True)
class Options(ComparisonOptions, NetworkOptions):
    """Run the agents of Table I in unseen houses, and compare them with the paper's figures.

    Networks come from experiments.objectnav_train.

    Attributes:
      agents: agents to run: true_cost knows the path; random drives at random until it sees its target; frontier goes
        to the nearest frontier; predicted follows the costs that the network predicts, as the paper's agent does;
        promising goes to the frontier with the least predicted cost plus distance.
    """

    agents: tuple[AgentName, ...] = ("true_cost", "random", "frontier", "predicted", "promising")


def main(options: Options) -> None:
    """Run the agents; print and write the table."""
    if not options.agents or len(set(options.agents)) < len(options.agents):
        raise InputError(f"--agents {' '.join(options.agents)}: give each agent once, one at least")
    costs = costs_for(options.agents, options.network)
    houses, episodes = options.places()
    inputs = {"dataset": tree_sha256([house.world for house in houses]), **digests(network=costs)}
    out = output_folder(options, "objectnav_table1", inputs=inputs)
    searches, all_results = ResumableTable(out / "episodes.csv", SearchResult), dict[str, list[SearchResult]]()
    for name in options.agents:
        began = time.perf_counter()
        agent = functools.partial(agent_with, name, costs, options.samples)
        all_results[name] = run_searches(searches, name, agent, houses, episodes, options)
        print(f"{AGENT_TITLES[name]}: {len(episodes)} searches, {time.perf_counter() - began:.0f} s", flush=True)
    summaries = {name: summarize(results, resamples=options.resamples) for name, results in all_results.items()}
    facts = {
        "agents": {name: one._asdict() for name, one in summaries.items()},
        "paper": {name: one._asdict() for name, one in PAPER_TABLE1.items()},
    }
    text = f"{len(episodes)} searches in {options.described}\n{table1(summaries)}"
    conclude(out, options, houses, all_results, AGENT_TITLES, text, facts)


if __name__ == "__main__":
    command_line(Options, main)
