"""The robot's map of a house: 16 semantic classes, obstacles and explored cells.

See section II-A of the paper on dense cost maps.

Pixels with depth and class are points in the world. A cell has the classes of all its points, is an obstacle once one
of its points lies at a height where the robot could hit it, and is explored once it has any point or its floor has been
in view. These 18 binary channels are stored as bits of one integer per cell and unpacked on demand: 0.7 MB for
420 x 420 cells, instead of 12.7 MB for 18 channels of floats.

If labels may be wrong, let frames vote: a cell then has the classes that recent frames agree on
(`IndoorMapSettings.votes`).

The cells of the map are those of the world's grid (`houses.worlds`). The robot starts in the middle of the
map. The map does not rotate with the robot. All functions take one robot; use `jax.vmap` for batches.
"""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Shaped, UInt32

from dc2g_jax.indoor.maps.classes import SEMANTIC_CLASSES
from dc2g_jax.robot import Frame, Intrinsics, cell_at, check_shapes, points, rays

#: Channels of a map: the classes (class index 1 + channel), then obstacles, then explored cells.
OBSTACLE_CHANNEL, EXPLORED_CHANNEL = SEMANTIC_CLASSES, SEMANTIC_CLASSES + 1
MAP_CHANNELS = SEMANTIC_CLASSES + 2
#: All classes of a cell.
_CLASSES = np.uint32((1 << SEMANTIC_CLASSES) - 1)
#: Floor within this distance counts as explored, meters. The camera never sees it, and robots would return to look.
FOOTROOM = 0.6
#: The bit at which the high bits of the votes begin; and the share of a cell's points in a frame that a class must
#: exceed to get the frame's vote.
_HIGH, _LEAST_SHARE = 16, 0.2

if SEMANTIC_CLASSES > _HIGH:
    raise ValueError(
        f"{SEMANTIC_CLASSES} indoor classes: the votes of a cell have 32 bits, enough for 16 classes; merge some"
    )


@struct.dataclass
class IndoorMapSettings:
    """Extent and thresholds of a map. Static under `jit`.

    Attributes:
      cells: cells along each side of the map. The paper has 420.
      local: cells along each side of the local map around the robot, a divisor of `cells`. The paper has 140.
      cell_size: edge of a cell, meters. The paper does not give it. ProcTHOR's largest houses are 28 m long, so the
        default here is 10 cm, and the map is 42 m wide.
      reach: returns farther from the camera than this are skipped, meters.
      lowest: points lower than this above the floor are no obstacles, meters.
      highest: points higher than this, the height of the robot, are no obstacles, meters.
      inset: a return nearer than this to the cell behind it counts for that cell, meters.
      votes: number of votes that a class needs in a cell. With 1, for labels without errors, there is no vote: a single
        point gives its class to the cell. With 2 or 3, the frames that show the cell vote: each that shows the class
        there adds one vote, up to 3, and each other one takes one away.
    """

    cells: int = struct.field(pytree_node=False, default=420)
    local: int = struct.field(pytree_node=False, default=140)
    cell_size: float = struct.field(pytree_node=False, default=0.1)
    reach: float = struct.field(pytree_node=False, default=5.0)
    lowest: float = struct.field(pytree_node=False, default=0.1)
    highest: float = struct.field(pytree_node=False, default=1.5)
    inset: float = struct.field(pytree_node=False, default=0.001)
    votes: int = struct.field(pytree_node=False, default=1)

    @property
    def window(self) -> int:
        """Side of the part of the map that one frame can change, in cells."""
        return min(2 * math.ceil((self.reach + self.inset) / self.cell_size) + 1, self.cells)


@struct.dataclass
class IndoorMap:
    """A robot's map of a house.

    Attributes:
      cells: the channels of each cell, one bit per channel, channel 0 in the lowest bit.
      origin: row and column of the first cell in the world's grid; they may be negative.
      votes: number of votes for each class, 0 to 3: its low bit in the lower 16 bits, its high bit in the upper ones;
        `None` without votes.
    """

    cells: UInt32[Array, "h w"]
    origin: Int[Array, "2"]
    votes: UInt32[Array, "h w"] | None = None


def empty_map(position: Float[Array, "2"], settings: IndoorMapSettings) -> IndoorMap:
    """A map without observations, centered on the robot's start (x and y, meters)."""
    origin = grid_cell(position, settings.cell_size) - settings.cells // 2
    empty = jnp.zeros((settings.cells, settings.cells), jnp.uint32)
    return IndoorMap(empty, origin, empty if settings.votes > 1 else None)


def grid_cell(position: Float[Array, "2"], cell_size: float) -> Int[Array, "2"]:
    """Row and column of the cell that contains a position (x and y, meters)."""
    return cell_at(position, cell_size)[::-1]


def has(cells: UInt32[Array, "h w"], channel: ArrayLike) -> Bool[Array, "h w"]:
    """One channel of the cells."""
    return (cells >> jnp.asarray(channel, jnp.uint32)) & 1 == 1


def has_any_class(cells: UInt32[Array, "h w"]) -> Bool[Array, "h w"]:
    """Cells in which any class has been seen. Obstacles without class are walls."""
    return cells & _CLASSES > 0


