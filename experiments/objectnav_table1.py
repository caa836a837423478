"""Search houses for objects, as in Table I of the paper on dense cost maps: `python -m experiments.objectnav_table1`.

All agents run the same searches: the same houses, starts and targets. The paper used other houses (Matterport3D) and
another simulator, so its figures are shown for orientation only.
"""

import dataclasses
from typing import Any

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.errors import InputError
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.search.agent import Agent
from dc2g_jax.indoor.search.evaluation import AGENT_TITLES, PAPER_TABLE1, SearchSummary, table1
from dc2g_jax.indoor.search.guides import AgentName, agent_with, estimator_for
from experiments.support.searches import ComparisonOptions, CostMapOptions, compare


@dataclasses.dataclass(frozen=True)
class Options(ComparisonOptions, CostMapOptions):
    """Run the agents of Table I in unseen houses, and compare them with the paper's figures.

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
    network = estimator_for(options.agents, options.network)
    agents: dict[str, Agent] = {
        name: agent_with(name, network, options.samples, options.noise) for name in options.agents
    }

    def report(houses: list[IndoorHouse], summaries: dict[str, SearchSummary]) -> tuple[str, dict[str, Any]]:
        facts = {"agents": {name: one._asdict() for name, one in summaries.items()}, "paper": PAPER_TABLE1}
        return table1(summaries), facts

    compare("objectnav_table1", options, agents, AGENT_TITLES, report, network=network)


if __name__ == "__main__":
    command_line(Options, main)
