"""Animations of episodes as GIF or MP4: planners side by side, step by step."""

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from jaxtyping import Bool, Float
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from PIL import Image, ImageDraw, ImageFont

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.figures._video import Picture, frequent_colors, h264_encoder, write_gif, write_mp4
from dc2g_jax._src.figures.costs import (
    BLOCKED_COLOR,
    COST_COLORS,
    cost_image,
    cost_shares,
    exact_cost_to_go,
    highest_cost,
    predicts,
)
from dc2g_jax._src.figures.episode_figures import MARK_COLOR, ROBOT_COLOR, SUBGOAL_COLOR, goal_marks, outcome
from dc2g_jax._src.figures.replay import Frames, running_extra_steps
from dc2g_jax._src.figures.results_figures import hidden_color, map_image, planner_style, present_classes
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_COLORS, TRAVERSABLE
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, TO_GOAL
from dc2g_jax._src.readers.houses import House, tell_on_stderr

#: Pixels: largest width and height of all panels together, and the same if cells would have fewer than three pixels;
#: least width of a panel's column; then the gap between panels and the space above them.
_ROOM, _LARGE_ROOM, _LEAST_WIDE = (790, 600), (960, 640), 220
_GAP, _CAPTION, _FONT = 14, 38, 13

#: Pixels of the legend: height of a line, gap between a symbol and its label, gap between entries, side of a patch.
_LINE, _SIGN_GAP, _ENTRY_GAP, _PATCH = 22, 6, 18, 13

#: Largest number of pictures of an episode; of a longer one only every second, third ... step is shown.
_MOST_PICTURES = 250

#: Pictures from which the colors of a GIF are chosen.
_SAMPLE = 12

#: Duration of the last picture, seconds.
_LAST_SECONDS = 2.5

#: Number of colors of the predicted cost-to-go; few, so that files stay small.
_COST_LEVELS = 40

_INK, _PALE_INK, _FRAME = "#222222", "#666666", "#bbbbbb"

#: Colors of the outlines of seen cells and of the field of view.
_SEEN_RIM, _VIEW_RIM = to_rgb("#4d4d4d"), to_rgb("#e69f00")

#: Outlines of marks around the origin, in units of half a mark; the robot's in each heading.
TRIANGLES = [[(1, 0), (-0.8, -0.85), (-0.8, 0.85)]]
for _ in range(3):  # one per heading: a right turn takes (x, y) to (-y, x)
    TRIANGLES.append([(-y, x) for x, y in TRIANGLES[-1]])
_CIRCLE = [(math.cos(angle), math.sin(angle)) for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False)]
STAR = [
    (radius * math.sin(np.pi * corner / 5), -radius * math.cos(np.pi * corner / 5))
    for corner, radius in enumerate((1, 0.42) * 5)
]
CROSS = [(0, 0.4), (0.6, 1), (1, 0.6), (0.4, 0), (1, -0.6), (0.6, -1)]
CROSS += [(-x, -y) for x, y in CROSS]


class _Panel(NamedTuple):
    """Content of a panel.

    Attributes:
      planner: name of the planner.
      frames: its episode.
      cost: whether the panel shows the predicted cost-to-go instead of the map.
    """

    planner: str
    frames: Frames
    cost: bool


class _Layout(NamedTuple):
    """Layout of the panels, in pixels.

    Attributes:
      scale: side of a cell.
      column: width of a panel's column.
      corners: upper left corner of each panel's map.
      size: width and height of a picture; even, as video codecs require.
    """

    scale: int
    column: int
    corners: list[tuple[int, int]]
    size: tuple[int, int]


