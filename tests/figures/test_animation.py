"""Animations hold a picture a step, and can be read back."""

import dataclasses

import cv2
import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from PIL import Image

from dc2g_jax._src.figures import animation
from dc2g_jax._src.figures.animation import animate, pictures, write_animation
from dc2g_jax._src.figures.costs import exact_cost_to_go, highest_cost
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_COLORS
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


def test_cells_have_their_class_colors_and_pale_ones_before_they_are_seen(shown):
    layout = animation._layout(3, *toy.HOUSE.terrain.shape)
    assert layout.scale > 2
    # Of the frontier's map, cells away from the way, the goal and the rims of what is seen.
    left, top = layout.corners[2]
    seen = toy.replayed()["frontier"].seen
    for x, y in ((0, 6), (9, 5)):
        place = (top + y * layout.scale + 4 * layout.scale // 5, left + x * layout.scale + 4 * layout.scale // 5)
        color = np.array(to_rgb(FIGURE_COLORS[CLASS_NAMES[toy.HOUSE.terrain[y, x]]]))
        for step in (0, _LAST):
            expected = color if seen[step, y, x] else 1 - 0.15 * (1 - color)
            np.testing.assert_allclose(shown[step][place], 255 * expected, atol=1)
    assert not seen[0, 6, 0]
    assert seen[_LAST, 6, 0]


def test_the_legend_has_the_colors_of_all_classes_and_stays(shown):
    _, height = animation._layout(3, *toy.HOUSE.terrain.shape).size
    assert shown[0].shape[0] > height
    legend = shown[0][height:]
    np.testing.assert_array_equal(legend, shown[_LAST][height:])
    for index in np.unique(toy.HOUSE.terrain):
        color = np.rint(255 * np.array(to_rgb(FIGURE_COLORS[CLASS_NAMES[index]])))
        assert np.all(legend == color, axis=-1).sum() >= 100
    # All words end within the picture.
    assert np.all(legend[:, -4:] == 255)


def test_costs_have_the_colors_of_the_figure(shown):
    layout = animation._layout(3, *toy.HOUSE.terrain.shape)
    left, top = layout.corners[1]
    frames, exact = toy.replayed()["dc2g"], exact_cost_to_go(toy.HOUSE)
    high = highest_cost(toy.HOUSE, toy.replayed(), exact)
    for x, y in ((6, 5), (5, 4)):  # beside the way
        assert frames.seen[-1, y, x]
        place = (top + y * layout.scale + layout.scale // 2, left + x * layout.scale + layout.scale // 2)
        expected = colormaps["viridis_r"](exact[y, x] / high)[:3]
        np.testing.assert_allclose(shown[_LAST][place] / 255, expected, atol=0.03)


def test_a_robot_that_has_arrived_waits(shown):
    layout = animation._layout(3, *toy.HOUSE.terrain.shape)
    left, top = layout.corners[0]
    height, width = (layout.scale * cells for cells in toy.HOUSE.terrain.shape)
    panel = [picture[top : top + height, left : left + width] for picture in shown]
    np.testing.assert_array_equal(panel[14], panel[_LAST])
    assert np.any(panel[13] != panel[14])


@pytest.mark.parametrize(
    ("panels", "shape", "columns"),
    [
        (1, (50, 50), 1),
        (3, (50, 50), 3),
        (4, (50, 50), 2),
        (3, (20, 100), 1),
        (3, (100, 150), 2),
        (3, (200, 300), 3),
        (3, (900, 900), 3),
    ],
)
def test_panels_fill_the_room(panels, shape, columns):
    layout = animation._layout(panels, *shape)
    assert len({x for x, _ in layout.corners}) == columns
    assert layout.scale >= 1
    width, height = layout.size
    for x, y in layout.corners:
        assert x >= 0
        assert x + layout.scale * shape[1] <= width
        assert y + layout.scale * shape[0] <= height
    assert len(set(layout.corners)) == panels


def test_a_gif_has_every_picture(shown, monkeypatch, tmp_path):
    monkeypatch.setattr(animation, "_MOST_PICTURES", 8)
    path = animate(tmp_path / "new" / "toy.gif", toy.HOUSE, toy.replayed(), frames_per_second=10)
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


def test_an_mp4_has_every_picture_and_holds_the_last(shown, monkeypatch, tmp_path):
    monkeypatch.setattr(animation, "_MOST_PICTURES", 3)
    steps = [0, 8, 16, _LAST]
    path = animate(tmp_path / "toy.MP4", toy.HOUSE, toy.replayed(), frames_per_second=2)
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


def test_where_nothing_is_predicted_the_panel_says_so(shown):
    nothing = {
        name: frames
        if frames.cost_to_go is None
        else dataclasses.replace(frames, cost_to_go=np.zeros_like(frames.cost_to_go))
        for name, frames in toy.replayed().items()
    }
    (picture,) = pictures(toy.HOUSE, nothing, [3])
    left, top = animation._layout(3, *toy.HOUSE.terrain.shape).corners[1]
    scale = np.s_[top - 20 : top - 4, left : left + 110]
    assert np.ptp(shown[3][scale].astype(int), axis=-1).max() > 100  # the colors of costs
    assert np.ptp(picture[scale].astype(int), axis=-1).max() == 0  # gray words


def test_long_episodes_skip_steps_but_not_the_last(monkeypatch, tmp_path):
    painted = []

    def paint(numbers):
        painted.append(numbers)
        return pictures(toy.HOUSE, toy.replayed(), numbers)

    write_animation(tmp_path / "all.gif", paint, _LAST + 1, (), 12)
    monkeypatch.setattr(animation, "_MOST_PICTURES", 5)
    write_animation(tmp_path / "some.gif", paint, _LAST + 1, (), 12)
    assert list(range(_LAST + 1)) in painted
    assert [0, 5, 10, 15, 20, 24] in painted


def test_what_cannot_be_written_is_refused(tmp_path):
    refusal(lambda: animate(tmp_path / "a.avi", toy.HOUSE, toy.replayed()), "a.avi", ".gif or .mp4")
    (tmp_path / "file").write_text("")
    refusal(lambda: animate(tmp_path / "file" / "a.gif", toy.HOUSE, toy.replayed()), "a.gif", "cannot be written")
    (tmp_path / "taken.mp4").mkdir()
    refusal(lambda: animate(tmp_path / "taken.mp4", toy.HOUSE, toy.replayed()), "taken.mp4")
