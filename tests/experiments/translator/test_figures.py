"""Figures 4 to 6 draw what they are given."""

import numpy as np
import pytest

from experiments.translator import figures as image_figures
from experiments.translator.figures import METRIC_LABELS, Example
from experiments.translator.metrics import HouseMetrics


def check(folder) -> None:
    assert sorted(path.suffix for path in folder.iterdir()) == [".pdf", ".png", ".svg"]
    assert all(path.stat().st_size > 1000 for path in folder.iterdir())


def test_figure_4(tmp_path):
    pictures = np.random.default_rng(0).random((3, 8, 8, 3))
    examples = [Example(f"house{number}", *pictures) for number in range(2)]
    image_figures.plot_translations(tmp_path / "fig4", examples, examples, "caption")
    check(tmp_path)


def test_figure_5(tmp_path):
    def run(seed: int):
        values = np.random.default_rng(seed).random((4, 3))
        return {10 * n: dict(zip(("l1", "low_precision", "low_recall"), v, strict=True)) for n, v in enumerate(values)}

    silent = {step: line | {"low_precision": None} for step, line in run(1).items()}
    runs = {"l1": [run(0), silent], "gan": [run(2)], "l1+gan": [silent]}
    image_figures.plot_training(tmp_path / "fig5", runs, "caption", window=2)
    check(tmp_path)


def test_the_moving_average():
    smooth = image_figures._moving_average(np.array([4.0, 2.0, 0.0, 6.0]), 2)
    assert smooth == pytest.approx([4, 3, 1, 3])
    assert image_figures._moving_average(np.array([4.0, 2.0]), 9) == pytest.approx([4, 3])
    gaps = image_figures._moving_average(np.array([np.nan, np.nan, 2.0, 4.0]), 2)
    assert gaps == pytest.approx([np.nan, np.nan, 2, 3], nan_ok=True)


def test_figure_6(tmp_path):
    metrics = {name: [0.5, 0.7, 1.0] for name in METRIC_LABELS}
    fits = dict.fromkeys(METRIC_LABELS, (0.1, 0.5))
    networks = {
        "one": HouseMetrics([0.1, 0.2, 0.4], metrics, fits),
        "other": HouseMetrics([0.1, 0.1, 0.1], metrics, {}),
    }
    image_figures.plot_by_similarity(tmp_path / "fig6", networks, "caption")
    check(tmp_path)


def test_figure_6_has_no_panels_without_news(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(image_figures, "save_figure", lambda figure, path: drawn.append(figure) or [])
    shares = {name: [np.nan, 1.0] for name in METRIC_LABELS} | {"low_recall": [0.8, 1.0], "low_precision": [np.nan] * 2}
    image_figures.plot_by_similarity(tmp_path / "fig6", {"one": HouseMetrics([0.1, 0.2], shares, {})}, "caption")
    error, recall = drawn[0].axes
    assert (error.get_ylabel(), recall.get_ylabel()) == (METRIC_LABELS["l1"], METRIC_LABELS["low_recall"])
    assert 0.75 < recall.get_ylim()[0] < 0.8
    assert (
        drawn[0]
        .get_supxlabel()
        .endswith("nowhere below 1: precision, low cost-to-go; precision, traversable; recall, traversable.")
    )
