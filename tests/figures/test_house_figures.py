"""Figures of many houses: strips of extra steps, and contact sheets."""

import itertools

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from dc2g_jax._src.figures import contact_sheets, results_figures as figures
from dc2g_jax._src.figures.contact_sheets import contact_pages, plot_contact_page
from dc2g_jax._src.figures.results_figures import PLANNER_STYLES, plot_results
from dc2g_jax._src.grid.terrain import FRONT_DOOR, GRASS
from dc2g_jax._src.planning.named import PLANNERS
from dc2g_jax._src.readers.houses import House
from experiments import head_to_head
from experiments.support import bars
from tests.support import toy


def _results(houses, planners=("oracle", "frontier", "dc2g"), episodes=3):
    return [
        toy.RESULTS["dc2g"]._replace(house=house, planner=planner, extra=10.0 * number)
        for planner in planners
        for house in houses
        for number in range(episodes)
    ]


def test_strips_hold_every_episode_but_the_oracles(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(figures, "save_figure", lambda figure, path, dpi: drawn.append(figure) or [])
    groups = {"b": "urban", "a": "urban", "c": "same_neighborhood"}
    plot_results(_results(groups), tmp_path / "strips", groups)
    (axes,) = drawn[0].axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["c", "a", "b"]
    assert [text.get_text() for text in axes.texts] == ["same neighborhood", "urban"]
    points = [line.get_xdata() for line in axes.lines if line.get_marker() in "os"]
    assert np.array(points).tolist() == [[0.0, 10.0, 20.0]] * 6


def test_planners_of_ones_own_come_last_and_do_not_look_alike():
    styles = figures.planner_styles(["mine", "dc2g", "yours", "frontier", "mine"])
    assert list(styles) == ["frontier", "dc2g", "mine", "yours"]
    looks = [style[1:] for style in styles.values()]
    assert len(set(looks)) == 4
    assert styles["dc2g"] == PLANNER_STYLES["dc2g"]
    many = figures.planner_styles([*PLANNER_STYLES, *(f"planner {n}" for n in range(20))]).values()
    assert len({(style.color, style.hatch) for style in many}) == len(many)
    assert len({(style.color, style.marker) for style in many}) == len(many)


def summary(*values: float) -> dict[str, float]:
    return dict(zip(("mean_extra", "median_extra", "mean_low", "mean_high"), values, strict=False))


def test_an_oracle_alone_has_nothing_to_be_compared_with(tmp_path):
    table = {"oracle": {"all": summary(0.0, 0.0)}}
    with pytest.raises(ValueError, match="no planner to compare with the oracle"):
        bars.plot_extra_steps(tmp_path / "fig7", {"paper": table}, "toy")
    with pytest.raises(ValueError, match="no planner to compare with the oracle"):
        plot_results(_results(["a"], ("oracle",)), tmp_path / "strips", {"a": "test"})


@pytest.mark.parametrize(
    ("counts", "columns"),
    [
        ({"x": 12, "y": 8}, [(["x", "y"], 20)]),
        ({"x": 12, "y": 11}, [(["x"], 12), (["y"], 11)]),
        ({"x": 9, "y": 14}, [(["x", "y"], 12), (["y"], 11)]),
    ],
)
def test_groups_are_cut_where_a_column_is_full(counts, columns, monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(figures, "save_figure", lambda figure, path, dpi: drawn.append(figure) or [])
    groups = {f"{group}{number:02}": group for group, count in counts.items() for number in range(count)}
    plot_results(_results(groups, ("frontier",)), tmp_path / "strips", groups)
    names = [[label.get_text() for label in axes.get_yticklabels()] for axes in drawn[0].axes]
    assert [name for column in names for name in column] == list(groups)
    headlines = [[text.get_text() for text in axes.texts] for axes in drawn[0].axes]
    assert list(zip(headlines, map(len, names), strict=True)) == columns


def test_strips_are_written(tmp_path):
    houses = [f"n{number:03}" for number in range(25)]
    files = plot_results(_results(houses, ("frontier",)), tmp_path / "strips", dict.fromkeys(houses, "test"))
    assert [path.suffix for path in files] == [".png", ".svg", ".pdf"]
    assert all(path.stat().st_size > 10_000 for path in files)


def _houses(count, split="test", shape=(5, 5)):
    terrain = np.full(shape, GRASS, np.uint8)
    return [House(f"{split}{count - number:03}", split, terrain) for number in range(count)]


def test_pages_hold_every_house_once_by_group_and_name():
    houses = _houses(100) + _houses(9, "train")
    pages = contact_pages(houses)
    assert [len(page) for page in pages] == [8, 7]
    rows = [row for page in pages for row in page]
    assert [headline for headline, _ in rows if headline] == ["training: 9", "test: 100"]
    names = [house.name for _, own in rows for house in own]
    assert names == sorted(names[:9]) + sorted(names[9:])
    assert sorted(names) == sorted(house.name for house in houses)
    assert names[0].startswith("train")


def test_a_page_says_in_which_houses_no_episode_can_be_run(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(contact_sheets, "save_figure", lambda figure, path, dpi: drawn.append(figure) or [])
    walled = np.full((4, 7), GRASS, np.uint8)
    walled[1, 1] = FRONT_DOOR
    houses = [toy.HOUSE, *_houses(1), House("walled", "test", walled)]
    (page,) = contact_pages(houses)
    plot_contact_page(tmp_path / "page", "three", "page 1 of 1", page)
    assert drawn[0].get_suptitle() == "three, page 1 of 1"
    assert drawn[0].axes[0].texts[0].get_text() == "test: 3"
    below = [axes.get_xlabel() for axes in drawn[0].axes if axes.images]
    assert below == ["test001\nno front door", "toy", "walled\ndoor cut off"]


@pytest.mark.parametrize("shape", [(1, 1), (9, 6), (50, 50), (200, 300), (10, 400)])
def test_houses_of_any_size_are_drawn_in_their_colors(shape, tmp_path):
    (page,) = contact_pages(_houses(2, shape=shape))
    plot_contact_page(tmp_path / "page", "title", "page 1 of 1", page)
    assert (tmp_path / "page.svg").stat().st_size > 1000
    above_legend = cv2.imread(str(tmp_path / "page.png"))[:-60]
    grass = np.all(above_legend[..., ::-1] == (0x4F, 0x9D, 0x69), axis=-1).sum()
    height, width = shape
    cell = 300 * min(0.85 / width, 1.08 / height)  # pixels
    rims = 2 * 2 * cell * (height + width)  # of two maps, a pixel wide
    assert grass == pytest.approx(2 * height * width * cell**2 - rims, rel=0.15)


def test_figures_are_a_page_wide_and_their_text_has_7_points_or_more(monkeypatch, tmp_path):
    drawn = []
    for module in (figures, head_to_head, bars):
        monkeypatch.setattr(module, "save_figure", lambda figure, path, dpi: drawn.append(figure) or [])
    groups = ("train", "urban", "all")
    planners = (*PLANNER_STYLES, "mine")
    table = {planner: dict.fromkeys(groups, summary(9.5, 7.0, 6.5, 14.0)) for planner in planners}
    bars.plot_extra_steps(tmp_path / "fig7", {"published": table, "paper": table}, "toy")
    head_to_head.plot_head_to_head(tmp_path / "pairs", {group: [(3.0, 1.0), (0.0, 250.0)] for group in groups})
    names = {f"n{number:03}": "test" for number in range(25)}
    plot_results(_results(names), tmp_path / "strips", names, bars.TITLES["paper"])
    assert len(drawn) == 3
    intervals = [line for line in drawn[0].findobj(LineCollection) for line in line.get_segments()]
    assert sum(np.array_equal(line[:, 1], [6.5, 14.0]) for line in intervals) >= 2 * len(groups) * (len(planners) - 1)
    assert any("Sampled starts, 8-cell sensing" in text.get_text() for text in drawn[2].findobj(Text))
    for figure in drawn:
        assert figure.get_figwidth() == pytest.approx(7.16)
        written = [text for text in figure.findobj(Text) if text.get_text()]
        assert len(written) > 10
        assert min(text.get_fontsize() for text in written) >= 7
    # Bars are told apart without their colors, too.
    fills = [(patch.get_hatch(), patch.get_facecolor()) for patch in drawn[0].legends[0].get_patches()]
    assert len(set(fills)) == len(planners) - 1
    assert [hatch for hatch, _ in fills].count("") == 2


@pytest.mark.parametrize("count", [2, 6, 9])
def test_means_stand_below_their_bars_side_by_side(count, monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(bars, "save_figure", lambda figure, path, dpi: drawn.append(figure) or [])
    row = dict.fromkeys(("train", "val", "urban", "all", "test"), summary(333.0, 200.0, 1.0, 999.0))
    bars.plot_extra_steps(tmp_path / "fig7", {"paper": {f"planner {n}": row for n in range(count)}}, "toy")
    FigureCanvasAgg(drawn[0]).draw()
    (axes,) = drawn[0].axes
    boxes = [text.get_window_extent() for text in axes.texts]
    labels = [label.get_window_extent() for label in axes.get_xticklabels()]
    assert [text.get_text() for text in axes.texts] == ["333"] * 5 * count
    assert all(max(label.y1 for label in labels) < box.y0 < box.y1 < axes.get_window_extent().y0 for box in boxes)
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_a_planner_of_ones_own_has_a_color_of_its_own():
    named = [style.color for style in PLANNER_STYLES.values()]
    colors = np.array([to_rgb(color) for color in (*named, *figures.SPARE_COLORS)])
    apart = np.linalg.norm(colors[:, None] - colors, axis=-1) + np.eye(len(colors))
    assert apart[len(named) :].min() > 0.2
    mine, other = "my_planner:Mine", "dc2g (mine)"
    together = figures.planner_styles([*PLANNERS[:9], other, mine])
    assert len({style.color for style in together.values()}) == len(together)
    assert together[other] == figures.planner_style(other)
    assert figures.planner_style(mine).color in figures.SPARE_COLORS
