"""Three-dimensional scenes of house maps: ground at height 0, with obstacles on it.

A scene is a height field over tiles, five by five per cell of the map. An obstacle does not fill its cells: it stands
one tile inside their outline, on flat ground of its own class. A camera therefore sees every surface inside the cell
it belongs to, never on the border between two cells. World frame as in `mapping.camera`.

Obstacles (`SHAPES`):

- Houses have walls and a hipped roof; garage doors are part of the house. Cars have a body and a cabin. Fences and
  mailboxes are thin. Trees are conifers with branches down to the ground, because a height field has no underside.
- The cell of a front door is flat ground of that class, since it is the cell to drive to. Where it touches a house, a
  door leaf of the same class stands along that side, one tile deep, within the door's cell. A front door is therefore
  visible from afar, all its surfaces lie in its cell, and the middle of the cell is free for the robot.
- Everything else is flat. Class 0, unknown, is ground without label.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8
from scipy import ndimage

from dc2g_jax.grid import CLASS_NAMES, FRONT_DOOR

#: Side of a cell, meters. The paper does not give one. In the published training and validation images a parked car is
#: 43 pixels long (median of 13), so a pixel is 0.11 m and a cell of the 50 x 50 grid 0.5 to 2 m, 0.9 m in the median.
CELL_SIZE = 1.0

#: Tiles along a side of a cell. Odd, so that a robot in the middle of a cell never looks along a border of tiles.
TILES = 5

#: Height of a door leaf, meters.
LEAF_HEIGHT = 2.1


class Shape(NamedTuple):
    """Height profile of an obstacle, from its outline inward. The outermost ring of its tiles is flat.

    Attributes:
      rings: heights of the second ring, the third ring, and so on, meters.
      slope: rise further inward, meters per meter.
      top: largest height, meters.
    """

    rings: tuple[float, ...]
    slope: float = 0.0
    top: float = math.inf


_BUILDING = Shape(rings=(3.0,), slope=0.5, top=6.0)

#: Class name -> shape; all other classes are flat.
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
    """A height field over square tiles. Scenes of equal size can be stacked.

    Attributes:
      field: where positive, height of the tile above the ground, meters. Otherwise the tile is ground, and the value is
        minus its clearance: the number of rings of tiles around it that are ground as well.
      classes: class index of each tile, see `grid.CLASS_NAMES`.
      ceiling: height of the highest tile, meters.
      tile_size: side of a tile, meters.
    """

    field: Float[Array, "h w"]
    classes: UInt8[Array, "h w"]
    ceiling: Float[Array, ""]
    tile_size: Float[Array, ""]


def scene_from_terrain(terrain: UInt8[np.ndarray, "h w"], cell_size: float = CELL_SIZE) -> Scene:
    """The scene of a map, with `TILES` tiles along each side of a cell.

    Args:
      terrain: class index of every cell.
      cell_size: side of a cell, meters.
    """
    classes = terrain.repeat(TILES, axis=0).repeat(TILES, axis=1)
    heights = np.zeros(classes.shape)
    for shape in set(SHAPES.values()):
        heights += _heights(shape, _distance(_obstacles(classes, shape)), cell_size / TILES)
    heights[_door_leaves(classes)] = LEAF_HEIGHT
    return scene_from_heights(heights, classes, cell_size / TILES)


def scene_from_heights(heights: Float[np.ndarray, "h w"], classes: UInt8[np.ndarray, "h w"], tile_size: float) -> Scene:
    """The scene of tiles with the given heights above the ground, meters, none negative."""
    clearance = _distance(heights == 0) - 1
    return Scene(
        field=jnp.asarray(np.where(heights > 0, heights, -clearance), jnp.float32),
        classes=jnp.asarray(classes),
        ceiling=jnp.float32(heights.max()),
        tile_size=jnp.float32(tile_size),
    )


def _obstacles(classes: UInt8[np.ndarray, "h w"], shape: Shape) -> Bool[np.ndarray, "h w"]:
    """The tiles of all classes of this shape: adjacent classes of one shape form one obstacle."""
    return np.isin(classes, [CLASS_NAMES.index(name) for name in SHAPES if SHAPES[name] == shape])


def _door_leaves(classes: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Door tiles along a house except those at the ends, and the house tiles that close the gap to its wall."""
    doors, building = classes == FRONT_DOOR, _obstacles(classes, _BUILDING)
    leaves = doors & ndimage.binary_dilation(building) & (_distance(doors | building) > 1)
    return leaves | (building & ndimage.binary_dilation(leaves))


def _distance(tiles: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """Chebyshev distance of each tile of a set to the nearest tile outside the set; 0 outside.

    Space beyond the map does not count as outside. In a set of all tiles the distance is the longer side.
    """
    if tiles.all():
        return np.full(tiles.shape, max(tiles.shape))
    return ndimage.distance_transform_cdt(tiles, "chessboard").astype(np.int64)


def _heights(shape: Shape, ring: Int[np.ndarray, "h w"], tile_size: float) -> Float[np.ndarray, "h w"]:
    """Heights of tiles by their ring of the obstacle, meters; ring 1 is the outermost, 0 is outside the obstacle."""
    rings = np.array([0.0, 0.0, *shape.rings])
    rise = np.maximum(ring - (len(rings) - 1), 0) * tile_size * shape.slope
    return np.minimum(rings[np.minimum(ring, len(rings) - 1)] + rise, shape.top)
