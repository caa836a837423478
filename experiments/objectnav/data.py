"""Training samples: partial maps of robots in known houses, and the exact cost of the path to a goal (section III-A).

Samples are made on the device when they are needed. The data set holds when each journey first showed each cell, the
content of the cells of each house, and their distances to each kind of goal. A sample is a crop of these, turned by one
of the symmetries.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Float16, Int, Int16, UInt8, UInt16, UInt32

from dc2g_jax.indoor.houses.worlds import IndoorWorld
from dc2g_jax.indoor.maps.cost_maps import Cells
from dc2g_jax.indoor.maps.mapping import EXPLORED_CHANNEL, OBSTACLE_CHANNEL, IndoorMapSettings, has, square
from dc2g_jax.training import turned

#: Sides of the local and the global map in cells (section II-B).
LOCAL, GLOBAL = IndoorMapSettings.local, IndoorMapSettings.cells

#: Stands for an infinite distance. Distances are stored in whole millimeters.
_UNREACHABLE = np.iinfo(np.uint16).max

#: Symmetries of a map, see `training.turned`. The first four are rotations by 0, 90, 180 and 270 degrees
#: counter-clockwise.
SYMMETRIES = (0, 5, 3, 6, 1, 2, 4, 7)

#: Probabilities of the symmetries: always the identity; the paper's (section III-D); uniform.
UPRIGHT = (1.0,) + (0.0,) * 7
PAPER_ROTATIONS = (0.85, 0.05, 0.05, 0.05) + (0.0,) * 4
ALL_SYMMETRIES = (0.125,) * 8

#: `(meters to the goal, navigable cells) -> cost`; both [h w]. Meters are arbitrary in cells that are not navigable.
Normalize = Callable[[Array, Array], Array]


def _share(meters: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """Shares of the longest path from a cell of the local map."""
    return meters / jnp.maximum(jnp.max(jnp.where(navigable, meters, 0)), 1e-3)


def _relative(meters: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """Tens of meters in addition to the path from the local map's best cell."""
    least = jnp.min(jnp.where(navigable, meters, jnp.inf))
    return (meters - jnp.where(jnp.isfinite(least), least, 0)) / 10


#: Functions from distances to costs, by name. The paper only says "normalized". `share` is the closest, as the paper's
#: figures show costs from green to red in each map, but its scale differs from map to map. `relative` has a
#: fixed scale, and does not ask for the distance of far goals, about which a partial map says least.
NORMALIZATIONS: dict[str, Normalize] = {"share": _share, "relative": _relative}


@struct.dataclass
class JourneySet:
    """Houses, their distances to goals, and journeys through them.

    Attributes:
      cells: cells of the houses, see `map_of`.
      distance: distance from each free cell to the nearest goal of each class, millimeters.
      house: house of each journey.
      first_seen: number of the view that first showed each cell, see `learning.collecting.Journey`.
      places: row and column of the robot at each view.
      headings: direction of the camera, counter-clockwise from east, radians.
      features: mid-level features of each camera image and of its mirror image.
    """

    cells: UInt32[Cells, "house h w"]
    distance: UInt16[Cells, "house goal h w"]
    house: Int[Cells, "journey"]
    first_seen: UInt8[Cells, "journey h w"]
    places: Int16[Cells, "journey view 2"]
    headings: Float[Cells, "journey view"]
    features: Float16[Cells, "journey view 2 f"]


@struct.dataclass
class Samples:
    """Inputs of a network, see `learning.networks.CostMapNetwork`, and labels.

    Attributes:
      cells: the robot's map around it, of which `maps.mapping.network_maps` makes the network's maps.
      target: the wanted class, an index into `GOALS`.
      heading: direction of the camera, radians.
      features: mid-level features.
      occupied: cells of the local map that are not free floor.
      cost: navigation cost of its free cells; infinite elsewhere and where no path leads to the goal.
    """

    cells: UInt32[Array, "*b 420 420"]
    target: Int[Array, "*b"]
    heading: Float[Array, "*b"]
    features: Float[Array, "*b f"]
    occupied: Bool[Array, "*b 140 140"]
    cost: Float[Array, "*b 140 140"]


