"""Tables I and II of the paper on dense cost maps as text, with the paper's own figures, which are for its houses."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from dc2g_jax._src.search_indoors.learning.metrics import OF_CLASSES
from dc2g_jax._src.search_indoors.search.evaluation import SearchSummary

#: Titles of the agents.
AGENT_TITLES = {
    "true_cost": "true cost map",
    "random": "privileged random",
    "frontier": "frontier",
    "predicted": "predicted cost map",
    "promising": "predicted, at frontiers",
}

#: Titles of the inputs of a network, see `learning.networks.ABLATIONS`.
ABLATION_TITLES = {"both": "both", "semantic": "only semantic map", "midlevel": "only mid-level"}

#: Metrics of the prediction in Table II, in percent.
METRICS = ("MPA", "mF1", "mIoU", "aAP5", "aAP9")


class _Table1Line(NamedTuple):
    """A row of Table I of the paper; see `SearchSummary`."""

    success: float
    spl: float
    distance: float
    steps: float
    acceleration: tuple[float, float]
    jerk: tuple[float, float]


class _Table2Line(NamedTuple):
    """A row of Table II of the paper: `METRICS` in percent, success, SPL and distance to success in meters."""

    metrics: tuple[float, ...]
    success: float
    spl: float
    distance: float


#: Table I of the paper. `predicted` is its "Our Approach".
PAPER_TABLE1 = {
    "true_cost": _Table1Line(1.000, 0.922, 0.211, 147.459, (0.15, 2.041), (2.371, 35.006)),
    "random": _Table1Line(0.250, 0.208, 7.214, 402.795, (1.607, 8.920), (28.004, 156.095)),
    "predicted": _Table1Line(0.447, 0.329, 4.542, 327.877, (0.673, 7.318), (11.788, 128.158)),
}

#: Table II of the paper.
PAPER_TABLE2 = {
    "semantic": _Table2Line((79.17, 76.32, 63.34, 36.49, 32.47), 0.377, 0.290, 4.803),
    "midlevel": _Table2Line((79.11, 76.32, 63.47, 37.21, 33.11), 0.402, 0.287, 4.716),
    "both": _Table2Line((78.76, 75.89, 62.93, 37.45, 33.39), 0.447, 0.329, 4.542),
}

#: Of these, the paper gives F1 and IoU of each class for its own network alone, in percent (section IV-A).
_PAPER_OF_CLASSES = (71.08, 80.68, 56.79, 69.06)


def with_interval(value: float, interval: tuple[float, float], sign: str = "") -> str:
    """A value with its interval; with a sign if `sign` is `+`."""
    middle, low, high = (f"{one:{sign}.3f}" for one in (value, *interval))
    return f"{middle} ({low} to {high})"


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))


def table1(summaries: Mapping[str, SearchSummary]) -> str:
    """Table I: a row for each agent, given by name, followed by the paper's row if it has one."""

    def figures(one: SearchSummary | _Table1Line) -> list[str]:
        pairs = (f"{along:.2f}, {turning:.2f}" for along, turning in (one.acceleration, one.jerk))
        return [f"{one.distance:.2f}", f"{one.steps:.1f}", *pairs]

    rows = [["", "success (95 %)", "SPL (95 %)", "DTS m", "steps", "acc m/s2, rad/s2", "jerk m/s3, rad/s3"]]
    for name, one in summaries.items():
        shares = with_interval(one.success, one.success_interval), with_interval(one.spl, one.spl_interval)
        rows.append([AGENT_TITLES[name], *shares, *figures(one)])
        if name in PAPER_TABLE1:
            paper = PAPER_TABLE1[name]
            rows.append(["the paper's", f"{paper.success:.3f}", f"{paper.spl:.3f}", *figures(paper)])
    return "\n".join(_line(row, (25, 22, 22, 5, 5, 16, 17)) for row in rows)


def table2(metrics: Mapping[str, Mapping[str, float]], summaries: Mapping[str, SearchSummary]) -> str:
    """Table II, with the paper's row below each of ours, and then F1 and IoU of free and of occupied cells.

    Args:
      metrics: `METRICS` and `OF_CLASSES` of each network, given by the name of its inputs, in percent.
      summaries: the searches that each network led.
    """
    rows = [["", *(f"{name} %" for name in METRICS), "success", "SPL", "DTS m"]]
    for name, one in summaries.items():
        paper = PAPER_TABLE2[name]
        ours = _Table2Line(tuple(metrics[name][metric] for metric in METRICS), one.success, one.spl, one.distance)
        for title, line in ((ABLATION_TITLES[name], ours), ("the paper's", paper)):
            found = (f"{value:.2f}" for value in line.metrics)
            rows.append([title, *found, f"{line.success:.3f}", f"{line.spl:.3f}", f"{line.distance:.2f}"])
    values = {ABLATION_TITLES[name]: [found[score] for score in OF_CLASSES] for name, found in metrics.items()}
    values["the paper's (both)"] = list(_PAPER_OF_CLASSES)
    of_classes = [["", *(f"{score} %" for score in OF_CLASSES)]]
    of_classes += [[title, *(f"{value:.2f}" for value in own)] for title, own in values.items()]
    lines = [_line(row, (18, *[7] * 8)) for row in rows]
    return "\n".join([*lines, "", *(_line(row, (18, *[14] * len(OF_CLASSES))) for row in of_classes)])