def _layout(n_panels: int, height: int, width: int) -> _Layout:
    """The layout whose number of columns makes the panels largest."""
    for room in (_ROOM, _LARGE_ROOM):
        best = (0.0, 0, 1)
        for columns in range(1, n_panels + 1):
            rows = -(-n_panels // columns)
            scale = max(1, min(room[0] // columns // width, room[1] // rows // height))
            best = max(best, (scale * n_panels / (rows * columns), columns, scale))
        _, columns, scale = best
        if scale >= 3:
            break
    column, row = max(scale * width, _LEAST_WIDE), _CAPTION + scale * height
    places = [divmod(number, columns) for number in range(n_panels)]
    corners = [(_GAP + right * (column + _GAP), _GAP + down * (row + _GAP) + _CAPTION) for down, right in places]
    rows = places[-1][0] + 1
    whole_width, whole_height = columns * (column + _GAP) + _GAP, rows * (row + _GAP) + _GAP
    return _Layout(scale, column, corners, (whole_width + whole_width % 2, whole_height + whole_height % 2))


def font(name: str) -> ImageFont.FreeTypeFont:
    """One of matplotlib's fonts."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf", _FONT)


def _mark(outline: Sequence[tuple[float, float]], color: str, side: int) -> Image.Image:
    """A mark with a black edge and rounded corners on a transparent background."""
    fine = 8 * side
    image = Image.new("RGBA", (fine, fine), (0, 0, 0, 0))
    points = [(fine * (0.5 + 0.43 * x), fine * (0.5 + 0.43 * y)) for x, y in outline]
    draw = ImageDraw.Draw(image)
    draw.polygon(points, fill=color)
    draw.line([*points, *points[:2]], fill="black", width=int(np.clip(fine // 9, 8, 14)), joint="curve")
    return image.resize((side, side), Image.Resampling.LANCZOS)


def _enlarged(cells: np.ndarray, scale: int) -> np.ndarray:
    """Every cell as a square of pixels."""
    return cells.repeat(scale, 0).repeat(scale, 1)


def _rim(pixels: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """The pixels of a set that have a neighbor outside it within the picture."""
    framed = np.pad(pixels, 1, mode="edge")
    inner = framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    return pixels & ~inner


def _patch(color: Sequence[float], rim: Sequence[float]) -> Image.Image:
    """A square of a color with an outline, both RGB from 0 to 1."""
    pixels = np.broadcast_to(np.asarray(rim), (_PATCH, _PATCH, 3)).copy()
    pixels[1:-1, 1:-1] = color
    return _image(pixels).convert("RGBA")


def _image(pixels: Float[np.ndarray, "height width 3"]) -> Image.Image:
    """An image of RGB from 0 to 1."""
    return Image.fromarray((255 * pixels + 0.5).astype(np.uint8))


def _with_legend(
    size: tuple[int, int], entries: Mapping[str, Image.Image], font: ImageFont.FreeTypeFont
) -> Image.Image:
    """An empty picture of the given size with a legend below it, in left-aligned lines. Its height is even too."""
    places, x, line = [], _GAP, 0
    for word, sign in entries.items():
        length = sign.width + _SIGN_GAP + math.ceil(font.getlength(word))
        if x > _GAP and x + length > size[0] - _GAP:
            x, line = _GAP, line + 1
        places.append((x, size[1] + line * _LINE + _LINE // 2))
        x += length + _ENTRY_GAP
    paper = Image.new("RGB", (size[0], size[1] + (line + 1) * _LINE + _GAP // 2 * 2), "white")
    draw = ImageDraw.Draw(paper)
    for (x, y), (word, sign) in zip(places, entries.items(), strict=True):
        paper.paste(sign, (x, y - sign.height // 2), sign)
        draw.text((x + sign.width + _SIGN_GAP, y), word, _INK, font, anchor="lm")
    return paper


class _Painter:
    """Paints the pictures of one start.

    Args:
      house: house of the episodes.
      panels: panels to paint.
      layout: layout of the panels.
    """

    def __init__(self, house: House, panels: Sequence[_Panel], layout: _Layout):
        self._terrain = house.terrain
        self._panels = panels
        self._layout = layout
        self._extra = [running_extra_steps(panel.frames) for panel in panels]
        self._font, self._bold = font("DejaVuSans"), font("DejaVuSans-Bold")
        side = int(np.clip(2.6 * layout.scale, 11, 24))
        self._robots = [_mark(triangle, ROBOT_COLOR, side + 3) for triangle in TRIANGLES]
        self._start, self._subgoal = _mark(_CIRCLE, MARK_COLOR, side * 2 // 3), _mark(CROSS, SUBGOAL_COLOR, side - 1)
        self._goal, self._reached = _mark(STAR, MARK_COLOR, side + 1), _mark(STAR, MARK_COLOR, 2 * side + 6)
        estimates = {panel.planner: panel.frames for panel in panels if panel.cost}
        self._high = highest_cost(house, estimates, exact_cost_to_go(house)) if estimates else 1.0
        self._paper = _with_legend(layout.size, self._entries(bool(estimates)), self._font)

    def _entries(self, estimates: bool) -> dict[str, Image.Image]:
        """The legend: classes, the most frequent first, pale and framed cells, and marks."""
        frame, classes = to_rgb(_FRAME), present_classes(self._terrain)
        names = [CLASS_NAMES[index] for index in classes]
        entries = {name.replace("_", " "): _patch(to_rgb(FIGURE_COLORS[name]), frame) for name in names}
        entries["not seen yet"] = _patch(hidden_color(classes[0]), frame)
        if estimates:
            entries["not traversable"] = _patch(to_rgb(BLOCKED_COLOR), frame)
        if self._layout.scale > 2:
            entries["in view"] = _patch((1.0, 1.0, 1.0), _VIEW_RIM)
        marks = {"start": self._start, "robot": self._robots[0], "subgoal": self._subgoal, "goal": self._goal}
        return entries | marks

    def paint(self, step: int) -> Picture:
        """The picture of a step; robots that have arrived stay where they are."""
        picture = self._paper.copy()
        draw = ImageDraw.Draw(picture)
        for number, (panel, corner) in enumerate(zip(self._panels, self._layout.corners, strict=True)):
            frame = min(step, len(panel.frames) - 1)
            ground = self._ground(panel, frame)
            picture.paste(ground, corner)
            end = (corner[0] + ground.width, corner[1] + ground.height)
            draw.rectangle((corner[0] - 1, corner[1] - 1, *end), outline=_FRAME)
            self._draw_robot(picture, draw, corner, panel, frame)
            self._write(draw, corner, number, frame)
        return np.asarray(picture)

    def _costs(self, frames: Frames, frame: int) -> np.ndarray:
        """Predicted costs-to-go of seen ground: RGB from 0 to 1, `[h w 3]`."""
        share = np.rint(_COST_LEVELS * cost_shares(frames, self._high)[frame]) / _COST_LEVELS
        ground, seen = TRAVERSABLE[self._terrain], frames.seen[frame]
        return cost_image(share, seen & ground, seen & ~ground)

    def _ground(self, panel: _Panel, frame: int) -> Image.Image:
        """The map or the costs: cells as squares of pixels, with outlines of the seen cells and the field of view."""
        frames, scale = panel.frames, self._layout.scale
        seen = frames.seen[frame]
        cells = self._costs(frames, frame) if panel.cost else map_image(self._terrain, seen)
        pixels = _enlarged(cells, scale)
        if scale > 2:
            pixels[_rim(_enlarged(seen, scale))] = _SEEN_RIM
            if panel.cost:  # in gray, costs near the goal look like blocked ground
                pixels[_rim(_enlarged(seen & TRAVERSABLE[self._terrain], scale))] = _SEEN_RIM
            else:
                pixels[_rim(_enlarged(frames.field_of_view[frame], scale))] = _VIEW_RIM
        return _image(pixels)

    def _draw_robot(
        self, picture: Image.Image, draw: ImageDraw.ImageDraw, corner: tuple[int, int], panel: _Panel, frame: int
    ) -> None:
        """Draw the goals, the path so far, the subgoal of the plan, and the robot."""
        frames, scale = panel.frames, self._layout.scale

        def put(mark: Image.Image, places: list[tuple[int, int]]) -> None:
            for x, y in places:
                picture.paste(mark, (x - mark.width // 2, y - mark.height // 2), mark)

        way = self._middles(corner, frames.pose.x[: frame + 1], frames.pose.y[: frame + 1])
        if len(way) > 1:
            for color, width in (("white", 4), ("black", 2)) if scale > 2 else (("white", 3), ("black", 1)):
                draw.line(way, fill=color, width=width)
        if not panel.cost:
            robot = int(frames.pose.x[frame]), int(frames.pose.y[frame])
            places, reached = goal_marks(self._terrain, robot)
            marks = self._middles(corner, *np.array(places, int).reshape(-1, 2).T)
            put(self._goal, marks[: len(marks) - reached])
            put(self._reached, marks[len(marks) - reached :])
        put(self._start, way[:1])
        if frames.mode[frame] == EXPLORE and frame < len(frames) - 1:
            rows, columns = np.nonzero(frames.subgoals[frame].any(axis=0))
            put(self._subgoal, self._middles(corner, columns[:1], rows[:1]))
        put(self._robots[frames.pose.heading[frame]], way[-1:])

    def _middles(self, corner: tuple[int, int], x: Any, y: Any) -> list[tuple[int, int]]:
        """Pixels of the centers of cells."""
        places = np.stack([x, y], axis=-1).reshape(-1, 2) * self._layout.scale + self._layout.scale // 2 + corner
        return [(column, row) for column, row in places.tolist()]

    def _write(self, draw: ImageDraw.ImageDraw, corner: tuple[int, int], number: int, frame: int) -> None:
        """Write two lines above a panel."""
        panel = self._panels[number]
        style = planner_style(panel.planner)
        x, upper, lower = corner[0], corner[1] - _CAPTION + 2, corner[1] - _CAPTION + 19
        if panel.cost:
            draw.text((x, upper), "predicted cost-to-go", _INK, self._font)
            assert panel.frames.cost_to_go is not None
            if not predicts(panel.frames.cost_to_go[frame]):
                draw.text((x, lower), "no prediction", _PALE_INK, self._font)
                return
            self._draw_scale(draw, x, lower, in_cells=panel.frames.in_cells)
            return
        draw.text((x, upper), style.label, style.color, self._bold)
        draw.text((x, lower), f"step {frame}: {_doing(panel.frames, frame)}", _INK, self._font)
        extra = self._extra[number][frame]
        if np.isfinite(extra):
            right = x + self._layout.column
            draw.text((right, lower), f"{extra:+.0f} %", _PALE_INK, self._font, anchor="ra")

    def _draw_scale(self, draw: ImageDraw.ImageDraw, x: int, y: int, *, in_cells: bool) -> None:
        """Draw the color scale of costs, from 0 to the highest."""
        draw.text((x, y), "0", _PALE_INK, self._font)
        for level in range(_COST_LEVELS):
            color = tuple(int(255 * value) for value in colormaps[COST_COLORS](level / _COST_LEVELS)[:3])
            left = x + 14 + 2 * level
            draw.rectangle((left, y + 3, left + 1, y + 12), fill=color)
        draw.text(
            (x + 20 + 2 * _COST_LEVELS, y),
            f"{self._high:.0f} cells or more" if in_cells else "highest",
            _PALE_INK,
            self._font,
        )


def _doing(frames: Frames, frame: int) -> str:
    """The robot's current activity in a few words."""
    if frame == len(frames) - 1:
        return outcome(frames)
    return {EXPLORE: "exploring", TO_GOAL: "goal seen", GAVE_UP: "gave up"}[int(frames.mode[frame])]


def pictures(house: House, frames_by_planner: Mapping[str, Frames], steps: Iterable[int]) -> Iterator[Picture]:
    """Pictures of planners from one start: RGB, of equal size, with an even width and height.

    Each planner has a panel with its map, and another with its predicted cost-to-go if it predicts one.

    Args:
      house: the house.
      frames_by_planner: planner name -> its replayed episode, all from one start.
      steps: steps to show; planners that have arrived wait.
    """
    panels = []
    for planner, frames in frames_by_planner.items():
        panels.append(_Panel(planner, frames, False))
        if frames.cost_to_go is not None:
            panels.append(_Panel(planner, frames, True))
    painter = _Painter(house, panels, _layout(len(panels), *house.terrain.shape))
    for step in steps:
        yield painter.paint(step)


def write_animation(
    path: str | Path,
    paint: Callable[[Sequence[int]], Iterator[Picture]],
    count: int,
    colors: Sequence[str],
    frames_per_second: int,
) -> Path:
    """Write an animation. Where the encoder of MP4 is missing, a GIF takes its place, with a line on the error stream.

    Args:
      path: file to write; its ending gives the format, `.gif` or `.mp4`.
      paint: paints the pictures of these numbers. Of many, every second, third ... is shown, and always the last.
      count: number of pictures.
      colors: colors, as `#rrggbb`, that a GIF surely has.
      frames_per_second: pictures per second; the last one stays longer.

    Returns:
      The path of the file.

    Raises:
      InputError: the ending is not known, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise InputError(f"{path}: is not an animation; give a name that ends in .gif or .mp4")
    if path.suffix.lower() == ".mp4" and h264_encoder() is None:
        path = path.with_suffix(".gif")
        tell_on_stderr(f'{path}: is no MP4, as there is no encoder for it; run: pip install "dc2g_jax[all]"')
    shown = [*range(0, count - 1, -(-max(count - 1, 1) // _MOST_PICTURES)), count - 1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix.lower() == ".gif":
            sample = shown[:: max(1, len(shown) // _SAMPLE)] + shown[-1:]
            durations = [1 / frames_per_second] * (len(shown) - 1) + [_LAST_SECONDS]
            write_gif(path, paint(shown), frequent_colors(paint(sample), colors), durations)
        else:
            write_mp4(path, paint(shown), frames_per_second, _LAST_SECONDS)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name a file in a folder of yours") from None
    return path


def animate(
    path: str | Path, house: House, frames_by_planner: Mapping[str, Frames], *, frames_per_second: int = 12
) -> Path:
    """Write an animation of planners from one start, side by side, see `pictures`.

    Args:
      path: file to write, see `write_animation`.
      house: the house.
      frames_by_planner: planner name -> its replayed episode, all from one start.
      frames_per_second: pictures per second.

    Returns:
      The path of the file.

    Raises:
      InputError: see `write_animation`.
    """
    paint = functools.partial(pictures, house, frames_by_planner)
    count = max(len(frames) for frames in frames_by_planner.values())
    return write_animation(path, paint, count, (MARK_COLOR, ROBOT_COLOR, SUBGOAL_COLOR), frames_per_second)
