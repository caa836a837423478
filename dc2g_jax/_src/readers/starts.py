"""Start poses of episodes: sampled on roads, read from a CSV file, or as published."""

import csv
import functools
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.files.tables import table_lines, whole_cell
from dc2g_jax._src.grid.ground import connected_to_goal, why_no_path
from dc2g_jax._src.grid.poses import HEADINGS
from dc2g_jax._src.grid.sensing import MAX_SENSING_RANGE
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, ROAD, TRAVERSABLE
from dc2g_jax._src.readers.houses import SPLIT_FILES, House, HouseDataset


class Start(NamedTuple):
    """First pose of an episode.

    Attributes:
      house: name of the house.
      x: column.
      y: row, growing downward.
      heading: 0 = +x, 1 = +y, 2 = -x, 3 = -y.
      sensing_range: range of the field of view in cells, `None` for the default of the settings.
      expanding_range: range of the frontier-expanding kernel in cells, `None` for the default of the settings.
    """

    house: str
    x: int
    y: int
    heading: int
    sensing_range: int | None = None
    expanding_range: int | None = None


class PublishedEpisode(NamedTuple):
    """One of the 400 episodes behind the paper's headline figures.

    Attributes:
      group: `train`, `same_neighborhood`, `new_neighborhood` or `urban`.
      start: first pose.
      oracle: steps of the authors' oracle.
      frontier: steps of the authors' frontier planner.
      dc2g: steps of the authors' DC2G planner.
    """

    group: str
    start: Start
    oracle: int
    frontier: int
    dc2g: int


@functools.cache
def published_episodes() -> tuple[PublishedEpisode, ...]:
    """The 400 published episodes with the authors' step counts."""
    with resource("published_episodes.csv").open(newline="") as file:
        lines = (line for line in file if not line.startswith("#"))
        return tuple(
            PublishedEpisode(
                group=row["group"],
                start=Start(row["house"], int(row["x"]), int(row["y"]), int(row["heading"])),
                oracle=int(row["oracle"]),
                frontier=int(row["frontier"]),
                dc2g=int(row["dc2g"]),
            )
            for row in csv.DictReader(lines)
        )


