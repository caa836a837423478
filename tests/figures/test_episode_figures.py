"""Figures of episodes show what was replayed, and cells of one size."""

import itertools
from typing import ClassVar

import cv2
import numpy as np
import pytest
from flax import struct
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb

from dc2g_jax._src.estimation.estimators import ExactCostToGo
from dc2g_jax._src.figures import episode_figures
from dc2g_jax._src.figures._sheets import DPI, empty_sheet
from dc2g_jax._src.figures.costs import cost_image, cost_shares, exact_cost_to_go, highest_cost
from dc2g_jax._src.figures.episode_figures import (
    goal_marks,
    moments,
    outcome,
    plot_episode,
    plot_trajectories,
    poses_along,
)
from dc2g_jax._src.figures.replay import replay_result
from dc2g_jax._src.figures.results_figures import map_image
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_COLORS, FRONT_DOOR, HOUSE, ROAD
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, TO_GOAL
from dc2g_jax._src.planning.rules import SETTINGS
from tests.support import toy


@pytest.fixture
def drawn_figure(monkeypatch):
    """The figures that would have been written."""
    figures = []
    monkeypatch.setattr(episode_figures, "save_figure", lambda figure, path, dpi: figures.append(figure) or [])
    return figures


def _image(axes) -> np.ndarray:
    return np.asarray(axes.images[0].get_array())


def test_every_class_has_a_color_in_the_order_of_classes():
    assert tuple(FIGURE_COLORS) == CLASS_NAMES


def test_ground_that_was_not_seen_is_pale():
    seen, unseen = map_image(np.full((1, 2), HOUSE, np.uint8), np.array([[True, False]]))[0]
    color = np.array(to_rgb(FIGURE_COLORS["house"]))
    np.testing.assert_allclose(seen, color)
    np.testing.assert_allclose(unseen, 1 - 0.15 * (1 - color))


def test_a_way_is_that_of_the_replay():
    for planner, frames in toy.replayed().items():
        way = poses_along(toy.RESULTS[planner], toy.HOUSE)
        for name in ("x", "y", "heading"):
            np.testing.assert_array_equal(getattr(way, name), getattr(frames.pose, name))


def test_a_way_against_the_edge_of_the_map_stays_there():
    way = poses_along(toy.RESULTS["dc2g"]._replace(x=8, actions="FFFL"), toy.HOUSE)
    assert way.x.tolist() == [8, 9, 9, 9, 9]
    assert way.heading.tolist() == [0, 0, 0, 0, 3]


def test_a_way_against_a_house_stays_before_it():
    way = poses_along(toy.RESULTS["dc2g"]._replace(x=9, y=4, heading=3, actions="FLF"), toy.HOUSE)
    assert (way.x.tolist(), way.y.tolist()) == ([9, 9, 9, 8], [4, 4, 4, 4])


def test_moments_are_the_start_the_sight_of_the_goal_and_the_end():
    frames = toy.replayed()["frontier"]
    assert len(frames) == 25
    modes = np.full(25, EXPLORE)
    modes[12:] = TO_GOAL
    assert moments(frames.replace(mode=modes), 4) == [0, 6, 12, 24]
    assert moments(frames.replace(mode=np.full(25, TO_GOAL)), 4) == [0, 8, 16, 24]
    assert moments(frames.replace(mode=np.full(25, EXPLORE)), 3) == [0, 12, 24]
    modes[1:] = TO_GOAL
    assert moments(frames.replace(mode=modes), 4) == [0, 1, 24]


def test_outcomes():
    frames = toy.replayed()["frontier"]
    away = np.append(frames.to_goal[:-1], 3)
    assert outcome(frames) == "at the goal"
    assert outcome(frames.replace(to_goal=away, mode=np.full(25, GAVE_UP))) == "gave up"
    assert outcome(frames.replace(to_goal=away, mode=np.full(25, EXPLORE))) == "step limit"


