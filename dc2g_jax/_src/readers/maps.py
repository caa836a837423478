"""User maps as terrain: class images, class arrays and ROS occupancy maps of any size, and folders of them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from jaxtyping import UInt8

from dc2g_jax._src.files.class_images import PALETTE_FILE, Palette, check_classes, read_class_image, read_palette
from dc2g_jax._src.files.reading import check_file, finite_number, read_array
from dc2g_jax._src.files.tables import read_table, whole_cell
from dc2g_jax._src.grid.ground import why_no_path
from dc2g_jax._src.grid.sampling import ClassImage, sample_grid
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, TRAVERSABLE
from dc2g_jax._src.readers.occupancy import YAML_ENDINGS, OccupancyMap, read_occupancy_map
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number

#: Splits of a dataset, in order; also the folders of their maps.
SPLITS = ("train", "val", "test")

#: Files of a folder of maps, beside the palette.
GOALS_FILE, CELLS_FILE = "goals.csv", "cells.csv"

#: File endings of maps.
MAP_ENDINGS = (".png", ".npy", *YAML_ENDINGS)

_GOAL_REMEDY = "draw a front door, or give a goal (--goals), next to ground that can be driven on: " + ", ".join(
    name for name, drivable in zip(CLASS_NAMES, TRAVERSABLE, strict=True) if drivable and name != "front_door"
)


class Goal(NamedTuple):
    """Position of a goal.

    Attributes:
      x: column of the grid, or meters in the map frame.
      y: row of the grid, growing downward, or meters in the map frame.
      unit: `cells`, or `meters` for ROS maps.
    """

    x: float
    y: float
    unit: Literal["cells", "meters"] = "cells"


def read_map(
    path: str | Path,
    *,
    palette: Palette | None = None,
    goals: Sequence[Goal] = (),
    cells: tuple[int, int] | None = None,
) -> UInt8[np.ndarray, "h w"]:
    """Read a map on which a planner can run: some of its ground leads to a goal.

    Args:
      path: a class image (`.png`), an array of class indices (`.npy`), or the YAML file of a ROS occupancy map.
      palette: classes of the colors of an image.
      goals: goals in addition to the front doors of the map; they become front doors.
      cells: columns and rows of the grid that the map is sampled to, see `grid.sampling.sample_grid` and
        `OccupancyMap.terrain`; `None` for one pixel per cell.

    Returns:
      Class indices, read-only.

    Raises:
      InputError: the map cannot be read, a goal is not on traversable ground, or no goal can be reached.
    """
    terrain = draw_map(path, palette=palette, goals=goals, cells=cells)
    require_path_to_goal(str(path), terrain)
    return terrain


def map_from_classes(
    classes: npt.ArrayLike, *, goals: Sequence[Goal] = (), cells: tuple[int, int] | None = None, name: str = "the array"
) -> UInt8[np.ndarray, "h w"]:
    """A map from an array of class indices in memory, like `read_map`. Messages call it `name`."""
    terrain = _with_goals(name, _sampled_with_doors(name, check_classes(name, classes), cells, goals), goals)
    require_path_to_goal(name, terrain)
    return terrain


def draw_map(
    path: str | Path,
    *,
    palette: Palette | None = None,
    goals: Sequence[Goal] = (),
    cells: tuple[int, int] | None = None,
) -> UInt8[np.ndarray, "h w"]:
    """Read a map like `read_map`, without the check that a goal can be reached."""
    path = Path(path)
    where, ending = str(path), path.suffix.lower()
    if ending in YAML_ENDINGS:
        occupancy = read_occupancy_map(path)
        terrain = occupancy.terrain(*_grid_size(where, occupancy.free.shape, cells))
        return _with_goals(where, terrain, goals, occupancy)
    if ending == ".png":
        check_file(path, "give the file of a map")
        if palette is None:
            raise InputError(
                f"{path}: a picture needs a palette; give one (--palette), a CSV file with the columns class,r,g,b"
            )
        classes = read_class_image(path, palette)
    elif ending == ".npy":
        classes = check_classes(where, read_array(path, "write it with numpy.save"))
    else:
        raise InputError(f"{path}: is not a map; give a file that ends in {', '.join(MAP_ENDINGS)}")
    return _with_goals(where, _sampled_with_doors(where, classes, cells, goals), goals)


def sampled(where: str, classes: ClassImage, cells: int | tuple[int, int] | None) -> ClassImage:
    """Sample class indices to a grid.

    Args:
      where: begins messages of errors.
      classes: class indices, uint8 [H W].
      cells: side of a square grid, or columns and rows, or `None` for no sampling.

    Returns:
      Class indices, read-only.

    Raises:
      InputError: the grid is empty, or finer than the image.
    """
    columns, rows = _grid_size(where, classes.shape, cells)
    terrain = np.array(classes if cells is None else sample_grid(classes, (columns, rows)), np.uint8)
    terrain.setflags(write=False)
    return terrain


def _sampled_with_doors(
    where: str, classes: ClassImage, cells: tuple[int, int] | None, goals: Sequence[Goal]
) -> ClassImage:
    """Class indices on a grid of cells. Raises InputError if sampling loses every front door of the map."""
    terrain = sampled(where, classes, cells)
    if not goals and np.any(classes == FRONT_DOOR) and not np.any(terrain == FRONT_DOOR):
        raise InputError(
            f"{where}: every front door is too small to be left on {terrain.shape[1]} x {terrain.shape[0]} cells; "
            "use more cells, or give goals"
        )
    return terrain


def _grid_size(where: str, shape: tuple[int, ...], cells: int | tuple[int, int] | None) -> tuple[int, int]:
    height, width = shape
    columns, rows = (width, height) if cells is None else (cells, cells) if isinstance(cells, int) else cells
    if not (1 <= columns <= width and 1 <= rows <= height):
        raise InputError(
            f"{where}: wrong grid size: {width} x {height} pixels cannot fill {columns} x {rows} cells; give "
            f"at least 1 x 1 and at most {width} x {height} cells, or a larger image"
        )
    return columns, rows


def _with_goals(
    where: str, terrain: UInt8[np.ndarray, "h w"], goals: Sequence[Goal], occupancy: OccupancyMap | None = None
) -> UInt8[np.ndarray, "h w"]:
    """The map with front doors on the goals, read-only. Goals must lie on traversable ground."""
    drawn = terrain.copy()
    rows, columns = terrain.shape
    ground = TRAVERSABLE[terrain]
    for goal in goals:
        name = f"goal ({goal.x:g}, {goal.y:g})"
        for number in (goal.x, goal.y):
            check_number(f"{where}: {name}", number)
        if goal.unit == "meters":
            if occupancy is None:
                raise InputError(f"{where}: {name} is in meters, which only a ROS map knows; give its column and row")
            name += " in meters"
            cell = occupancy.cell(goal.x, goal.y, columns, rows)
            if cell is None:
                raise InputError(f"{where}: {name} lies far off the map; give a goal on the map")
            column, row = cell
        else:
            column, row = math.floor(goal.x), math.floor(goal.y)
            if (column, row) != (goal.x, goal.y):
                raise InputError(f"{where}: {name} is between cells; give its column and row as whole numbers")
        if not (0 <= column < columns and 0 <= row < rows):
            raise InputError(
                f"{where}: {name} lies at column {column}, row {row}, off the map of {columns} x {rows} cells; "
                "give a goal on the map"
            )
        if not ground[row, column]:
            raise InputError(
                f"{where}: {name} lies at column {column}, row {row} on {CLASS_NAMES[terrain[row, column]]!r}, which "
                f"is not traversable; {_nearest_ground(ground, column, row)}"
            )
        drawn[row, column] = FRONT_DOOR
    drawn.setflags(write=False)
    return drawn


def _nearest_ground(ground: np.ndarray, column: int, row: int) -> str:
    rows, columns = np.nonzero(ground)
    if not len(rows):
        return "the map has no traversable ground at all"
    nearest = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
    return f"the nearest cell that is lies at column {columns[nearest]}, row {rows[nearest]}"


def require_path_to_goal(where: str, terrain: UInt8[np.ndarray, "h w"]) -> None:
    """Raise `InputError` if no ground of the map leads to a goal; `where` begins the message."""
    if reason := why_no_path(terrain):
        raise InputError(f"{where}: {reason}; {_GOAL_REMEDY}")


def map_files(folder: Path) -> list[tuple[str, Path]]:
    """Split and file of each map: those in the folders `train`, `val` and `test`, else all in the folder as `test`.

    Raises:
      InputError: there are maps both in the folder itself and in the folders of the splits.
    """
    in_splits = [(split, path) for split in SPLITS for path in _maps_in(folder / split)]
    loose = _maps_in(folder)
    if loose and in_splits:
        raise InputError(
            f"{loose[0]}: lies beside the folders of the splits, so it is in none of them; move it into one of "
            f"{', '.join(SPLITS)}"
        )
    return in_splits or [("test", path) for path in loose]


def _maps_in(folder: Path) -> list[Path]:
    """The maps of a folder, by name. Hidden files are none: other systems and killed writers leave some."""
    if not folder.is_dir():
        return []
    shown = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted(path for path in shown if path.suffix.lower() in MAP_ENDINGS)


def read_map_folder(folder: Path) -> list[tuple[str, str, UInt8[np.ndarray, "h w"]]]:
    """Read a folder of maps: name, split and terrain of each, by split and then by name.

    Optional files beside the maps: `labels_colors.csv`, the palette of images (`class,r,g,b`); `goals.csv`, goals by
    name of the map (`map,x,y,unit`, see `Goal`); and `cells.csv`, the size of the grid to which every map is sampled
    (`columns,rows` and one line). Without `cells.csv`, each pixel is a cell.

    As in the published dataset, there may be maps without a path to a goal; no episode can be run on them, see
    `readers.starts.why_no_episode`.

    Raises:
      InputError: `draw_map` rejects a map, two maps have the same name, or one of the tables is invalid.
    """
    files = map_files(folder)
    paths: dict[str, Path] = {}
    for _, path in files:
        if path.stem in paths:
            raise InputError(f"{path}: {paths[path.stem]} has the same name; rename one, names must be unique")
        paths[path.stem] = path
    if not paths:
        raise InputError(f"{folder}: holds no maps; add files that end in {', '.join(MAP_ENDINGS)}")
    has_pictures = any(path.suffix.lower() == ".png" for _, path in files)
    palette = read_palette(folder / PALETTE_FILE) if has_pictures else None
    goals = _read_goals(folder / GOALS_FILE, list(paths))
    cells = _read_cells(folder / CELLS_FILE)
    return [
        (path.stem, split, draw_map(path, palette=palette, goals=goals.get(path.stem, ()), cells=cells))
        for split, path in files
    ]


def _read_goals(path: Path, names: Sequence[str]) -> Mapping[str, list[Goal]]:
    """The goals by name of their map; empty if the file does not exist."""
    goals: dict[str, list[Goal]] = {}
    if not path.exists():
        return goals
    for line, row in read_table(path, ("map", "x", "y", "unit"), remedy="give the goals of maps there"):
        name, unit = row["map"], row["unit"]
        check_name("map", name, names, f"({path}, line {line})")
        check_name("unit", unit, ("cells", "meters"), f"({path}, line {line})")
        x, y = (finite_number(f"{path}: line {line}: {column!r}", row[column], "write a number") for column in "xy")
        goals.setdefault(name, []).append(Goal(x, y, "cells" if unit == "cells" else "meters"))
    return goals


def _read_cells(path: Path) -> tuple[int, int] | None:
    """Columns and rows of the grid; `None` if the file does not exist."""
    if not path.exists():
        return None
    table = read_table(path, ("columns", "rows"), remedy="give the size of the grid there")
    line, row = table[-1]
    if len(table) > 1:
        raise InputError(f"{path}: line {line} gives another size of the grid; leave one of them")
    columns, rows = (whole_cell(f"{path}: line {line}: {name}", row[name], 1, 10**9) for name in ("columns", "rows"))
    return columns, rows
