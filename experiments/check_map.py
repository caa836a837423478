"""Look at a map of your own before planning on it: `python -m experiments.check_map my.png --palette palette.csv`."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from dc2g_jax.datasets.class_images import read_palette
from dc2g_jax.datasets.maps import Goal, draw_map, require_way_to_goal
from dc2g_jax.datasets.occupancy import YAML_ENDINGS, read_occupancy_map
from dc2g_jax.estimation.estimators import world_cost_to_go
from dc2g_jax.grid.ground import Piece, connected_to_goal, goals_without_ground, pieces
from dc2g_jax.grid.terrain import CLASS_NAMES, FRONT_DOOR, TRAVERSABLE, UNKNOWN
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.inspection.map_figures import plot_map
from experiments.common import command_line, output_folder

#: Pieces of a map whose places a line names.
_NAMED_PIECES = 5


@dataclasses.dataclass(frozen=True)
class Options:
    """Show what a planner would see of a map: classes, ground, goals and cost-to-go, as text and as a figure.

    Attributes:
      map: a class picture (.png), an array of class indices (.npy), or the YAML file of a ROS occupancy map.
      palette: CSV file with the columns class,r,g,b: what the colours of a picture mean.
      goals: goals besides the front doors that are drawn, x and y of one after the other.
      goal_unit: `cells` are columns and rows of the grid, `metres` lie in the map frame of a ROS map.
      cells: columns and rows of the grid that the map is sampled to; a pixel a cell where not given.
      out: folder to write to; a new one below outputs/ where not given.
    """

    map: tyro.conf.Positional[Path]
    palette: Annotated[Path | None, tyro.conf.arg(metavar="CSV")] = None
    goals: tuple[tuple[float, float], ...] = ()
    goal_unit: Literal["cells", "metres"] = "cells"
    cells: tuple[int, int] | None = None
    out: Path | None = None


def places(found: list[Piece]) -> str:
    """How many cells each piece has and the column and row of its middle, the largest first."""
    named = [f"{piece.cells:,} at ({piece.x}, {piece.y})" for piece in found[:_NAMED_PIECES]]
    others = len(found) - len(named)
    return ", ".join(named) + (f", and {others} other places" if others else "")


def report(terrain: np.ndarray, cost_to_go: np.ndarray) -> list[str]:
    """The facts of a map, a line each."""
    lines = []
    cells = np.bincount(terrain.ravel(), minlength=len(CLASS_NAMES))
    for index in np.argsort(-cells, kind="stable")[: np.count_nonzero(cells)]:
        name = "unknown" if index == UNKNOWN else CLASS_NAMES[index]
        lines.append(f"{cells[index]:>10,} {name}{' (traversable)' if TRAVERSABLE[index] else ''}")
    lines.append(f"goal cells: {places(pieces(terrain == FRONT_DOOR)) or 'none'}")
    leading = connected_to_goal(terrain)
    ground = int(np.sum(TRAVERSABLE[terrain]))
    if np.any(leading):
        share, farthest = 100 * np.sum(leading) / ground, np.max(cost_to_go[leading])
        lines.append(
            f"traversable cells: {ground:,}, of which {share:.1f} % lead to a goal, {farthest:.0f} cells away at most"
        )
    return lines


def warnings(terrain: np.ndarray) -> list[str]:
    """What a planner can live with but is probably not meant, a line each."""
    lines = []
    if islands := pieces(TRAVERSABLE[terrain] & ~connected_to_goal(terrain)):
        lines.append(f"traversable cells that lead to no goal: {places(islands)}")
    if lost := pieces(goals_without_ground(terrain)):
        lines.append(f"goal cells that touch no other traversable ground: {places(lost)}")
    return lines


def main(options: Options) -> None:
    """Read, report, draw; a map of no use is drawn as well, and then refused."""
    palette = None if options.palette is None else read_palette(options.palette)
    goals = [Goal(x, y, options.goal_unit) for x, y in options.goals]
    terrain = draw_map(options.map, palette=palette, goals=goals, cells=options.cells)
    out = output_folder(options.out, "check_map")
    cost_to_go = np.asarray(world_cost_to_go(world_from_terrain(terrain)))
    lines = report(terrain, cost_to_go) + [f"warning: {line}" for line in warnings(terrain)]
    if options.map.suffix.lower() in YAML_ENDINGS and (doubt := read_occupancy_map(options.map).doubt):
        lines.append(f"warning: {doubt}")
    title = f"{options.map.name}: {terrain.shape[1]} x {terrain.shape[0]} cells"
    print("\n".join([title, *lines]))
    files = plot_map(out / options.map.stem, title, terrain, cost_to_go)
    print(f"Written: {', '.join(str(file) for file in files)}")
    require_way_to_goal(str(options.map), terrain)


if __name__ == "__main__":
    command_line(Options, main)