def test_panels_show_what_was_known_at_each_moment(drawn_figure, tmp_path):
    episodes = toy.replayed()
    plot_episode(tmp_path / "episode", toy.HOUSE, episodes, columns=3)
    (figure,) = drawn_figure
    panels = [axes for axes in figure.axes if axes.images]
    knowledge, ends = panels[:3] + panels[8:11], [panels[3], panels[11]]
    steps = [(planner, step) for planner in ("dc2g", "frontier") for step in moments(episodes[planner], 3)]
    for axes, (planner, step) in zip(knowledge, steps, strict=True):
        assert axes.get_title().startswith(f"step {step}")
        np.testing.assert_allclose(_image(axes), map_image(toy.HOUSE.terrain, episodes[planner].seen[step]))
    everything = map_image(toy.HOUSE.terrain, np.ones(toy.HOUSE.terrain.shape, bool))
    for axes, extra in zip(ends, (0, 71), strict=True):
        assert axes.get_title() == f"extra steps: {extra} %"
        np.testing.assert_allclose(_image(axes), everything)
    # The toy estimator knows the truth: all that was observed in the end is shown in the colors of the exact panel.
    seen = episodes["dc2g"].seen[-1]
    np.testing.assert_allclose(_image(panels[6])[seen], _image(panels[7])[seen])
    assert np.all(_image(panels[6])[~seen] == 1)


def test_a_reached_goal_looks_out_from_under_the_robot_and_no_mark_is_cut_off(drawn_figure, tmp_path):
    plot_trajectories(tmp_path / "ways", toy.HOUSE, toy.RESULTS)
    for axes in drawn_figure[0].axes[: len(toy.RESULTS)]:
        marks = {line.get_marker(): line for line in axes.lines if line.get_marker() != "None"}
        assert set(marks) == {"*", "o", "^"}
        star, robot = marks["*"], marks["^"]
        # Both at the door, the robot over a star of twice its size.
        assert (star.get_xdata(), star.get_ydata()) == (robot.get_xdata(), robot.get_ydata()) == ([4], [0])
        assert star.get_markersize() > 2 * robot.get_markersize()
        assert axes.lines.index(star) < axes.lines.index(robot)
        assert star.get_zorder() == robot.get_zorder()
        assert not any(mark.get_clip_on() for mark in marks.values())


def test_marks_of_goals_are_one_a_door_and_move_to_a_robot_on_it():
    terrain = np.full((5, 9), ROAD, np.uint8)
    terrain[0, 0:3] = terrain[4, 7] = FRONT_DOOR
    assert goal_marks(terrain, (5, 2)) == ([(1, 0), (7, 4)], False)
    assert goal_marks(terrain, (2, 0)) == ([(7, 4), (2, 0)], True)
    assert goal_marks(np.full((2, 2), ROAD, np.uint8), (0, 0)) == ([], False)


def test_colors_of_costs_end_where_nearly_all_lies_below():
    exact = exact_cost_to_go(toy.HOUSE)
    frames = toy.replayed()["dc2g"]
    seen = exact[frames.seen[-1] & np.isfinite(exact)]
    assert 0.9 * seen.max() < highest_cost(toy.HOUSE, toy.replayed(), exact) <= seen.max()
    # An estimate far beyond the truth stretches the scale; a planner without one does not matter.
    beyond = frames.replace(cost_to_go=frames.cost_to_go + 100)
    assert highest_cost(toy.HOUSE, {"dc2g": beyond}, exact) > 100
    assert highest_cost(toy.HOUSE, {"frontier": toy.replayed()["frontier"]}, exact) == 1


def test_costs_that_are_not_in_cells_have_a_scale_of_their_own(drawn_figure):
    frames = toy.replayed()["dc2g"]
    relative = frames.replace(cost_to_go=np.full_like(frames.cost_to_go, 0.5), in_cells=False)
    assert highest_cost(toy.HOUSE, {"dc2g": relative}, exact_cost_to_go(toy.HOUSE)) == 1
    np.testing.assert_array_equal(cost_shares(relative, 40.0), relative.cost_to_go)
    np.testing.assert_array_equal(cost_shares(frames, 40.0), frames.cost_to_go / 40)
    plot_episode("x", toy.HOUSE, {"dc2g": relative})
    assert "predicted\ncost-to-go\n(relative)" in [axes.get_ylabel() for axes in drawn_figure[0].axes]


