"""A house map as a scene in three dimensions: ground at height 0, and obstacles that stand up from it.

The scene is a height field over tiles, five by five to a cell of the map, so that an obstacle need not fill its cells:
it stands one tile inside their outline, on flat ground of its own class. A camera therefore finds every surface inside
the cell it belongs to, never on the border between two. World frame as in `dc2g_jax.mapping.camera`.

What stands where (`SHAPES`):

- Houses have walls and a hipped roof, and garage doors are part of them; cars have a body and a cabin. Fences and
  mailboxes are thin. Trees are conifers with branches down to the ground: a height field has no underside.
- A front door is ground, as on the map, where it is the cell to drive to: a mat of that class. Where its cell touches a
  house, a door leaf of the same class stands along that side, one tile deep, within the door's own cell. So a front
  door is seen from afar, all that is seen of it lies in its cell, and the cell's middle is free to stand on.
- Everything else is flat. Class 0, unknown, is ground that bears no label.
"""

import math
from typing import NamedTuple

import cv2
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax.errors import InputError
from dc2g_jax.grid.terrain import CLASS_NAMES, FRONT_DOOR

#: Side of a cell, meters. The paper gives none. In the published training and validation pictures a parked car is 43
#: pixels long (median of 13), so a pixel is 0.11 m, and a cell of the 50 x 50 grid 0.5 to 2 m, 0.9 m in the median.
CELL_SIZE = 1.0

#: Tiles along a side of a cell. Odd, so that a robot in the middle of a cell looks along no border of tiles.
TILES = 5

#: Height of a door leaf, meters.
LEAF_HEIGHT = 2.1


class Shape(NamedTuple):
    """How high an obstacle is, from its outline inward. The outermost ring of its tiles is flat.

    Attributes:
      rings: heights of the second ring, of the next one, and so on, meters.
      slope: what it rises further inward, meters a meter.
      top: where that ends, meters.
    """

    rings: tuple[float, ...]
    slope: float = 0.0
    top: float = math.inf


_BUILDING = Shape(rings=(3.0,), slope=0.5, top=6.0)

#: Class name -> shape; a class that is not among them is flat.
SHAPES: dict[str, Shape] = {
    "house": _BUILDING,
    "garage door": _BUILDING,
    "car": Shape(rings=(0.85, 1.45)),
    "fence": Shape(rings=(0.0, 1.2)),
    "tree": Shape(rings=(1.5,), slope=5.0, top=7.0),
    "mailbox": Shape(rings=(0.0, 1.1)),
    "bush": Shape(rings=(0.8,), slope=0.5, top=1.2),
}


@struct.dataclass
class Scene:
    """A height field over square tiles. Scenes of one size can be stacked.

    Attributes:
      field: height of each tile above the ground where positive, meters. Elsewhere the tile is ground, and this is
        minus its clearance: how many rings of tiles around it are ground as well.
      classes: class index of each tile, see `dc2g_jax.grid.terrain`.
      ceiling: height of the highest tile, meters.
      tile_size: side of a tile, meters.
    """

    field: Float[Array, "h w"]
    classes: UInt8[Array, "h w"]
    ceiling: Float[Array, ""]
    tile_size: Float[Array, ""]


def scene_from_terrain(terrain: UInt8[np.ndarray, "h w"], cell_size: float = CELL_SIZE) -> Scene:
    """The scene of a map, `TILES` times as many tiles along each side as the map has cells.

    Args:
      terrain: class index of every cell.
      cell_size: side of a cell, meters.

    Raises:
      InputError: the map is empty or holds numbers that are no class, or cells have no size.
    """
    if terrain.size == 0 or int(terrain.max()) >= len(CLASS_NAMES):
        found = f"the number {terrain.max()}" if terrain.size else "no cells"
        raise InputError(f"terrain has {found}; give a grid of class indices from 0 to {len(CLASS_NAMES) - 1}")
    if not (math.isfinite(cell_size) and cell_size > 0):
        raise InputError(f"cell size {cell_size}: give the meters of a cell, such as {CELL_SIZE}")
    classes = terrain.repeat(TILES, axis=0).repeat(TILES, axis=1)
    heights = np.zeros(classes.shape)
    for shape in set(SHAPES.values()):
        heights += _heights(shape, _distance(_obstacles(classes, shape)), cell_size / TILES)
    heights[_door_leaves(classes)] = LEAF_HEIGHT
    return scene_from_heights(heights, classes, cell_size / TILES)


def scene_from_heights(heights: Float[np.ndarray, "h w"], classes: UInt8[np.ndarray, "h w"], tile_size: float) -> Scene:
    """The scene in which each tile is as high as it is said to be.

    Args:
      heights: of the tiles above the ground, meters, none negative.
      classes: class index of every tile.
      tile_size: side of a tile, meters.
    """
    clearance = _distance(heights == 0) - 1
    return Scene(
        field=jnp.asarray(np.where(heights > 0, heights, -clearance), jnp.float32),
        classes=jnp.asarray(classes),
        ceiling=jnp.float32(heights.max()),
        tile_size=jnp.float32(tile_size),
    )


def _obstacles(classes: UInt8[np.ndarray, "h w"], shape: Shape) -> Bool[np.ndarray, "h w"]:
    """The tiles of all classes of this shape: side by side, they stand as one."""
    return np.isin(classes, [CLASS_NAMES.index(name) for name in SHAPES if SHAPES[name] == shape])


def _door_leaves(classes: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Door tiles along a house, but those at the ends, and the house's own tiles that close the gap to its wall."""
    doors, building = classes == FRONT_DOOR, _obstacles(classes, _BUILDING)
    leaves = doors & _beside(building) & (_distance(doors | building) > 1)
    return leaves | (building & _beside(leaves))


def _beside(tiles: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The tiles of a set and those that share a side with one of them."""
    return cv2.dilate(tiles.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))).astype(bool)


def _distance(tiles: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """How many king's moves each tile of a set is from the nearest tile outside it; 0 outside.

    What lies beyond the map does not count as outside. In a set of all tiles the distance is the longer side.
    """
    moves = cv2.distanceTransform(tiles.astype(np.uint8), cv2.DIST_C, 3)
    return np.minimum(moves, max(tiles.shape)).astype(np.int64)


def _heights(shape: Shape, ring: Int[np.ndarray, "h w"], tile_size: float) -> Float[np.ndarray, "h w"]:
    """The height of tiles on these rings of an obstacle, 1 being the outermost, and 0 what is no part of it; meters."""
    rings = np.array([0.0, 0.0, *shape.rings])
    rise = np.maximum(ring - (len(rings) - 1), 0) * tile_size * shape.slope
    return np.minimum(rings[np.minimum(ring, len(rings) - 1)] + rise, shape.top)
