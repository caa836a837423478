"""Animations of object searches: the true map, the robot's map and its costs, decision by decision."""

import functools
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from dc2g_jax._src.figures._video import Picture
from dc2g_jax._src.figures.animation import write_animation
from dc2g_jax._src.figures.search_figures import (
    PATH_COLOR,
    ROBOT_COLOR,
    ROWS,
    TARGET_COLOR,
    RecordedSearch,
    cost_image,
    rim_of,
    robots_map,
)
from dc2g_jax._src.search_indoors.maps.classes import OBJECT_CLASSES

#: Pixels: largest width and height of a panel, gap between panels, space above them; length of the robot's arrow.
_ROOM, _GAP, _CAPTION, _ARROW = (380, 380), 14, 38, 12


def _font(name: str) -> ImageFont.FreeTypeFont:
    """One of matplotlib's fonts."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf", 13)


def search_pictures(search: RecordedSearch, numbers: Iterable[int]) -> Iterator[Picture]:
    """Pictures of some moments of a search: RGB, of equal size, with an even width and height."""
    size, track, high = search.size, search.track, search.highest
    left, right, bottom, top = search.extent
    scale = min(_ROOM[0] / (right - left), _ROOM[1] / (top - bottom))  # pixels a meter
    width, height = round(scale * (right - left)), round(scale * (top - bottom))
    true = search.true_map

    def pixels(x: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
        """Pixels in a panel of places in meters."""
        return list(zip((scale * (x - left)).tolist(), (scale * (top - y)).tolist(), strict=True))

    def panel(image: UInt8[np.ndarray, "h w 3"], first: Sequence[int] | Int[np.ndarray, "2"]) -> Image.Image:
        """The image of cells at its place in the world; `first` is row and column of its first cell."""
        columns = np.floor((left + (np.arange(width) + 0.5) / scale) / size).astype(int) - int(first[1])
        rows = np.floor(((np.arange(height) + 0.5) / scale - top) / size).astype(int) - int(first[0])
        inside = ((rows >= 0) & (rows < len(image)))[:, None] & (columns >= 0) & (columns < image.shape[1])
        cells = image[np.clip(rows, 0, len(image) - 1)[:, None], np.clip(columns, 0, image.shape[1] - 1)]
        return Image.fromarray(np.where(inside[..., None], cells, 255).astype(np.uint8))

    rim = [pixels(*line.T) for line in rim_of(search.wanted, size)]
    across, down = 3 * (width + _GAP) + _GAP, height + _CAPTION + 2 * _GAP
    paper_size = (across + across % 2, down + down % 2)
    for number in numbers:
        moment = search.moments[number]
        costs = np.asarray(255 * (1 - (1 - cost_image(moment.costs, high)[..., :3]) * _known(moment.costs)), np.uint8)
        panels = (panel(true, (0, 0)), panel(robots_map(moment.cells), moment.origin), panel(costs, moment.corner))
        paper = Image.new("RGB", paper_size, "white")
        draw = ImageDraw.Draw(paper)
        x, y, yaw = (float(value) for value in track[moment.step, :3])
        captions = (f"step {moment.step}: {moment.doing}", f"target: {OBJECT_CLASSES[search.target]}", "")
        for place, (image, name, words) in enumerate(zip(panels, ROWS, captions, strict=True)):
            on, corner = ImageDraw.Draw(image), (_GAP + place * (width + _GAP), _GAP + _CAPTION)
            if place == 0:
                for line in rim:
                    on.line(line, fill=TARGET_COLOR, width=2)
                way = pixels(*track[: moment.step + 1, :2].T)
                if len(way) > 1:
                    on.line(way, fill=PATH_COLOR, width=2)
            ((column, row),) = pixels(np.array([x]), np.array([y]))
            corners = [
                (column + _ARROW * reach * math.cos(yaw + turn), row - _ARROW * reach * math.sin(yaw + turn))
                for turn, reach in ((0.0, 1.0), (2.5, 0.8), (math.pi, 0.3), (-2.5, 0.8))
            ]
            on.polygon(corners, fill=ROBOT_COLOR, outline="white")
            paper.paste(image, corner)
            draw.rectangle((corner[0] - 1, corner[1] - 1, corner[0] + width, corner[1] + height), outline="#bbbbbb")
            draw.text((corner[0], _GAP), name, "black", _font("DejaVuSans-Bold"))
            draw.text((corner[0], _GAP + 17), words, "#666666", _font("DejaVuSans"))
        yield np.asarray(paper)


def _known(costs: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 1"]:
    return np.isfinite(costs)[..., None].astype(float)


def animate_search(path: str | Path, search: RecordedSearch) -> Path:
    """Write an animation of a search, see `search_pictures`, as `figures.animation.write_animation` does."""
    paint = functools.partial(search_pictures, search)
    return write_animation(path, paint, len(search.moments), (ROBOT_COLOR, TARGET_COLOR, PATH_COLOR), 8)
