"""Facts about a map and warnings of probable mistakes in it, as text."""

import numpy as np
from jaxtyping import Float, UInt8

from dc2g_jax._src.grid.ground import Piece, connected_to_goal, goals_without_ground, pieces
from dc2g_jax._src.grid.streets import is_town, street_width
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FREE, FRONT_DOOR, ROAD, TRAVERSABLE, UNKNOWN

#: Number of pieces of ground that a line names.
_NAMED_PIECES = 5

#: Width in cells of the narrowest street of the published houses, on their grid of 50 x 50 cells.
_STREET = 5


def _places(found: list[Piece]) -> str:
    """Number of cells of each piece, with the column and row of its middle, the largest first."""
    named = [
        f"{piece.cells:,} {'at' if piece.cells == 1 else 'around'} ({piece.x}, {piece.y})"
        for piece in found[:_NAMED_PIECES]
    ]
    others = len(found) - len(named)
    return ", ".join(named) + (f", and {others} other places" if others else "")


def map_report(terrain: UInt8[np.ndarray, "h w"], cost_to_go: Float[np.ndarray, "h w"]) -> list[str]:
    """Facts about a map and its exact cost-to-go, one per line."""
    lines = []
    cells = np.bincount(terrain.ravel(), minlength=len(CLASS_NAMES))
    for index in np.argsort(-cells, kind="stable")[: np.count_nonzero(cells)]:
        name = "unknown" if index == UNKNOWN else CLASS_NAMES[index]
        lines.append(f"{cells[index]:>10,} {name}{' (traversable)' if TRAVERSABLE[index] and index != FREE else ''}")
    lines.append(f"goal cells: {_places(pieces(terrain == FRONT_DOOR)) or 'none'}")
    leading = connected_to_goal(terrain)
    ground = int(np.sum(TRAVERSABLE[terrain]))
    if np.any(leading):
        share, farthest = 100 * np.sum(leading) / ground, np.max(cost_to_go[leading])
        lines.append(
            f"traversable cells: {ground:,}, of which {share:.1f} % lead to a goal, {farthest:.0f} cells away at most"
        )
    return lines


def map_warnings(terrain: UInt8[np.ndarray, "h w"]) -> list[str]:
    """Things that planners accept but that are probably mistakes, one per line."""
    lines = []
    if islands := pieces(TRAVERSABLE[terrain] & ~connected_to_goal(terrain)):
        lines.append(f"traversable cells that lead to no goal: {_places(islands)}")
    if lost := pieces(goals_without_ground(terrain)):
        lines.append(f"goal cells that touch no other traversable ground: {_places(lost)}")
    return lines


def unlike_training(terrain: UInt8[np.ndarray, "h w"], pixels: tuple[int, int]) -> list[str]:
    """In what a map is unlike those that the shipped network was trained on, one per line; and which `--cells` to try.

    `pixels` are columns and rows of the map's file, which has no finer grid.
    """
    rows, columns = terrain.shape
    if not np.any(terrain == ROAD):
        return ["the map has no road, from which the network learned to find doors; frontier may be shorter"]
    if not is_town(terrain):
        return []
    width = street_width(terrain)
    lines = [
        f"the map shows a town, with streets of {width} of {max(rows, columns)} cells at most, and the network learned "
        "on single houses, with streets of a tenth or more; dc2g reads the surroundings of the robot"
    ]
    finer = round(columns * _STREET / width), round(rows * _STREET / width)
    if abs(width - _STREET) > 1 and finer[0] <= pixels[0] and finer[1] <= pixels[1]:
        lines.append(f"the narrowest streets there are {_STREET} cells wide: try --cells {finer[0]} {finer[1]}")
    return lines
