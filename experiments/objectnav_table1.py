"""Search houses for objects, as in Table I of the paper on dense cost maps: `python -m experiments.objectnav_table1`.

All agents run the same searches: the same houses, starts and targets. The paper used other houses (Matterport3D) and
another simulator, so its figures are shown for orientation only.
"""

import dataclasses
import functools
import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from dc2g_jax.cli.common import command_line, digests
from dc2g_jax.cli.options import NetworkOptions
from dc2g_jax.cli.outputs import output_folder
from dc2g_jax.cli.searches import (
    AGENT_TITLES,
    AgentName,
    ComparisonOptions,
    agent_with,
    conclude,
    costs_for,
    run_searches,
)
from dc2g_jax.errors import InputError
from dc2g_jax.objectnav.evaluation import SearchResult, SearchSummary, summarize
from dc2g_jax.rollouts.results import ResumableTable


class Table1Line(NamedTuple):
    """A row of Table I of the paper; see `SearchSummary`."""

    success: float
    spl: float
    distance: float
    steps: float
    acceleration: tuple[float, float]
    jerk: tuple[float, float]


#: Table I of the paper, on its houses. `predicted` is its "Our Approach".
PAPER_TABLE1 = {
    "true_cost": Table1Line(1.000, 0.922, 0.211, 147.459, (0.15, 2.041), (2.371, 35.006)),
    "random": Table1Line(0.250, 0.208, 7.214, 402.795, (1.607, 8.920), (28.004, 156.095)),
    "predicted": Table1Line(0.447, 0.329, 4.542, 327.877, (0.673, 7.318), (11.788, 128.158)),
}


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


def table(summaries: Mapping[str, SearchSummary]) -> str:
    """Table I as text: a row per agent, followed by the paper's row if it has one."""
    columns = ("success (95 %)", "SPL (95 %)", "DTS m", "steps", "acc m/s2, rad/s2", "jerk m/s3, rad/s3")
    lines = [_line("", columns)]
    for name, one in summaries.items():
        shares = [
            f"{value:.3f} ({low:.3f} to {high:.3f})"
            for value, (low, high) in ((one.success, one.success_interval), (one.spl, one.spl_interval))
        ]
        lines.append(_line(AGENT_TITLES[name], (*shares, *_figures(one))))
        lines += [_paper_line("the paper's", name)] if name in PAPER_TABLE1 else []
    return "\n".join(lines)


def _paper_line(title: str, name: str) -> str:
    one = PAPER_TABLE1[name]
    return _line(title, (f"{one.success:.3f}", f"{one.spl:.3f}", *_figures(one)))


def _figures(one: SearchSummary | Table1Line) -> tuple[str, ...]:
    pairs = (f"{along:.2f}, {turning:.2f}" for along, turning in (one.acceleration, one.jerk))
    return f"{one.distance:.2f}", f"{one.steps:.1f}", *pairs


def _line(title: str, cells: Sequence[str]) -> str:
    widths = (22, 22, 5, 5, 16, 17)
    return "  ".join([f"{title:>25}", *(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))])


def main(options: Options) -> None:
    """Run the agents; print and write the table."""
    options.check()
    if not options.agents or len(set(options.agents)) < len(options.agents):
        raise InputError(f"--agents {' '.join(options.agents)}: give each agent once, one at least")
    costs = costs_for(options.agents, options.network)
    houses, episodes = options.places()
    inputs = digests(houses=[house.world for house in houses], network=costs)
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
    text = f"{len(episodes)} searches in {options.described}\n{table(summaries)}"
    conclude(out, options, houses, all_results, AGENT_TITLES, text, facts)


if __name__ == "__main__":
    command_line(Options, main)
