"""Animations of episodes as GIF or MP4: planners side by side, step by step."""

import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from dc2g_jax._src.figures._sheets import empty_sheet, most_columns
from dc2g_jax._src.figures._video import Picture, frequent_colors, h264_encoder, write_gif, write_mp4
from dc2g_jax._src.figures.costs import COST_COLORS, exact_cost_to_go, highest_cost
from dc2g_jax._src.figures.episode_figures import (
    MARK_COLOR,
    ROBOT_COLOR,
    SUBGOAL_COLOR,
    draw_costs,
    draw_robot,
    draw_view,
    legend_entries,
    outcome,
)
from dc2g_jax._src.figures.replay import Frames, running_extra_steps
from dc2g_jax._src.figures.results_figures import planner_style
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, TO_GOAL
from dc2g_jax._src.readers.houses import House, tell_on_stderr
from dc2g_jax._src.runtime.errors import InputError

#: Pixels per inch.
_DPI = 120

#: Pictures from which the colors of a GIF are chosen.
_SAMPLE = 12

#: Duration of the last picture, seconds.
_LAST_SECONDS = 2.5


def _doing(frames: Frames, frame: int, extra: float) -> str:
    """The robot's step and current activity, and the extra steps so far in percent."""
    doing = {EXPLORE: "exploring", TO_GOAL: "goal seen", GAVE_UP: "gave up"}[int(frames.mode[frame])]
    if frame == len(frames) - 1:
        doing = outcome(frames)
    return f"step {frame}, {doing}" + (f" ({extra:+.0f} %)" if np.isfinite(extra) else "")


def pictures(house: House, frames_by_planner: Mapping[str, Frames], steps: Iterable[int]) -> Iterator[Picture]:
    """Pictures of planners from one start at some steps: RGB, of equal size, with an even width and height.

    Each planner has a panel with its map, and another with its predicted cost-to-go if it predicts one. Planners that
    have arrived wait.
    """
    shown = [
        (planner, frames, cost)
        for planner, frames in frames_by_planner.items()
        for cost in (False, True)[: 1 + (frames.cost_to_go is not None)]
    ]
    columns = most_columns(len(shown), house.terrain.shape)
    estimates = any(cost for *_, cost in shown)
    widest = [f"{planner_style(planner).label}: step 999, goal seen (+999 %)" for planner in frames_by_planner]
    entries = legend_entries(house.terrain, costs=estimates, view=True)
    sheet = empty_sheet(house.terrain.shape, -(-len(shown) // columns), columns, entries, widest, dpi=_DPI)
    high = highest_cost(house, frames_by_planner, exact_cost_to_go(house)) if estimates else 1.0
    if estimates:
        sheet.bar(0.5, ScalarMappable(Normalize(0, high), COST_COLORS), "predicted cost-to-go (cells)", extend="max")
    panels = [sheet.panel(*divmod(number, columns)) for number in range(len(shown))]
    extra = {planner: running_extra_steps(frames) for planner, frames in frames_by_planner.items()}
    canvas = FigureCanvasAgg(sheet.figure)
    for axes in panels:
        axes.set_animated(True)  # so that the rest is drawn only once
    canvas.draw()
    paper = canvas.copy_from_bbox(sheet.figure.bbox)
    for step in steps:
        canvas.restore_region(paper)
        for axes, (planner, frames, cost) in zip(panels, shown, strict=True):
            for artist in (*axes.images, *axes.collections, *axes.lines, *axes.texts):
                artist.remove()
            frame, style = min(step, len(frames) - 1), planner_style(planner)
            if cost:
                draw_costs(axes, house, frames, frame, high)
                sheet.title(axes, f"predicted cost-to-go{'' if frames.in_cells else ' (relative)'}")
            else:
                draw_view(axes, house, frames, frame, in_view=True)
                sheet.title(axes, f"{style.label}: {_doing(frames, frame, extra[planner][frame])}", style.color)
            draw_robot(axes, frames, frame)
            axes.draw(canvas.get_renderer())
        picture = np.asarray(canvas.buffer_rgba())[..., :3]
        yield picture[: len(picture) // 2 * 2, : picture.shape[1] // 2 * 2].copy()


def write_animation(
    path: str | Path,
    paint: Callable[[Sequence[int]], Iterator[Picture]],
    count: int,
    colors: Sequence[str],
    frames_per_second: int,
    most_pictures: int = 250,
) -> Path:
    """Write an animation. Where the encoder of MP4 is missing, a GIF takes its place, with a line on the error stream.

    Args:
      path: file to write; its ending gives the format, `.gif` or `.mp4`.
      paint: paints the pictures of these numbers.
      count: number of pictures.
      colors: colors, as `#rrggbb`, that a GIF surely has.
      frames_per_second: pictures per second; the last one stays longer.
      most_pictures: of more pictures, only every second, third ... is shown, and always the last.

    Returns:
      The path of the file.

    Raises:
      InputError: the ending is not known, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise InputError(f"{path}: is not an animation; give a name that ends in .gif or .mp4")
    program = h264_encoder() if path.suffix.lower() == ".mp4" else None
    if path.suffix.lower() == ".mp4" and program is None:
        path = path.with_suffix(".gif")
        tell_on_stderr(f'{path}: is no MP4, as there is no encoder for it; run: pip install "dc2g_jax[all]"')
    shown = [*range(0, count - 1, -(-max(count - 1, 1) // most_pictures)), count - 1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if program is None:
            sample = shown[:: max(1, len(shown) // _SAMPLE)] + shown[-1:]
            durations = [1 / frames_per_second] * (len(shown) - 1) + [_LAST_SECONDS]
            write_gif(path, paint(shown), frequent_colors(paint(sample), colors), durations)
        else:
            write_mp4(path, paint(shown), frames_per_second, _LAST_SECONDS, program)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name a file in a folder of yours") from None
    return path


def animate(path: str | Path, house: House, frames_by_planner: Mapping[str, Frames]) -> Path:
    """Write an animation of planners from one start, side by side; see `pictures` and `write_animation`."""
    paint = functools.partial(pictures, house, frames_by_planner)
    count = max(len(frames) for frames in frames_by_planner.values())
    return write_animation(path, paint, count, (MARK_COLOR, ROBOT_COLOR, SUBGOAL_COLOR), frames_per_second=12)
