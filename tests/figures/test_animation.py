"""Animations hold a picture a step, and can be read back."""

import dataclasses
import functools

import cv2
import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from PIL import Image

from dc2g_jax._src.figures import animation
from dc2g_jax._src.figures._sheets import most_columns
from dc2g_jax._src.figures.animation import animate, pictures, write_animation
from dc2g_jax._src.figures.costs import exact_cost_to_go, highest_cost
from dc2g_jax._src.figures.episode_figures import MARK_COLOR, ROBOT_COLOR, SUBGOAL_COLOR
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_COLORS, FIGURE_RGB
from tests.support import toy
from tests.support.refusals import refusal

_LAST = 24


@pytest.fixture(scope="module")
def shown() -> list[np.ndarray]:
    return list(pictures(toy.HOUSE, toy.replayed(), range(_LAST + 1)))


def _video(path) -> tuple[list[np.ndarray], float]:
    video = cv2.VideoCapture(str(path))
    found = []
    while True:
        there, picture = video.read()
        if not there:
            assert int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") in (b"h264", b"avc1")
            return found, video.get(cv2.CAP_PROP_FPS)
        found.append(picture[..., ::-1])


def test_pictures_have_one_even_size(shown):
    assert len({picture.shape for picture in shown}) == 1
    height, width, _ = shown[0].shape
    assert (height % 2, width % 2) == (0, 0)
    assert width <= 900


def _has(picture, color: str) -> int:
    """Number of pixels of a color."""
    return int(np.sum(np.all(np.abs(picture - 255 * np.array(to_rgb(color))) < 1.5, axis=-1)))


def _titles(monkeypatch, frames_by_planner, step: int) -> list[str]:
    """Titles and words in the panels of a step."""
    found = []
    monkeypatch.setattr(Axes, "draw", lambda axes, renderer: found.append([axes.get_title(), *axes.texts]))
    list(pictures(toy.HOUSE, frames_by_planner, [step]))
    found = found[-3:]  # before them, the empty paper is drawn
    return [" ".join(getattr(text, "get_text", lambda text=text: text)() for text in texts) for texts in found]


def test_cells_have_their_class_colors_once_they_are_seen(shown):
    # The legend has a patch of each class; ground that is seen late takes its color in the panels.
    for index in np.unique(toy.HOUSE.terrain):
        assert _has(shown[0], FIGURE_COLORS[CLASS_NAMES[index]]) >= 50
    sidewalk = FIGURE_COLORS["sidewalk"]
    assert _has(shown[_LAST], sidewalk) > _has(shown[0], sidewalk) + 2000
    pale = 255 - 0.15 * (255 - FIGURE_RGB[CLASS_NAMES.index("grass")].astype(float))
    unseen = [np.sum(np.all(np.abs(picture - pale) < 1, axis=-1)) for picture in (shown[0], shown[_LAST])]
    assert unseen[0] > unseen[1] > 5000


def test_costs_have_the_colors_of_the_figure(shown):
    exact = exact_cost_to_go(toy.HOUSE)
    high = highest_cost(toy.HOUSE, toy.replayed(), exact)
    for x, y in ((6, 5), (5, 4)):  # beside the way
        assert toy.replayed()["dc2g"].seen[-1, y, x]
        assert _has(shown[_LAST], to_hex(colormaps["viridis_r"](exact[y, x] / high))) > 300


def test_titles_say_what_the_planners_do(monkeypatch):
    first, costs, second = _titles(monkeypatch, toy.replayed(), 8)
    assert first == "DC2G: step 8, exploring (+0 %)"
    assert costs == "predicted cost-to-go"
    assert second == "Frontier: step 8, exploring (+29 %)"
    arrived, _, _ = _titles(monkeypatch, toy.replayed(), _LAST)  # it waits
    assert arrived == "DC2G: step 14, at the goal (+0 %)"


@pytest.mark.parametrize(
    ("panels", "shape", "columns"),
    [(1, (50, 50), 1), (3, (50, 50), 3), (4, (50, 50), 3), (3, (20, 100), 1), (3, (100, 150), 2)],
)
def test_panels_fill_the_room(panels, shape, columns):
    assert most_columns(panels, shape) == columns


def _written(path, **options):
    paint = functools.partial(pictures, toy.HOUSE, toy.replayed())
    return write_animation(path, paint, _LAST + 1, (MARK_COLOR, ROBOT_COLOR, SUBGOAL_COLOR), **options)


def test_a_gif_has_every_picture(shown, tmp_path):
    path = _written(tmp_path / "new" / "toy.gif", frames_per_second=10, most_pictures=8)
    with Image.open(path) as image:
        assert image.n_frames == 9
        durations = []
        for number in range(9):
            image.seek(number)
            durations.append(image.info["duration"])
            difference = np.abs(np.asarray(image.convert("RGB"), int) - shown[3 * number])
            assert difference.mean() < 0.5
            assert np.median(difference) == 0
        assert image.info["loop"] == 0
    assert durations == [100] * 8 + [2500]
    # Less than a byte for six pixels of all pictures: only what changes is stored.
    assert path.stat().st_size < 9 * shown[0][..., 0].size / 6


def test_an_mp4_has_every_picture_and_holds_the_last(shown, tmp_path):
    steps = [0, 8, 16, _LAST]
    path = _written(tmp_path / "toy.MP4", frames_per_second=2, most_pictures=3)
    found, frames_per_second = _video(path)
    assert frames_per_second == pytest.approx(2)
    assert len(found) == len(steps) + 5
    for picture, step in zip(found, steps + [_LAST] * 5, strict=True):
        assert np.abs(picture.astype(int) - shown[step]).mean() < 6


def test_without_an_encoder_a_gif_is_written_and_said(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(animation, "h264_encoder", lambda: None)
    path = animate(tmp_path / "toy.mp4", toy.HOUSE, toy.replayed())
    assert path == tmp_path / "toy.gif"
    assert [file.name for file in tmp_path.iterdir()] == ["toy.gif"]
    with Image.open(path) as image:
        assert image.n_frames > 1
    assert "toy.gif: is no MP4" in capsys.readouterr().err


def test_where_nothing_is_predicted_the_panel_says_so(monkeypatch):
    nothing = {
        name: frames
        if frames.cost_to_go is None
        else dataclasses.replace(frames, cost_to_go=np.zeros_like(frames.cost_to_go))
        for name, frames in toy.replayed().items()
    }
    assert [title for title in _titles(monkeypatch, nothing, 3) if "no prediction" in title] == [
        "predicted cost-to-go no prediction"
    ]


def test_long_episodes_skip_steps_but_not_the_last(tmp_path):
    painted = []

    def paint(numbers):
        painted.append(numbers)
        return pictures(toy.HOUSE, toy.replayed(), numbers)

    write_animation(tmp_path / "all.gif", paint, _LAST + 1, (), 12)
    write_animation(tmp_path / "some.gif", paint, _LAST + 1, (), 12, most_pictures=5)
    assert list(range(_LAST + 1)) in painted
    assert [0, 5, 10, 15, 20, 24] in painted


def test_what_cannot_be_written_is_refused(tmp_path):
    refusal(lambda: animate(tmp_path / "a.avi", toy.HOUSE, toy.replayed()), "a.avi", ".gif or .mp4")
    (tmp_path / "file").write_text("")
    refusal(lambda: animate(tmp_path / "file" / "a.gif", toy.HOUSE, toy.replayed()), "a.gif", "cannot be written")
    (tmp_path / "taken.mp4").mkdir()
    refusal(lambda: animate(tmp_path / "taken.mp4", toy.HOUSE, toy.replayed()), "taken.mp4")