def map_of(world: IndoorWorld) -> UInt32[Array, "*b h w"]:
    """The cells of a robot's map of a fully explored house, see `maps.mapping.IndoorMap`. The outside is never seen."""
    standing, kind = jnp.asarray(world.obstacle), jnp.asarray(world.classes, jnp.uint32)
    seen = (standing | jnp.asarray(world.free)).astype(jnp.uint32)
    labeled = jnp.where(kind > 0, jnp.uint32(1) << jnp.maximum(kind, 1) - 1, jnp.uint32(0))
    return seen << EXPLORED_CHANNEL | standing.astype(jnp.uint32) << OBSTACLE_CHANNEL | labeled


def in_millimeters(distance: Float[Array, "*n"]) -> UInt16[Array, "*n"]:
    """Distances in meters as stored in the data set. Distances of 65 m and more count as infinite."""
    return jnp.where(distance < _UNREACHABLE / 1000, jnp.round(distance * 1000), _UNREACHABLE).astype(jnp.uint16)


def turned_heading(heading: Float[Array, ""], symmetry: Int[Array, ""]) -> Float[Array, ""]:
    """A heading on a map in one of `SYMMETRIES`."""
    east, north = jnp.cos(heading), jnp.sin(heading)
    east, north = jnp.where(symmetry & 1, -east, east), jnp.where(symmetry & 2, -north, north)
    return jnp.arctan2(jnp.where(symmetry & 4, -east, north), jnp.where(symmetry & 4, -north, east))


def make_sample(
    data: JourneySet,
    journey: Int[Array, ""],
    view: Int[Array, ""],
    target: Int[Array, ""],
    symmetry: Int[Array, ""],
    normalize: Normalize,
) -> Samples:
    """The inputs of a network at a view of a journey, and the labels for a goal, in one of `SYMMETRIES`."""
    house, cell = data.house[journey], data.places[journey, view].astype(jnp.int32)
    known = jnp.where(data.first_seen[journey] <= view, data.cells[house], jnp.uint32(0))

    def around(grid: Array, side: int, beyond: int) -> Array:
        return turned(square(grid, cell - side // 2, side, beyond), symmetry)

    truth = around(data.cells[house], LOCAL, 0)
    free = has(truth, EXPLORED_CHANNEL) & ~has(truth, OBSTACLE_CHANNEL)
    distance = around(data.distance[house, target], LOCAL, _UNREACHABLE)
    navigable = free & (distance != _UNREACHABLE)
    mirrored = jax.lax.population_count(symmetry) % 2
    return Samples(
        cells=around(known, GLOBAL, 0),
        target=target,
        heading=turned_heading(data.headings[journey, view], symmetry),
        features=data.features[journey, view, mirrored].astype(jnp.float32),
        occupied=~free,
        cost=jnp.where(navigable, normalize(distance.astype(jnp.float32) / 1000, navigable), jnp.inf),
    )


def draw_samples(
    key: Array, data: JourneySet, *, batch_size: int, symmetries: tuple[float, ...], normalize: Normalize
) -> Samples:
    """A random batch: uniform over views of all journeys, and over the goals that can be reached from each view.

    `symmetries` are the probabilities of `SYMMETRIES`.
    """
    journey_key, view_key, goal_key, turn_key = jax.random.split(key, 4)
    journeys, views = data.headings.shape
    journey = jax.random.randint(journey_key, (batch_size,), 0, journeys)
    view = jax.random.randint(view_key, (batch_size,), 0, views)
    cell = data.places[journey, view].astype(jnp.int32)
    distance = data.distance[data.house[journey], :, cell[:, 0], cell[:, 1]]
    target = jax.random.categorical(goal_key, jnp.where(distance != _UNREACHABLE, 0.0, -1e9))
    turn = jax.random.categorical(turn_key, jnp.log(jnp.asarray(symmetries) + 1e-30), shape=(batch_size,))
    symmetry = jnp.asarray(SYMMETRIES, jnp.int32)[turn]
    make = functools.partial(make_sample, normalize=normalize)
    return jax.vmap(make, in_axes=(None, 0, 0, 0, 0))(data, journey, view, target, symmetry)