def start_cells(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Road cells from which a front door can be reached; on maps without road, all such ground except the doors."""
    ground = terrain == ROAD if np.any(terrain == ROAD) else terrain != FRONT_DOOR
    return np.asarray(connected_to_goal(terrain) & ground)


def start_ground(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Cells from which an episode can start, of any ground."""
    return connected_to_goal(terrain) & (terrain != FRONT_DOOR)


def nearest_start(terrain: UInt8[np.ndarray, "h w"], x: int, y: int) -> str:
    """Describe the nearest cell in which an episode can start."""
    rows, columns = np.nonzero(start_ground(terrain))
    if not len(rows):
        return "the map has no ground that leads to a goal"
    nearest = int(np.argmin((columns - x) ** 2 + (rows - y) ** 2))
    return f"the nearest cell to start from lies at column {columns[nearest]}, row {rows[nearest]}"


def why_no_start(terrain: UInt8[np.ndarray, "h w"], x: int, y: int) -> str | None:
    """The reason why no episode can start in a cell, or `None`."""
    height, width = terrain.shape
    if not (0 <= x < width and 0 <= y < height):
        return f"column {x}, row {y} is off the map of {width} x {height} cells"
    if terrain[y, x] == FRONT_DOOR:
        return f"column {x}, row {y} is a goal already"
    if not TRAVERSABLE[terrain[y, x]]:
        name = CLASS_NAMES[terrain[y, x]] if terrain[y, x] else "unknown"
        return f"column {x}, row {y} is {name!r}, which is not traversable"
    if not connected_to_goal(terrain)[y, x]:
        return f"no goal can be reached from column {x}, row {y}"
    return None


def why_no_episode(house: House) -> str | None:
    """The reason why no episode can be run in a house; `None` if one can."""
    if reason := why_no_path(house.terrain):
        return reason
    if not np.any(start_cells(house.terrain)):
        return "no front door can be reached from any of its road cells"
    return None


def usable_houses(dataset: HouseDataset, split: str, *, instead: str = "give another dataset") -> list[House]:
    """Houses of a split in which an episode can be run, see `why_no_episode`.

    Args:
      dataset: the dataset.
      split: `train`, `val` or `test`.
      instead: for the message, what else the user can do than add maps.

    Raises:
      InputError: there are none.
    """
    given = dataset.split(split)
    houses = [house for house in given if why_no_episode(house) is None]
    if not houses:
        or_add = (
            f", or put maps with a path from a road to a front door into its folder {split}/ (in the published layout: "
            f"list such houses in {SPLIT_FILES[split]})"
        )
        drawn = dataset.source == "procedural"
        raise InputError(
            f"{dataset.name}: no episode can be run in any of its {len(given)} {split} houses; {instead}"
            f"{'' if drawn else or_add}"
        )
    return houses


def sample_starts(houses: Iterable[House], per_house: int, *, seed: int) -> list[Start]:
    """Random starts on `start_cells`, in random headings.

    The starts of a house depend only on the seed and the name of the house. Houses in which no episode can be run get
    no starts, see `why_no_episode`.

    Raises:
      InputError: `per_house` is less than 1.
    """
    if per_house < 1:
        raise InputError(f"{per_house} starts per house: give 1 or more")
    starts = []
    for house in houses:
        if why_no_episode(house) is not None:
            continue
        rng = np.random.default_rng([seed, zlib.crc32(house.name.encode())])
        rows, columns = np.nonzero(start_cells(house.terrain))
        for cell, heading in zip(
            rng.integers(len(rows), size=per_house), rng.integers(HEADINGS, size=per_house), strict=True
        ):
            starts.append(Start(house.name, int(columns[cell]), int(rows[cell]), int(heading)))
    return starts


_REQUIRED = ("house", "x", "y", "heading")
_OPTIONAL = ("range", "expanding_range")
# Kernels of the authors' code need two cells.
_MIN_RANGE = 2


def _read_start(where: str, row: dict[str, str], house: House, connected: Bool[np.ndarray, "h w"]) -> Start:
    """A start on one of the `connected` cells, those that a front door can be reached from."""

    def number(column: str, low: int, high: int) -> int:
        return whole_cell(f"{where}: {column}", row[column], low, high)

    height, width = house.terrain.shape
    x, y = number("x", 0, width - 1), number("y", 0, height - 1)
    if house.terrain[y, x] == FRONT_DOOR:
        nearest = nearest_start(house.terrain, x, y)
        raise InputError(f"{where}: ({x}, {y}) in {house.name} is a front door already; {nearest}")
    if not connected[y, x]:
        nearest = nearest_start(house.terrain, x, y)
        raise InputError(f"{where}: no front door of {house.name} can be reached from ({x}, {y}); {nearest}")
    ranges = [number(column, _MIN_RANGE, MAX_SENSING_RANGE) if row[column] else None for column in _OPTIONAL]
    return Start(house.name, x, y, number("heading", 0, HEADINGS - 1), *ranges)


def read_starts(path: str | Path, dataset: HouseDataset) -> list[Start]:
    """Read starts from a CSV file with the columns `house,x,y,heading` and, optionally, `range,expanding_range`.

    Other columns are ignored.

    Raises:
      InputError: the file cannot be read or lacks a column, a number is invalid, a house is unknown, no goal can be
        reached from a start (the message names the line), or the table holds episodes of several planners.
    """
    path = Path(path)
    remedy = f"give a CSV file with columns {', '.join(_REQUIRED)}"

    @functools.cache  # there may be a million starts in a few houses
    def look_up(name: str) -> tuple[House, Bool[np.ndarray, "h w"]]:
        house = dataset.house(name)
        if reason := why_no_episode(house):
            raise InputError(f"no episode can be run in {name}: {reason}; remove the line")
        return house, connected_to_goal(house.terrain)

    starts, of_planners = [], set()
    for line, row in table_lines(path, _REQUIRED, optional=(*_OPTIONAL, "planner"), remedy=remedy):
        of_planners.add(row["planner"])
        where = f"{path}: line {line}"
        try:
            house, connected = look_up(row["house"])
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        starts.append(_read_start(where, row, house, connected))
    planners = sorted(of_planners)
    if len(planners) > 1:
        raise InputError(
            f"{path}: holds episodes of {len(planners)} planners, {', '.join(planners)}, so each start more than once; "
            "leave the lines of one"
        )
    return starts
