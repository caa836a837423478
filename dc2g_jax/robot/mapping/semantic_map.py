"""A semantic voxel map built from depth images, and its projection to the planner's 2D map (paper, section III-C).

Each voxel has a log-odds of occupancy, updated and clamped as in OctoMap (Hornung et al., Autonomous Robots 2013), and
a class by vote of the frames. The map is dense, two bytes per voxel (three with more than 16 classes): 80 kB for
50 x 50 cells and 16 levels, 1.3 MB for 200 x 200 cells. A frame updates only the window of the map within the camera's
reach, so its cost depends on the reach and the image size, not on the map size. Integration temporarily needs 64 bytes
per voxel of the window and a few per pixel.

World frame, camera frame and units are those of `mapping.camera`. The lowest level is centered on the ground,
z = 0. All functions take one map; use `jax.vmap` for batches.
"""

import dataclasses
import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int8, Int32, UInt, UInt8

from dc2g_jax.grid import CLASS_BITS, CLASS_NAMES, NOTHING, UNKNOWN, shifted
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, Intrinsics, check_shapes, points, rays
from dc2g_jax.runtime import InputError

#: Log-odds are stored as integers, in units of 0.05. As in OctoMap, a hit adds 0.85, a miss subtracts 0.40, and the sum
#: stays within -2.0 and 3.5. A new voxel is occupied after one hit; one at the upper limit is free after nine misses.
HIT, MISS, LOWEST, HIGHEST = 17, 8, -40, 70

#: Log-odds of a voxel that no frame has observed.
UNSEEN = -128

#: Largest margin of a voxel's votes for its class over those against it.
MOST_CONFIDENT = 15

#: Largest number of voxels in a map: as many as 32-bit integers can count for each class.
_MOST_VOXELS = 2 ** (31 - CLASS_BITS) - 1

_CONFIDENCE_BITS = MOST_CONFIDENT.bit_length()

#: The smallest type that holds a class and a confidence.
_VOTES = np.min_scalar_type(2 ** (CLASS_BITS + _CONFIDENCE_BITS) - 1)


