"""Check a map of your own before planning on it: `python -m experiments.check_map my.png --palette palette.csv`."""

import dataclasses

import numpy as np

from dc2g_jax.cli.common import command_line
from dc2g_jax.cli.map_options import MapOptions, doubts_about, terrain_of
from dc2g_jax.cli.options import OutOptions
from dc2g_jax.cli.outputs import output_folder
from dc2g_jax.datasets.maps import require_path_to_goal
from dc2g_jax.estimation.estimators import world_cost_to_go
from dc2g_jax.grid.ground import Piece, connected_to_goal, goals_without_ground, pieces
from dc2g_jax.grid.terrain import CLASS_NAMES, FRONT_DOOR, TRAVERSABLE, UNKNOWN
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.inspection.map_figures import plot_map

#: Number of pieces of ground that a line names.
_NAMED_PIECES = 5


@dataclasses.dataclass(frozen=True)
class Options(MapOptions, OutOptions):
    """Show what a planner would see of a map: classes, ground, goals and cost-to-go, as text and as a figure."""


def places(found: list[Piece]) -> str:
    """Number of cells of each piece, with the column and row of its middle, the largest first."""
    named = [
        f"{piece.cells:,} {'at' if piece.cells == 1 else 'around'} ({piece.x}, {piece.y})"
        for piece in found[:_NAMED_PIECES]
    ]
    others = len(found) - len(named)
    return ", ".join(named) + (f", and {others} other places" if others else "")


def report(terrain: np.ndarray, cost_to_go: np.ndarray) -> list[str]:
    """Facts about a map, one per line."""
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
    """Things that planners accept but that are probably mistakes, one per line."""
    lines = []
    if islands := pieces(TRAVERSABLE[terrain] & ~connected_to_goal(terrain)):
        lines.append(f"traversable cells that lead to no goal: {places(islands)}")
    if lost := pieces(goals_without_ground(terrain)):
        lines.append(f"goal cells that touch no other traversable ground: {places(lost)}")
    return lines


def main(options: Options) -> None:
    """Read, report and draw the map. A map without a path to a goal is drawn too, then rejected."""
    terrain = terrain_of(options)
    out = output_folder(options, "check_map")
    cost_to_go = np.asarray(world_cost_to_go(world_from_terrain(terrain)))
    lines = report(terrain, cost_to_go)
    lines += [f"warning: {line}" for line in warnings(terrain) + doubts_about(options)]
    title = f"{options.map.name}: {terrain.shape[1]} x {terrain.shape[0]} cells"
    print("\n".join([title, *lines]))
    files = plot_map(out / options.map.stem, title, terrain, cost_to_go)
    print(f"Written: {', '.join(str(file) for file in files)}")
    require_path_to_goal(str(options.map), terrain)


if __name__ == "__main__":
    command_line(Options, main)
