"""Search houses for objects, as in Table I of the paper on dense cost maps: `python -m experiments.objectnav_table1`.

All agents run the same searches: the same houses, starts and targets. The paper used other houses (Matterport3D) and
another simulator, so its figures are shown for orientation only.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.files.tables import text_table
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.learning.networks import load_costs
from dc2g_jax.indoor.search.agent import Agent
from dc2g_jax.indoor.search.guides import ON_NETWORK, AgentName, agent_with
from experiments.support.searches import (
    AGENT_TITLES,
    ComparisonOptions,
    CostMapOptions,
    SearchSummary,
    compare,
    with_interval,
)

#: Table I of the paper, by the names of `SearchSummary`. `predicted` is its "Our Approach".
PAPER_TABLE1: dict[str, dict[str, Any]] = {
    name: dict(zip(("success", "spl", "distance", "steps", "acceleration", "jerk"), line, strict=True))
    for name, line in {
        "true_cost": (1.000, 0.922, 0.211, 147.459, (0.15, 2.041), (2.371, 35.006)),
        "random": (0.250, 0.208, 7.214, 402.795, (1.607, 8.920), (28.004, 156.095)),
        "predicted": (0.447, 0.329, 4.542, 327.877, (0.673, 7.318), (11.788, 128.158)),
    }.items()
}


@dataclasses.dataclass(frozen=True)
class Options(ComparisonOptions, CostMapOptions):
    """Run the agents of Table I in unseen houses, and compare them with the paper's figures.

    Attributes:
      agents: agents to run: true_cost knows the path; random drives at random until it sees its target; frontier goes
        to the nearest frontier; predicted follows the costs that the network predicts, as the paper's agent does;
        promising goes to the frontier with the least predicted cost plus distance.
    """

    agents: tuple[AgentName, ...] = ("true_cost", "random", "frontier", "predicted", "promising")


def table1(summaries: Mapping[str, SearchSummary]) -> str:
    """Table I: a row for each agent, given by name, followed by the paper's row if it has one."""

    def row(title: str, one: Mapping[str, Any], share: Callable[[Any], str]) -> list[str]:
        pairs = ("{:.2f}, {:.2f}".format(*one[name]) for name in ("acceleration", "jerk"))
        shares = (share(one[name]) for name in ("success", "spl"))
        return [title, *shares, f"{one['distance']:.2f}", f"{one['steps']:.1f}", *pairs]

    columns = ["", "success (95 %)", "SPL (95 %)", "DTS m", "steps", "acc m/s2, rad/s2", "jerk m/s3, rad/s3"]
    rows = []
    for name, one in summaries.items():
        rows.append(row(AGENT_TITLES[name], one._asdict(), with_interval))
        if name in PAPER_TABLE1:
            rows.append(row("the paper's", PAPER_TABLE1[name], "{:.3f}".format))
    return text_table(columns, rows)


def main(options: Options) -> None:
    """Run the agents; print and write the table."""
    if not options.agents or len(set(options.agents)) < len(options.agents):
        raise InputError(f"--agents {' '.join(options.agents)}: give each agent once, one at least")
    network = load_costs(options.network) if {*ON_NETWORK} & {*options.agents} else None
    agents: dict[str, Agent] = {
        name: agent_with(name, network, samples=options.samples, noise=options.noise) for name in options.agents
    }

    def report(houses: list[IndoorHouse], summaries: dict[str, SearchSummary]) -> tuple[str, dict[str, Any]]:
        facts = {"agents": {name: one._asdict() for name, one in summaries.items()}, "paper": PAPER_TABLE1}
        return table1(summaries), facts

    compare("objectnav_table1", options, agents, AGENT_TITLES, report, network=network)


if __name__ == "__main__":
    command_line(Options, main)
