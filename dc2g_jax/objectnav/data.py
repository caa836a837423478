"""Training samples: partial maps of robots under way in known houses, beside the exact cost of the way (section III-A).

A sample is put together where it is used, on the device: of a journey is kept by when it had seen which cell, of a
house what is in each cell and how far it is from there to each kind of goal. A batch then is a matter of cutting out
and turning.
"""

import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Float16, Int, Int16, UInt8, UInt16

from dc2g_jax.objectnav.classes import GOALS, SEMANTIC_CLASSES
from dc2g_jax.objectnav.cost_maps import distance_for_vehicle
from dc2g_jax.objectnav.mapping import IndoorMapSettings, square
from dc2g_jax.objectnav.starts import ROBOT_RADIUS
from dc2g_jax.objectnav.worlds import IndoorWorld, Leaf

#: Cells along the sides of the local map and of the global one (section II-B), and how many of its cells along a side
#: one of the network's is the mean of.
LOCAL, GLOBAL = IndoorMapSettings.local, IndoorMapSettings.cells
POOL = GLOBAL // LOCAL

#: What is known of a cell, as one number: not explored, free floor, an obstacle without class; from then on, with one.
UNEXPLORED, FREE, OBSTACLE = 0, 1, 2

#: Distances are kept in whole millimeters; this one means that there is no way.
_NO_WAY = np.iinfo(np.uint16).max

#: How a map may be turned or mirrored: is it transposed, is then the order of its rows reversed, and that of its
#: columns? The first four are rotations, by 0, 90, 180 and 270 degrees to the left.
SYMMETRIES = ((0, 0, 0), (1, 1, 0), (0, 1, 1), (1, 0, 1), (0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 1))

#: Chances of the symmetries: none other than itself; the paper's (section III-D); all alike.
UPRIGHT = (1.0,) + (0.0,) * 7
PAPER_ROTATIONS = (0.85, 0.05, 0.05, 0.05) + (0.0,) * 4
ALL_SYMMETRIES = (0.125,) * 8

#: `(meters to the goal, navigable cells) -> cost`; both [h w]. Meters are of no meaning where a cell is not navigable.
Normalize = Callable[[Array, Array], Array]


