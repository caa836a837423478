"""Start poses of episodes: sampled on roads, read from a CSV file, or as published."""

import csv
import functools
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8

from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.files.tables import table_lines, whole_cell
from dc2g_jax._src.grid.ground import connected_to_goal, why_no_path
from dc2g_jax._src.grid.poses import HEADINGS
from dc2g_jax._src.grid.sensing import MAX_SENSING_RANGE
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, ROAD, TRAVERSABLE
from dc2g_jax._src.readers.houses import SPLIT_FILES, House, HouseDataset
from dc2g_jax._src.runtime.errors import InputError, check_number, check_seed


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


@functools.cache
def published_episodes() -> tuple[tuple[Start, str, dict[str, int]], ...]:
    """The 400 episodes behind the paper's headline figures.

    Returns:
      For each episode: its start; the group of its house, `train`, `same_neighborhood`, `new_neighborhood` or `urban`;
      and the steps of the authors' planners `oracle`, `frontier` and `dc2g`.
    """
    with resource("published_episodes.csv").open(newline="") as file:
        return tuple(
            (
                Start(row["house"], int(row["x"]), int(row["y"]), int(row["heading"])),
                row["group"],
                {planner: int(row[planner]) for planner in ("oracle", "frontier", "dc2g")},
            )
            for row in csv.DictReader(line for line in file if not line.startswith("#"))
        )


def any_ground(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Traversable cells except front doors, whether or not a front door can be reached from them."""
    return TRAVERSABLE[terrain] & (terrain != FRONT_DOOR)


def usual_ground(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Road cells; on maps without road, `any_ground`."""
    return terrain == ROAD if np.any(terrain == ROAD) else any_ground(terrain)


def start_cells(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The usual ground from which a front door can be reached."""
    return np.asarray(connected_to_goal(terrain) & usual_ground(terrain))


def start_ground(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Traversable cells from which a front door can be reached, except front doors."""
    return connected_to_goal(terrain) & any_ground(terrain)


def check_starts(
    starts: Sequence[Start],
    dataset: HouseDataset,
    where: Callable[[int], str] | None = None,
    *,
    ground_of: Callable[[UInt8[np.ndarray, "h w"]], Bool[np.ndarray, "h w"]] = start_ground,
) -> None:
    """Check that an episode can start at each of these poses.

    Args:
      starts: first poses.
      dataset: the houses.
      where: begins the message about a start, given its number from 0.
      ground_of: cells of a map to start from; `any_ground` also allows starts from which no goal can be reached.

    Raises:
      InputError: a house is unknown, or a start is off the map, on a goal, or where no goal can be reached. The message
        names the nearest cell to start from.
    """
    grounds: dict[str, tuple[House, Bool[np.ndarray, "h w"]]] = {}
    for number, start in enumerate(starts):
        try:
            if start.house not in grounds:
                house = dataset.house(start.house)
                grounds[house.name] = house, ground_of(house.terrain)
            house, ground = grounds[start.house]
            height, width = ground.shape
            on_map = 0 <= start.x < width and 0 <= start.y < height
            if not (on_map and ground[start.y, start.x] and 0 <= start.heading < HEADINGS):
                raise InputError(why_no_start(start, house))
        except InputError as error:
            place = where(number) if where else f"start {number} in {start.house}"
            raise InputError(f"{place}: {error}") from None


def why_no_start(start: Start, house: House) -> str:
    """The reason why no goal can be reached from a pose, and the nearest cell from which one can."""
    if not 0 <= start.heading < HEADINGS:
        return f"there is no heading {start.heading}; give 0 (right), 1 (down), 2 (left) or 3 (up)"
    height, width = house.terrain.shape
    no_path = why_no_path(house.terrain)
    cell = f"column {start.x}, row {start.y}"
    if not (0 <= start.x < width and 0 <= start.y < height):
        reason = f"{cell} is off the map of {width} x {height} cells"
    elif (class_index := house.terrain[start.y, start.x]) == FRONT_DOOR:
        reason = f"{cell} is a goal already"
    elif not TRAVERSABLE[class_index]:
        name = CLASS_NAMES[class_index] if class_index else "unknown"
        reason = f"{cell} is {name!r}, which is not traversable"
    elif no_path:
        return f"no goal can be reached from {cell} in {house.name}: {no_path}"
    else:
        reason = f"no goal can be reached from {cell}"
    rows, columns = np.nonzero(any_ground(house.terrain) if no_path else start_ground(house.terrain))
    if not len(rows):
        return f"no episode can be run in {house.name}: {no_path}"
    nearest = int(np.argmin((columns - start.x) ** 2 + (rows - start.y) ** 2))
    return f"{reason}; the nearest cell to start from lies at column {columns[nearest]}, row {rows[nearest]}"


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
      InputError: `per_house` is less than 1, or the seed is invalid.
    """
    check_number("starts per house", per_house, whole=True, least=1)
    check_seed(seed)
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


#: Columns of numbers with the largest number of each; whether a cell is on the map is checked later.
_REQUIRED_NUMBERS = {"x": 10**9 - 1, "y": 10**9 - 1, "heading": HEADINGS - 1}
_REQUIRED = ("house", *_REQUIRED_NUMBERS)
_OPTIONAL = ("range", "expanding_range")
# Kernels of the authors' code need two cells.
_MIN_RANGE = 2


def read_starts(path: str | Path, dataset: HouseDataset) -> list[Start]:
    """Read starts from a CSV file with the columns `house,x,y,heading` and, optionally, `range,expanding_range`.

    Other columns are ignored.

    Raises:
      InputError: the file cannot be read or lacks a column, a number is invalid, a house is unknown, a start is not on
        the ground of its house (the message names the line), or the table holds episodes of several planners.
    """
    path = Path(path)
    remedy = f"give a CSV file with columns {', '.join(_REQUIRED)}"

    def number(column: str, low: int, high: int) -> int:
        return whole_cell(f"{path}: line {line}: {column}", row[column], low, high)

    starts, lines, of_planners = [], [], set()
    for line, row in table_lines(path, _REQUIRED, optional=(*_OPTIONAL, "planner"), remedy=remedy):
        of_planners.add(row["planner"])
        ranges = [number(column, _MIN_RANGE, MAX_SENSING_RANGE) if row[column] else None for column in _OPTIONAL]
        x, y, heading = (number(column, 0, most) for column, most in _REQUIRED_NUMBERS.items())
        starts.append(Start(row["house"], x, y, heading, *ranges))
        lines.append(line)
    check_starts(starts, dataset, lambda number: f"{path}: line {lines[number]}", ground_of=any_ground)
    planners = sorted(of_planners)
    if len(planners) > 1:
        raise InputError(
            f"{path}: holds episodes of {len(planners)} planners, {', '.join(planners)}, so each start more than once; "
            "leave the lines of one"
        )
    return starts