def with_frame(
    indoor_map: IndoorMap, frame: Frame, position: Float[Array, "2"], camera: Intrinsics, settings: IndoorMapSettings
) -> IndoorMap:
    """The map of a robot at a position (x and y, meters) after one more frame, see `integrate` and `mark_explored`."""
    return mark_explored(integrate(indoor_map, frame, camera, settings), position, FOOTROOM, settings)


def integrate(indoor_map: IndoorMap, frame: Frame, intrinsics: Intrinsics, settings: IndoorMapSettings) -> IndoorMap:
    """Integrate one frame into the map. Pixels without return, or with a return out of reach, are skipped.

    A cell whose floor is in view, without anything that the robot could hit, loses its obstacle and classes. This
    corrects points that were assigned to a neighboring cell.

    Raises:
      InputError: the sizes of frame and intrinsics do not match.
    """
    check_shapes(frame, intrinsics)
    side = settings.window
    middle = grid_cell(frame.pose.position[:2], settings.cell_size) - indoor_map.origin
    corner = jnp.clip(middle - side // 2, 0, settings.cells - side)
    lengths = jnp.linalg.norm(rays(intrinsics, frame.pose), axis=-1)
    usable = (frame.depth > 0) & (frame.depth * lengths <= settings.reach)
    found = _found(frame, intrinsics, usable, corner + indoor_map.origin, settings)
    floor = _floor_in_view(frame, intrinsics, usable, corner + indoor_map.origin, settings)
    cleared = floor & ~has(found, OBSTACLE_CHANNEL)
    before = jax.lax.dynamic_slice(indoor_map.cells, corner, (side, side))
    after = jnp.where(cleared, 0, before) | found | (floor.astype(jnp.uint32) << EXPLORED_CHANNEL)
    votes = indoor_map.votes
    if votes is not None:
        own = _voted(jax.lax.dynamic_slice(votes, corner, (side, side)), found, cleared)
        votes = jax.lax.dynamic_update_slice(votes, own, corner)
        enough = own >> _HIGH if settings.votes == 2 else (own >> _HIGH) & own
        after = (after & ~_CLASSES) | (enough & _CLASSES)
    return dataclasses.replace(
        indoor_map, cells=jax.lax.dynamic_update_slice(indoor_map.cells, after, corner), votes=votes
    )


def _voted(
    votes: UInt32[Array, "n n"], found: UInt32[Array, "n n"], cleared: Bool[Array, "n n"]
) -> UInt32[Array, "n n"]:
    """The votes after a frame that shows these channels, see `IndoorMap.votes`."""
    low, high, shown = votes & _CLASSES, votes >> _HIGH, found & _CLASSES
    missed = jnp.where(has(found, EXPLORED_CHANNEL), _CLASSES & ~shown, 0)
    same = ~(shown | missed)
    # One more vote, up to 3, where a class is shown; one less, down to 0, where it is missed.
    after_low = (low & same) | (shown & (~low | high)) | (missed & high & ~low)
    after_high = (high & same) | (shown & (high | low)) | (missed & high & low)
    return jnp.where(cleared, 0, after_low | (after_high << _HIGH))


def _found(
    frame: Frame, intrinsics: Intrinsics, usable: Bool[Array, "height width"], corner: Int[Array, "2"],
    settings: IndoorMapSettings,
) -> UInt32[Array, "n n"]:  # fmt: skip
    """The channels that a frame's points set in a window, given the window's first cell in the world's grid."""
    side = settings.window
    shown = points(frame.depth, intrinsics, frame.pose)
    row, column = _booked(shown, frame.pose.position, settings) - corner[:, None, None]
    z = shown[..., 2]
    inside = usable & (row >= 0) & (row < side) & (column >= 0) & (column < side)
    hits = (z > settings.lowest) & (z < settings.highest)
    label = jnp.where(frame.classes <= SEMANTIC_CLASSES, frame.classes, 0).astype(jnp.int32)
    # One scatter: how many points of each class a cell has; points that the robot could hit are counted separately.
    kinds = (2, SEMANTIC_CLASSES + 1, side, side)
    place = jnp.ravel_multi_index((hits.astype(jnp.int32), label, row, column), kinds, mode="clip")
    counts = jnp.zeros(math.prod(kinds), jnp.uint32).at[jnp.where(inside, place, math.prod(kinds))].add(1, mode="drop")
    counts = counts.reshape(kinds)
    of_class, obstacle = counts[0] + counts[1], jnp.any(counts[1] > 0, axis=0)
    total = jnp.sum(of_class, axis=0, dtype=jnp.uint32)
    classes = of_class > (_LEAST_SHARE if settings.votes > 1 else 0) * total
    bits = enumerate([*classes[1:], obstacle, total > 0])
    return functools.reduce(jnp.bitwise_or, (cells.astype(jnp.uint32) << number for number, cells in bits))


def _booked(
    shown: Float[Array, "height width 3"], origin: Float[Array, "3"], settings: IndoorMapSettings
) -> Int[Array, "2 height width"]:
    """Row and column of the cell to which each point is assigned.

    A surface between two cells belongs to the cell behind it, as seen from the camera. A point is moved only across the
    border nearest to it. If it were moved along its ray, a point at the edge of a wall could pass the wall's end.
    """
    scale = jnp.array([-1, 1], jnp.float32) / settings.cell_size
    place = shown[..., 1::-1] * scale
    behind = jnp.sign(place - origin[1::-1] * scale) * (settings.inset / settings.cell_size)
    off_border = jnp.abs(place - jnp.round(place))
    across = off_border <= off_border[..., ::-1]
    return jnp.moveaxis(jnp.floor(place + jnp.where(across, behind, 0)).astype(jnp.int32), -1, 0)


def _floor_in_view(
    frame: Frame, intrinsics: Intrinsics, usable: Bool[Array, "height width"], corner: Int[Array, "2"],
    settings: IndoorMapSettings,
) -> Bool[Array, "n n"]:  # fmt: skip
    """Cells of the window whose center is visible floor.

    Far away, rows of pixels are several cells apart. The floor of a cell is visible if the pixel above its center shows
    something behind it.
    """
    along = jnp.arange(settings.window)
    x = (along + corner[1] + 0.5) * settings.cell_size - frame.pose.position[0]
    y = -(along[:, None] + corner[0] + 0.5) * settings.cell_size - frame.pose.position[1]
    right, down, forward = (
        x * axis[0] + y * axis[1] - frame.pose.position[2] * axis[2] for axis in frame.pose.rotation.T
    )
    column = jnp.round(right / forward * intrinsics.focal_x + intrinsics.center_x)
    row = jnp.floor(down / forward * intrinsics.focal_y + intrinsics.center_y)
    in_view = (column >= 0) & (column < intrinsics.width) & (row >= 0) & (row < intrinsics.height) & (forward > 0)
    row, column = (jnp.where(in_view, place, 0).astype(jnp.int32) for place in (row, column))
    return in_view & usable[row, column] & (frame.depth[row, column] >= forward)


def mark_explored(
    indoor_map: IndoorMap, position: Float[Array, "2"], radius: float, settings: IndoorMapSettings
) -> IndoorMap:
    """Mark the cells around the robot as explored, whether it has seen them or not.

    Obstacles and classes do not change. Cells behind a nearby wall are marked as well.
    """
    rings = math.ceil(radius / settings.cell_size)
    offsets = jnp.stack(jnp.meshgrid(*2 * (jnp.arange(-rings, rings + 1),), indexing="ij"), axis=-1)
    cells = grid_cell(position, settings.cell_size) + offsets
    middles = (cells[..., ::-1] + 0.5) * jnp.array([1, -1], jnp.float32) * settings.cell_size
    covered = jnp.linalg.norm(middles - position, axis=-1) <= radius
    row, column = jnp.moveaxis(cells - indoor_map.origin, -1, 0)
    marked = indoor_map.cells.at[row, column].get(mode="clip") | jnp.uint32(1 << EXPLORED_CHANNEL)
    there = indoor_map.cells.at[jnp.where(covered, row, settings.cells), column]
    return dataclasses.replace(indoor_map, cells=there.set(marked, mode="drop", wrap_negative_indices=False))


def window(indoor_map: IndoorMap, middle: Int[Array, "2"], side: int) -> UInt32[Array, "side side"]:
    """A square of cells around a cell of the world's grid, which is at index `side // 2`. Cells off the map are 0.

    Args:
      indoor_map: the map.
      middle: row and column in the world's grid.
      side: side of the square, cells.
    """
    return square(indoor_map.cells, middle - side // 2 - indoor_map.origin, side, 0)


def square(grid: Shaped[Array, "h w"], first: Int[Array, "2"], side: int, beyond: float) -> Shaped[Array, "side side"]:
    """The square of a grid from row and column `first` on; cells off the grid have the value `beyond`."""
    rows, columns = first[:, None] + jnp.arange(side)
    return grid.at[rows[:, None], columns].get(mode="fill", fill_value=beyond, wrap_negative_indices=False)


def network_maps(cells: UInt32[Array, "n n"], local: int) -> Float[Array, "36 local local"]:
    """The network's input (section II-B): the channels of the local map, then those of the global map.

    The global map shows all cells, averaged to the size of the local map. Both are centered on the robot and not
    rotated. Training and search use this function.

    Args:
      cells: all cells of a map around the robot, which is at half the side.
      local: side of the local map, a divisor of the map's.
    """
    side = len(cells)
    pool, first = side // local, side // 2 - local // 2
    channels = jnp.arange(MAP_CHANNELS, dtype=jnp.uint32)
    near = cells[first : first + local, first : first + local]
    squares = cells.reshape(local, pool, local, pool)
    bits = (squares >> channels[:, None, None, None, None]) & 1
    pooled = jnp.sum(bits, axis=(2, 4), dtype=jnp.uint32).astype(jnp.float32) / pool**2
    return jnp.concatenate([((near >> channels[:, None, None]) & 1).astype(jnp.float32), pooled])