@struct.dataclass
class MapSettings:
    """Extent of a map and use of its camera. Hashable and static under `jit`.

    Attributes:
      rows: rows of the map.
      columns: columns of the map.
      cell_size: side of a cell, meters.
      levels: number of voxels above each cell.
      level_height: height of a voxel, meters; the lowest level is centered on the ground.
      reach: returns farther from the camera than this are skipped, meters.
      inset: a return counts for the voxel this far behind the surface, meters. Otherwise walls along the border of two
        cells would be assigned to either cell.
      clearance: voxels that begin higher above the ground than this are no obstacle, meters.
    """

    rows: int = struct.field(pytree_node=False)
    columns: int = struct.field(pytree_node=False)
    cell_size: float = struct.field(pytree_node=False)
    levels: int = struct.field(pytree_node=False, default=16)
    level_height: float = struct.field(pytree_node=False, default=0.25)
    reach: float = struct.field(pytree_node=False, default=10.0)
    inset: float = struct.field(pytree_node=False, default=0.05)
    clearance: float = struct.field(pytree_node=False, default=2.0)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Levels, rows and columns."""
        return self.levels, self.rows, self.columns


@struct.dataclass
class SemanticMap:
    """A voxel map.

    Attributes:
      log_odds: log-odds of occupancy, in units of 0.05; `UNSEEN` for unobserved voxels.
      votes: in the lower four bits, the margin in frames of the votes for the class over those for others, at most
        `MOST_CONFIDENT`; in the bits above, the class (0: none).
    """

    log_odds: Int8[Array, "levels h w"]
    votes: UInt[Array, "levels h w"]

    @property
    def occupied(self) -> Bool[Array, "levels h w"]:
        """Whether a voxel is more likely occupied than free."""
        return self.log_odds > 0

    @property
    def classes(self) -> UInt8[Array, "levels h w"]:
        """Class index of each voxel, 0 where it is free or has no label."""
        return (self.votes >> _CONFIDENCE_BITS).astype(jnp.uint8)

    @property
    def confidence(self) -> UInt8[Array, "levels h w"]:
        """Margin, in frames, of the votes for the class over the others."""
        return (self.votes & MOST_CONFIDENT).astype(jnp.uint8)


class _Window(NamedTuple):
    """A part of a map: its first level, row and column, and its shape."""

    corner: Int32[Array, "3"]
    shape: tuple[int, int, int]


def empty_map(settings: MapSettings) -> SemanticMap:
    """A map without observations.

    Raises:
      InputError: it would have too many voxels.
    """
    if math.prod(settings.shape) > _MOST_VOXELS:
        raise InputError(f"a map of {settings.shape} has more than {_MOST_VOXELS} voxels; make them larger or fewer")
    return SemanticMap(log_odds=jnp.full(settings.shape, UNSEEN, jnp.int8), votes=jnp.zeros(settings.shape, _VOTES))


def integrate(semantic_map: SemanticMap, frame: Frame, intrinsics: Intrinsics, settings: MapSettings) -> SemanticMap:
    """Integrate one frame into the map.

    A voxel that contains a return is hit. A voxel above the ground that the camera has looked through, to something
    farther away, is missed, so objects that have moved away are forgotten. Voxels of the ground are never missed. All
    returns in a voxel together cast one vote, for their most frequent class (ties to the smaller index). Votes of
    frames are counted as in the majority vote of Boyer and Moore. A free voxel has no class.

    Pixels without return are skipped, as are pixels whose depth is negative, not finite or out of reach. Points off the
    map are dropped. A pixel without label (0, or an invalid class index) marks a voxel as occupied without a vote for a
    class.

    Raises:
      InputError: the sizes of frame, intrinsics and settings do not match.
    """
    check_shapes(frame, intrinsics)
    if semantic_map.log_odds.shape != settings.shape:
        found = f"the map has shape {semantic_map.log_odds.shape}, but its settings say {settings.shape}"
        raise InputError(f"{found}; give the settings it was made with")
    window = _window(frame.pose, settings)
    in_reach = (frame.depth > 0) & (frame.depth * _ray_lengths(frame, intrinsics) <= settings.reach)
    frame = dataclasses.replace(frame, depth=jnp.where(in_reach, frame.depth, 0))
    counts = _counts(frame, intrinsics, settings, window)
    missed = _looked_through(frame, intrinsics, settings, window)
    before = jax.tree.map(lambda voxels: jax.lax.dynamic_slice(voxels, window.corner, window.shape), semantic_map)
    after = _updated(before, counts, missed)
    return jax.tree.map(
        lambda voxels, part: jax.lax.dynamic_update_slice(voxels, part, window.corner), semantic_map, after
    )


def terrain_map(semantic_map: SemanticMap, settings: MapSettings) -> UInt8[Array, "h w"]:
    """Project the map to the ground: the class index of every cell, as planners take it.

    See `grid.belief_from_map`. A cell with an obstacle within the clearance above the ground has the
    class with the most votes among the occupied voxels ("nothing" if none has a label). Any other cell has the class of
    its ground if that has been seen and has a label, else 0 (unknown).
    """
    end = sum((level - 0.5) * settings.level_height < settings.clearance for level in range(settings.levels))
    standing = semantic_map.occupied[1:end]
    classes, weight = semantic_map.classes[1:end], semantic_map.confidence[1:end].astype(jnp.int32) + 1
    counts = jnp.stack(
        [jnp.sum(jnp.where(standing & (classes == index), weight, 0), axis=0) for index in range(len(CLASS_NAMES))]
    )
    obstacle, labeled = _winner(counts)
    ground = jnp.where(semantic_map.occupied[0], semantic_map.classes[0], jnp.uint8(UNKNOWN))
    obstacle = jnp.where(labeled, obstacle, jnp.uint8(NOTHING))
    return jnp.where(jnp.any(standing, axis=0), obstacle, ground)


def _window(pose: CameraPose, settings: MapSettings) -> _Window:
    cells = math.ceil((settings.reach + settings.inset) / settings.cell_size)
    rows, columns = min(2 * cells + 1, settings.rows), min(2 * cells + 1, settings.columns)
    x, y = pose.position[0] / settings.cell_size, pose.position[1] / settings.cell_size
    first_row = jnp.clip(jnp.floor(-y) - cells, 0, settings.rows - rows)
    first_column = jnp.clip(jnp.floor(x) - cells, 0, settings.columns - columns)
    corner = jnp.nan_to_num(jnp.stack([jnp.zeros_like(x), first_row, first_column])).astype(jnp.int32)
    return _Window(corner, (settings.levels, rows, columns))


def _ray_lengths(frame: Frame, intrinsics: Intrinsics) -> Float[Array, "h w"]:
    """Meters from the camera for each meter of depth."""
    return jnp.sqrt(jnp.sum(jnp.square(rays(intrinsics, frame.pose)), axis=-1))


def _counts(
    frame: Frame, intrinsics: Intrinsics, settings: MapSettings, window: _Window
) -> Int32[Array, "class levels h w"]:
    """Number of returns of each class in each voxel of the window; class 0 counts returns without label."""
    booked = frame.depth + settings.inset / _ray_lengths(frame, intrinsics)
    x, y, z = jnp.moveaxis(points(booked, intrinsics, frame.pose), -1, 0)
    heights = z / settings.level_height + 0.5
    places = [heights, -y / settings.cell_size, x / settings.cell_size]
    labels = jnp.where(frame.classes < len(CLASS_NAMES), frame.classes, jnp.uint8(UNKNOWN))
    index, inside = labels.astype(jnp.int32), frame.depth > 0
    for place, first, size in zip(places, window.corner, window.shape, strict=True):
        # Compared as floats: large values do not fit into integers.
        offset = jnp.floor(place) - first
        inside &= (offset >= 0) & (offset < size)
        index = index * size + jnp.where(inside, offset, 0).astype(jnp.int32)
    size = len(CLASS_NAMES) * math.prod(window.shape)
    counts = jnp.zeros(size, jnp.int32).at[jnp.where(inside, index, size)].add(1, mode="drop")
    return counts.reshape(len(CLASS_NAMES), *window.shape)


def _looked_through(
    frame: Frame, intrinsics: Intrinsics, settings: MapSettings, window: _Window
) -> Bool[Array, "levels h w"]:
    """Voxels of the window above the ground that the camera has looked through.

    The whole voxel must lie in front of the surface in the pixel of its center and in the eight pixels around it: where
    rays graze a surface, depth may change by more than a voxel between two pixels.
    """
    levels, rows, columns = (jnp.arange(size) for size in window.shape)
    x = (columns + window.corner[2] + 0.5) * settings.cell_size - frame.pose.position[0]
    y = -(rows[:, None] + window.corner[1] + 0.5) * settings.cell_size - frame.pose.position[1]
    z = levels[:, None, None] * settings.level_height - frame.pose.position[2]
    right, down, forward = (x * axis[0] + y * axis[1] + z * axis[2] for axis in frame.pose.rotation.T)
    column = jnp.round(right / forward * intrinsics.focal_x + intrinsics.center_x)
    row = jnp.round(down / forward * intrinsics.focal_y + intrinsics.center_y)
    in_image = (column >= 0) & (column < intrinsics.width) & (row >= 0) & (row < intrinsics.height)
    in_view = in_image & (forward > 0) & (right**2 + down**2 + forward**2 <= settings.reach**2)
    row, column = (jnp.where(in_view, place, 0).astype(jnp.int32) for place in (row, column))
    returned = frame.depth > 0
    nearest = jnp.where(returned, _nearest_around(jnp.where(returned, frame.depth, jnp.inf)), 0)
    half_diagonal = math.hypot(settings.cell_size, settings.cell_size, settings.level_height) / 2
    return in_view & (forward + half_diagonal < nearest[row, column]) & (levels[:, None, None] > 0)


def _nearest_around(depth: Float[Array, "h w"]) -> Float[Array, "h w"]:
    in_row = functools.reduce(jnp.minimum, (shifted(depth, offset, 0, jnp.inf) for offset in (-1, 0, 1)))
    return functools.reduce(jnp.minimum, (shifted(in_row, 0, offset, jnp.inf) for offset in (-1, 0, 1)))


def _updated(
    before: SemanticMap, counts: Int32[Array, "class levels h w"], missed: Bool[Array, "levels h w"]
) -> SemanticMap:
    """The voxels after one frame. A voxel that is both hit and missed is hit, as in OctoMap."""
    hit = jnp.any(counts > 0, axis=0)
    known = jnp.where(before.log_odds == UNSEEN, 0, before.log_odds.astype(jnp.int32))
    changed = jnp.clip(known + jnp.where(hit, HIT, -MISS), LOWEST, HIGHEST).astype(jnp.int8)
    log_odds = jnp.where(hit | missed, changed, before.log_odds)

    winner, labeled = _winner(counts)
    undecided = before.confidence == 0
    gained = jnp.minimum(before.confidence, MOST_CONFIDENT - 1) + 1
    confidence = jnp.where(undecided | (winner == before.classes), gained, before.confidence - 1)
    voted = jnp.where(undecided, winner, before.classes).astype(_VOTES) << _CONFIDENCE_BITS | confidence
    votes = jnp.where(labeled, voted, before.votes)
    return SemanticMap(log_odds=log_odds, votes=jnp.where(log_odds > 0, votes, 0))


def _winner(counts: Int32[Array, "class *shape"]) -> tuple[UInt8[Array, "*shape"], Bool[Array, "*shape"]]:
    """The class other than 0 with the largest count (ties to the smaller index), and whether any count is positive."""
    last = 2**CLASS_BITS - 1
    from_last = last - jnp.arange(1, len(CLASS_NAMES)).reshape(-1, *(1,) * (counts.ndim - 1))
    # A maximum over count and class combined: an argmax is far slower.
    best = jnp.max(counts[1:] << CLASS_BITS | from_last, axis=0)
    return (last - (best & last)).astype(jnp.uint8), best > last


def check_frame(frame: Frame, settings: MapSettings) -> None:
    """Check values of a frame that `integrate` would skip without a word. Runs on the host.

    Raises:
      InputError: the camera is not above the map, or a class does not exist.
    """
    x, y, z = np.asarray(frame.pose.position).tolist()
    east, south = settings.columns * settings.cell_size, settings.rows * settings.cell_size
    if not (0 <= x <= east and -south <= y <= 0 and z > 0):
        raise InputError(
            f"the camera is at x {x:g}, y {y:g}, z {z:g}, not above the ground of the map, x 0 to {east:g} and y "
            f"{-south:g} to 0; give meters in the map's frame, whose y is 0 above the first row and ground z = 0"
        )
    classes = np.asarray(frame.classes)
    for row, column in np.argwhere(classes >= len(CLASS_NAMES))[:1]:
        raise InputError(
            f"classes[{row}, {column}] is {classes[row, column]}; give class indices from 0 (no label) to "
            f"{len(CLASS_NAMES) - 1}, see dc2g_jax.grid.CLASS_NAMES"
        )