def _metric(meters: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """Tens of meters to the goal."""
    del navigable
    return meters / 10


def _share(meters: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """Parts of the longest way from a cell of the local map."""
    return meters / jnp.maximum(jnp.max(jnp.where(navigable, meters, 0)), 1e-3)


def _relative(meters: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """Tens of meters by which the way is longer than that from the local map's best cell."""
    least = jnp.min(jnp.where(navigable, meters, jnp.inf))
    return (meters - jnp.where(jnp.isfinite(least), least, 0)) / 10


#: How distances become costs, by name. The paper says "normalized" and no more; `share` is what comes closest, as its
#: figures show costs from green to red in each map. It hides how long a meter is from map to map, which the other two
#: do not; `relative` does not ask for the one number about far places that a partial map says least about.
NORMALIZATIONS: Mapping[str, Normalize] = MappingProxyType({"share": _share, "metric": _metric, "relative": _relative})


@struct.dataclass
class JourneySet:
    """Houses, how far it is in them, and journeys through them.

    Attributes:
      cells: what is in each cell, see `cell_codes`.
      distance: from each free cell to the nearest goal of each kind, millimeters.
      house: of each journey.
      first_seen: by which view of a journey a cell had been seen, see `exploring.Journey`.
      places: row and column of the robot at each view.
      headings: where its camera looked, radians counter-clockwise from east.
      features: mid-level features of what it saw, and of its mirror image.
    """

    cells: UInt8[Leaf, "house h w"]
    distance: UInt16[Leaf, "house goal h w"]
    house: Int[Leaf, "journey"]
    first_seen: UInt8[Leaf, "journey h w"]
    places: Int16[Leaf, "journey view 2"]
    headings: Float[Leaf, "journey view"]
    features: Float16[Leaf, "journey view 2 f"]


@struct.dataclass
class Samples:
    """What a network is shown, and the right answer; see `dc2g_jax.objectnav.networks.apply`.

    Attributes:
      maps: the two maps, 255 standing for 1.
      target: index into `GOALS`.
      heading: radians.
      features: mid-level features.
      occupied: the local map's cells that are no free floor.
      cost: navigation cost of its free cells, infinite elsewhere and where no way leads to the goal.
    """

    maps: UInt8[Array, "*b 36 140 140"]
    target: Int[Array, "*b"]
    heading: Float[Array, "*b"]
    features: Float[Array, "*b f"]
    occupied: Bool[Array, "*b 140 140"]
    cost: Float[Array, "*b 140 140"]


def cell_codes(world: IndoorWorld) -> UInt8[Array, "*b h w"]:
    """What is in each cell of a house, once it is explored: `FREE`, `OBSTACLE`, or `OBSTACLE` + class.

    Outside it is `UNEXPLORED`: nothing there is ever seen.
    """
    standing = jnp.asarray(world.obstacle)
    codes = jnp.where(standing, OBSTACLE + jnp.asarray(world.classes), jnp.where(world.free, FREE, UNEXPLORED))
    return codes.astype(jnp.uint8)


def drive_to_goals(
    free: Bool[Array, "h w"], classes: UInt8[Array, "h w"], cell_size: float, radius: float = ROBOT_RADIUS
) -> Float[Array, "goal h w"]:
    """Meters that the middle of a round robot has to drive to the nearest goal of each kind (fast marching method).

    Args:
      free: floor of the house on which nothing stands.
      classes: of what stands in its cells.
      cell_size: meters.
      radius: of the robot, meters.

    Returns:
      float32; infinite where the robot does not fit and where no way leads to the goal.
    """
    return jax.lax.map(
        lambda goal: distance_for_vehicle(~free, (classes == goal) & ~free, radius, cell_size),
        jnp.asarray(GOALS, jnp.uint8),
    )


def in_millimeters(distance: Float[Array, "*n"]) -> UInt16[Array, "*n"]:
    """Distances as they are kept; those of 65 m and more are no way."""
    return jnp.where(distance < _NO_WAY / 1000, jnp.round(distance * 1000), _NO_WAY).astype(jnp.uint16)


def map_channels(codes: UInt8[Array, "h w"]) -> Bool[Array, "18 h w"]:
    """The semantic classes, obstacle, explored."""
    classes = OBSTACLE + 1 + jnp.arange(SEMANTIC_CLASSES, dtype=jnp.uint8)
    return jnp.concatenate([codes == classes[:, None, None], (codes >= OBSTACLE)[None], (codes != UNEXPLORED)[None]])


def network_maps(window: UInt8[Array, "420 420"]) -> UInt8[Array, "36 140 140"]:
    """The network's input from what is known around a robot, whose cell is at half the side: 255 stands for 1."""
    first = (GLOBAL - LOCAL) // 2
    local = map_channels(window[first : first + LOCAL, first : first + LOCAL])
    counts = sum(
        map_channels(window[down::POOL, right::POOL]).astype(jnp.uint16)
        for down in range(POOL)
        for right in range(POOL)
    )
    pooled = jnp.asarray(counts) * 255 // POOL**2
    return jnp.concatenate([local.astype(jnp.uint8) * jnp.uint8(255), pooled.astype(jnp.uint8)])


def turned_grid(grid: Array, symmetry: Int[Array, "3"]) -> Array:
    """A square grid in one of `SYMMETRIES`."""
    transposed, rows, columns = symmetry
    grid = jnp.where(transposed, jnp.swapaxes(grid, -1, -2), grid)
    grid = jnp.where(rows, jnp.flip(grid, -2), grid)
    return jnp.where(columns, jnp.flip(grid, -1), grid)


def turned_heading(heading: Float[Array, ""], symmetry: Int[Array, "3"]) -> Float[Array, ""]:
    """A heading on a map in one of `SYMMETRIES`."""
    transposed, rows, columns = symmetry
    east, north = jnp.cos(heading), jnp.sin(heading)
    east, north = jnp.where(transposed, -north, east), jnp.where(transposed, -east, north)
    return jnp.arctan2(jnp.where(rows, -north, north), jnp.where(columns, -east, east))


def make_sample(
    data: JourneySet,
    journey: Int[Array, ""],
    view: Int[Array, ""],
    target: Int[Array, ""],
    symmetry: Int[Array, "3"],
    normalize: Normalize,
) -> Samples:
    """What a robot knew at a view of its journey, and how far it was from there to a goal.

    Args:
      data: to take it from.
      journey: index.
      view: index.
      target: index into `GOALS`.
      symmetry: one of `SYMMETRIES`.
      normalize: distances to costs, see `NORMALIZATIONS`.
    """
    house, cell = data.house[journey], data.places[journey, view].astype(jnp.int32)
    known = jnp.where(data.first_seen[journey] <= view, data.cells[house], jnp.uint8(UNEXPLORED))

    def around(grid: Array, side: int, beyond: int) -> Array:
        return turned_grid(square(grid, cell - side // 2, side, beyond), symmetry)

    window = around(known, GLOBAL, UNEXPLORED)
    truth = around(data.cells[house], LOCAL, UNEXPLORED)
    way = around(data.distance[house, target], LOCAL, _NO_WAY)
    navigable = (truth == FREE) & (way != _NO_WAY)
    mirrored = jnp.sum(symmetry) % 2
    return Samples(
        maps=network_maps(window),
        target=target,
        heading=turned_heading(data.headings[journey, view], symmetry),
        features=data.features[journey, view, mirrored].astype(jnp.float32),
        occupied=truth != FREE,
        cost=jnp.where(navigable, normalize(way.astype(jnp.float32) / 1000, navigable), jnp.inf),
    )


def draw_samples(
    key: Array,
    data: JourneySet,
    *,
    batch_size: int,
    symmetries: tuple[float, ...],
    normalize: Normalize,
) -> Samples:
    """A random batch: any view of any journey, on the way to any goal that can be reached from there.

    Args:
      key: PRNG key.
      data: to draw from.
      batch_size: number of samples.
      symmetries: chance of each of `SYMMETRIES`.
      normalize: distances to costs, see `NORMALIZATIONS`.
    """
    journey_key, view_key, goal_key, turn_key = jax.random.split(key, 4)
    journeys, views = data.headings.shape
    journey = jax.random.randint(journey_key, (batch_size,), 0, journeys)
    view = jax.random.randint(view_key, (batch_size,), 0, views)
    cell = data.places[journey, view].astype(jnp.int32)
    distance = data.distance[data.house[journey], :, cell[:, 0], cell[:, 1]]
    target = jax.random.categorical(goal_key, jnp.where(distance != _NO_WAY, 0.0, -1e9))
    turn = jax.random.categorical(turn_key, jnp.log(jnp.asarray(symmetries) + 1e-30), shape=(batch_size,))
    symmetry = jnp.asarray(SYMMETRIES, jnp.int32)[turn]
    make = functools.partial(make_sample, normalize=normalize)
    return jax.vmap(make, in_axes=(None, 0, 0, 0, 0))(data, journey, view, target, symmetry)