def test_a_replay_says_whether_costs_are_in_cells():
    @struct.dataclass
    class Brightness(ExactCostToGo):
        in_cells: ClassVar[bool] = False

    rules = SETTINGS["paper"].rules(3)
    assert toy.replayed()["dc2g"].in_cells
    assert not replay_result(toy.RESULTS["dc2g"], toy.HOUSE, rules, Brightness()).in_cells


def test_costs_are_colored_where_shown_and_gray_where_blocked():
    shown, blocked = np.array([[True, True, False, False]]), np.array([[False, False, True, False]])
    image = cost_image(np.array([[0.0, 7.0, np.inf, np.nan]]), shown, blocked)[0]
    near, far = (np.array(colormaps["viridis"](end)[:3]) for end in (1.0, 0.0))
    np.testing.assert_allclose(image, [near, far, to_rgb("#ececf1"), (1, 1, 1)])


_TITLES = ["step 1432: at the goal", "extra steps: 1573 %", "step 0", ""]


@pytest.mark.parametrize(("shape", "columns"), [((50, 50), 5), ((40, 120), 3), ((120, 30), 5), ((9, 6), 3)])
def test_titles_of_neighbors_do_not_touch(shape, columns):
    sheet = empty_sheet(shape, 2, columns, episode_figures._entries(toy.HOUSE.terrain), _TITLES)
    panels = [sheet.panel(row, column, _TITLES[0]) for row in range(2) for column in range(columns)]
    FigureCanvasAgg(sheet.figure)
    boxes = [axes.title.get_window_extent() for axes in panels]
    for left, right in itertools.pairwise(boxes[:columns]):
        assert right.x0 - left.x1 > 0.05 * sheet.figure.dpi
    for above, below in zip(panels[:columns], boxes[columns:], strict=True):
        assert below.y1 < above.bbox.y0
    assert boxes[0].y1 <= sheet.figure.bbox.y1


@pytest.mark.parametrize("shape", [(50, 50), (9, 6), (6, 17), (90, 40)])
@pytest.mark.parametrize("columns", [1, 3, 5])
def test_cells_are_a_whole_number_of_pixels(shape, columns):
    sheet = empty_sheet(shape, 2, columns, episode_figures._entries(toy.HOUSE.terrain), ["step 0"])
    for side, cells in zip((sheet.height, sheet.width), shape, strict=True):
        pixels = side * DPI / cells
        assert pixels == pytest.approx(round(pixels))
        assert round(pixels) >= 1
    width, height = sheet.figure.get_size_inches() * DPI
    assert (width, height) == (pytest.approx(round(width)), pytest.approx(round(height)))
    assert width <= 7.2 * DPI


@pytest.mark.parametrize("shape", [(200, 300), (900, 3000), (3000, 900)])
def test_large_maps_fill_the_page(shape):
    sheet = empty_sheet(shape, 1, 5, episode_figures._entries(toy.HOUSE.terrain), ["step 0"])
    assert sheet.figure.get_figwidth() <= 7.2
    assert sheet.width / sheet.height == pytest.approx(shape[1] / shape[0])
    assert sheet.width == pytest.approx(1.31, abs=0.01) or sheet.height == pytest.approx(2.2)


def test_trajectories_are_written(tmp_path):
    files = plot_trajectories(tmp_path / "ways.v2", toy.HOUSE, toy.RESULTS)
    assert [path.name for path in files] == ["ways.v2.png", "ways.v2.svg", "ways.v2.pdf"]
    assert cv2.imread(str(files[0])).shape[1] > 1000
    drawing = files[1].read_text()
    assert drawing.count("<image") >= 2
    # Text is text.
    assert ">DC2G: 14 steps (+0 %)</text>" in drawing
