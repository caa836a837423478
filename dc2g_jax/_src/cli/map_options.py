"""Shared options: a user's own map, and the start of an episode."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from jaxtyping import UInt8

from dc2g_jax._src.cli.outputs import CommandOptions
from dc2g_jax._src.files.class_images import read_palette
from dc2g_jax._src.grid.poses import HEADINGS
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.maps import Goal, draw_map
from dc2g_jax._src.readers.occupancy import YAML_ENDINGS, read_occupancy_map
from dc2g_jax._src.readers.starts import Start, any_ground, check_starts, sample_starts, usual_ground
from dc2g_jax._src.runtime.errors import InputError

#: Start of an episode: column, row and heading.
StartOption = Annotated[tuple[int, int, int] | None, tyro.conf.arg(metavar="COLUMN ROW HEADING", help_behavior_hint="")]


@dataclasses.dataclass(frozen=True)
class MapOptions(CommandOptions):
    """A map and how to read it.

    Attributes:
      map: class image (.png), array of class indices (.npy), or YAML file of a ROS occupancy map.
      palette: CSV file with the columns class,r,g,b: the colors of the classes in an image.
      goals: goals besides the front doors on the map: x and y of each.
      goal_unit: unit of the goals: `cells` for columns and rows of the grid, `meters` for the map frame of a ROS map.
      cells: columns and rows of the grid that the map is resampled to; by default one cell per pixel.
    """

    map: tyro.conf.Positional[Path]
    palette: Annotated[Path | None, tyro.conf.arg(metavar="CSV", help_behavior_hint="")] = None
    goals: Annotated[tuple[tuple[float, float], ...], tyro.conf.arg(metavar="X Y ...", help_behavior_hint="")] = ()
    goal_unit: Literal["cells", "meters"] = "cells"
    cells: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="COLUMNS ROWS", help_behavior_hint="")] = None


def terrain_of(options: MapOptions) -> UInt8[np.ndarray, "h w"]:
    """The map's class indices. Its goals may be unreachable."""
    palette = None if options.palette is None else read_palette(options.palette)
    goals = [Goal(x, y, options.goal_unit) for x, y in options.goals]
    return draw_map(options.map, palette=palette, goals=goals, cells=options.cells)


def pixels_of(options: MapOptions) -> tuple[int, int]:
    """Columns and rows of the map's file."""
    palette = None if options.palette is None else read_palette(options.palette)
    height, width = draw_map(options.map, palette=palette).shape
    return width, height


def doubts_about(options: MapOptions) -> list[str]:
    """Probable mistakes in a map's file or in the size of its grid, one per line."""
    doubts: list[str] = []
    if options.map.suffix.lower() in YAML_ENDINGS:
        doubts += read_occupancy_map(options.map).doubts
    if options.cells is not None:
        width, height = pixels_of(options)
        columns, rows = options.cells
        kept = max(round(columns * height / width), 1)
        if abs(rows - kept) > 1:
            doubts.append(
                f"--cells {columns} {rows} does not keep the aspect ratio of {width} x {height} pixels; "
                f"--cells {columns} {kept} would"
            )
    return doubts


def start_in(where: str, house: House, pose: tuple[int, int, int] | None, seed: int) -> Start:
    """The given start, or a sampled one: from where a goal can be reached if such a start can be sampled.

    Args:
      where: file or name of the map, for error messages.
      house: the map.
      pose: column, row and heading, or `None` to sample a start.
      seed: seed of the sampled start.

    Raises:
      InputError: the start is off the map, on a goal, or not traversable, and the message names the nearest valid one;
        or there is nowhere to start.
    """
    if pose is not None:
        start = Start(house.name, *pose)
        dataset = HouseDataset(house.name, "folder", (house,))
        check_starts([start], dataset, lambda _: f"{where}: --start {' '.join(map(str, pose))}", ground_of=any_ground)
        return start
    if starts := sample_starts([house], 1, seed=seed):
        return starts[0]
    cells = np.argwhere(usual_ground(house.terrain))
    if not len(cells):
        raise InputError(f"{where}: it has no traversable ground to start from; choose another one")
    rng = np.random.default_rng(seed)
    row, column = rng.choice(cells).tolist()
    return Start(house.name, column, row, int(rng.integers(HEADINGS)))
