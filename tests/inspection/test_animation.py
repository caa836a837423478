"""Animations hold a picture a step, and can be read back."""

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from dc2g_jax.grid.terrain import CLASS_NAMES
from dc2g_jax.inspection import animation
from dc2g_jax.inspection.animation import animate, pictures, steps_shown
from dc2g_jax.inspection.figures import CLASS_COLOURS
from tests.inspection import toy
from tests.refusals import refusal

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
            return found, video.get(cv2.CAP_PROP_FPS)
        found.append(picture[..., ::-1])


def test_pictures_have_one_even_size(shown):
    assert len({picture.shape for picture in shown}) == 1
    height, width, _ = shown[0].shape
    assert (height % 2, width % 2) == (0, 0)
    assert width <= 900


def test_cells_have_their_class_colours_and_pale_ones_before_they_are_seen(shown):
    layout = animation._layout(3, *toy.HOUSE.terrain.shape)
    assert layout.scale == layout.width // 10 == layout.height // 7
    # Of the frontier's map, cells away from the way, the goal and the rims of what is seen.
    left, top = layout.corner(2)
    seen = toy.replayed()["frontier"].seen
    for x, y in ((0, 6), (9, 5)):
        place = (top + y * layout.scale + 4 * layout.scale // 5, left + x * layout.scale + 4 * layout.scale // 5)
        colour = np.array(to_rgb(CLASS_COLOURS[CLASS_NAMES[toy.HOUSE.terrain[y, x]]]))
        for step in (0, _LAST):
            expected = colour if seen[step, y, x] else 1 - 0.15 * (1 - colour)
            np.testing.assert_allclose(shown[step][place], 255 * expected, atol=1)
    assert not seen[0, 6, 0]
    assert seen[_LAST, 6, 0]


def test_a_robot_that_has_arrived_waits(shown):
    layout = animation._layout(3, *toy.HOUSE.terrain.shape)
    left, top = layout.corner(0)
    panel = [picture[top : top + layout.height, left : left + layout.width] for picture in shown]
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
    assert layout.columns == columns
    assert layout.width == layout.scale * shape[1] >= shape[1]
    corners = [layout.corner(number) for number in range(panels)]
    width, height = layout.size
    for x, y in corners:
        assert x >= 0
        assert x + layout.width <= width
        assert y + layout.height <= height
    assert len(set(corners)) == panels


def test_a_gif_has_every_picture(shown, tmp_path):
    path = animate(tmp_path / "new" / "toy.gif", toy.HOUSE, toy.replayed(), frames_per_second=10)
    with Image.open(path) as image:
        durations = []
        for number in range(image.n_frames):
            image.seek(number)
            durations.append(image.info["duration"])
            difference = np.abs(np.asarray(image.convert("RGB"), int) - shown[number])
            assert difference.mean() < 0.5
            assert np.median(difference) == 0
        assert image.info["loop"] == 0
    assert durations == [100] * _LAST + [2500]
    assert path.stat().st_size < 500_000


def test_an_mp4_has_every_picture_and_holds_the_last(shown, tmp_path):
    path = animate(tmp_path / "toy.MP4", toy.HOUSE, toy.replayed(), frames_per_second=4)
    found, frames_per_second = _video(path)
    assert frames_per_second == pytest.approx(4)
    assert len(found) == _LAST + 1 + 10
    for number in (0, 12, _LAST, -1):
        expected = shown[min(number, _LAST) if number >= 0 else _LAST]
        assert np.abs(found[number].astype(int) - expected).mean() < 6


def test_long_episodes_skip_steps_but_not_the_last(monkeypatch):
    assert steps_shown(toy.replayed()) == list(range(_LAST + 1))
    monkeypatch.setattr(animation, "_MOST_PICTURES", 5)
    assert steps_shown(toy.replayed()) == [0, 5, 10, 15, 20, 24]


def test_what_cannot_be_written_is_refused(tmp_path):
    refusal(lambda: animate(tmp_path / "a.avi", toy.HOUSE, toy.replayed()), "a.avi", ".gif or .mp4")
    (tmp_path / "file").write_text("")
    refusal(lambda: animate(tmp_path / "file" / "a.gif", toy.HOUSE, toy.replayed()), "a.gif", "cannot be written")
    (tmp_path / "taken.mp4").mkdir()
    refusal(lambda: animate(tmp_path / "taken.mp4", toy.HOUSE, toy.replayed()), "taken.mp4")
