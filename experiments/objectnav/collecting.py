"""Training sets: distances in houses, journeys through them, and the features of what robots saw on the way."""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Float16, Int, UInt8, UInt16

from dc2g_jax.grid import largest_piece
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.houses.worlds import IndoorWorld, padded_alike, painted, scene
from dc2g_jax.indoor.learning.midlevel import TrainedEncoder
from dc2g_jax.indoor.maps.camera import CameraView, camera_pose, indoor_camera, view
from dc2g_jax.indoor.maps.classes import GOALS
from dc2g_jax.indoor.maps.cost_maps import ROBOT_RADIUS, inflated, straight_distance, with_tight_cells
from dc2g_jax.indoor.maps.fast_marching import geodesic_distance
from dc2g_jax.indoor.maps.mapping import EXPLORED_CHANNEL, IndoorMap, IndoorMapSettings, has, with_frame
from dc2g_jax.robot import CameraPose, Scene, render, wrapped
from dc2g_jax.runtime import InputError, check_number, deal, gather, jit, mesh_of, on_each, replicate
from experiments.objectnav.data import JourneySet, in_millimeters, map_of

#: Stands for the first view of a cell that no view shows.
NEVER = 255

#: Places that a robot visits at most, one after the other.
_STAGES = 12

#: Distance driven between two views, meters, and largest turn, radians: four steps of 0.1 s at 0.6 m/s and 1.5 rad/s.
_DRIVE_A_VIEW, _TURN_A_VIEW = 0.24, 0.6

#: The robot turns in place until the direction of its path is within this angle of its heading, radians.
_AHEAD = 1.0

#: A place counts as reached within this distance, meters.
_REACHED = 0.3

#: Standard deviation of a glance to the side, radians; a robot glances in every fourth view.
_GLANCE = 0.6

_NEIGHBORS = ((0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1))


class Journey(NamedTuple):
    """The path of one robot, and when it saw each cell.

    Attributes:
      cells: row and column of the robot at each view.
      headings: heading of the camera at each view.
      first_seen: number of the view that first showed each cell, `NEVER` if none did.
    """

    cells: Int[Array, "view 2"]
    headings: Float[Array, "view"]
    first_seen: UInt8[Array, "h w"]


class _Robot(NamedTuple):
    """State of a robot between two views: its cell, its heading, and how many of its places it has reached."""

    cell: Int[Array, "2"]
    heading: Float[Array, ""]
    stage: Int[Array, ""]


def camera_over(cell: Int[Array, "2"], heading: ArrayLike, cell_size: ArrayLike) -> CameraPose:
    """The pose of the camera of a robot in the center of a cell (row and column) of a house; see `camera_pose`."""
    row, column = (cell + 0.5) * cell_size
    return camera_pose(column, -row, heading)


def explore(
    house: Scene,
    distances: Float[Array, "place h w"],
    start: Int[Array, "2"],
    key: Array,
    *,
    cell_size: float,
    views: int,
) -> Journey:
    """Simulate a robot that drives from place to place in random order, and maps what its camera sees.

    Args:
      house: the house.
      distances: remaining distance to each place, meters; infinite where the robot must not be. Unreachable places are
        skipped.
      start: row and column of the start; the initial heading is random.
      key: random key.
      cell_size: edge of a cell, meters.
      views: number of views, less than `NEVER`.
    """
    height, width = distances.shape[1:]
    side, camera, drive = max(height, width), indoor_camera(), max(round(_DRIVE_A_VIEW / cell_size), 1)
    settings = IndoorMapSettings(cells=side, local=side, cell_size=cell_size)
    order_key, way_key = jax.random.split(key)
    places = jax.random.randint(order_key, (_STAGES,), 0, len(distances))
    first_key, views_key = jax.random.split(way_key)
    begin = _Robot(start, jax.random.uniform(first_key, minval=-math.pi, maxval=math.pi), jnp.int32(0))
    nothing = IndoorMap(jnp.zeros((side, side), jnp.uint32), jnp.zeros(2, jnp.int32))

    def look(carry: tuple[_Robot, IndoorMap, Array], seed: tuple[Array, Array]) -> tuple[tuple, tuple]:
        (robot, known, first_seen), (number, view_key) = carry, seed
        glance_key, chance_key = jax.random.split(view_key)
        glances = jax.random.bernoulli(chance_key, 0.25)
        heading = wrapped(robot.heading + jnp.where(glances, _GLANCE * jax.random.normal(glance_key), 0))
        pose = camera_over(robot.cell, heading, cell_size)
        frame = render(house, camera, pose, settings.reach)
        known = with_frame(known, frame, pose.position[:2], camera, settings)
        explored = has(known.cells, EXPLORED_CHANNEL)[:height, :width]
        first_seen = jnp.minimum(first_seen, jnp.where(explored, number, NEVER).astype(jnp.uint8))
        return (_driven(robot, distances, places, drive), known, first_seen), (robot.cell, heading)

    never = jnp.full((height, width), NEVER, jnp.uint8)
    (_, _, first_seen), (cells, headings) = jax.lax.scan(
        look, (begin, nothing, never), (jnp.arange(views), jax.random.split(views_key, views))
    )
    return Journey(cells, headings, first_seen)


def _driven(robot: _Robot, distances: Float[Array, "place h w"], places: Int[Array, "stage"], cells: int) -> _Robot:
    """The robot at the next view: turned toward its path, and `cells` cells further if it faces along the path."""

    def left(stage: Array, at: Int[Array, "*n 2"]) -> Float[Array, "*n"]:
        place = places[stage % len(places)]
        return distances.at[place, at[..., 0], at[..., 1]].get(mode="fill", fill_value=jnp.inf)

    here = left(robot.stage, robot.cell)
    stage = robot.stage + ((here < _REACHED) | ~jnp.isfinite(here))

    def step(cell: Int[Array, "2"], _: None) -> tuple[Int[Array, "2"], None]:
        around = cell + jnp.array([(0, 0), *_NEIGHBORS])
        return around[jnp.argmin(left(stage, around))], None

    ahead, _ = jax.lax.scan(step, robot.cell, length=cells)
    down, right = ahead - robot.cell
    moves = (down != 0) | (right != 0)
    error = jnp.where(moves, wrapped(jnp.arctan2(-down, right) - robot.heading), 0)
    heading = robot.heading + jnp.clip(error, -_TURN_A_VIEW, _TURN_A_VIEW)
    drives = jnp.abs(error) < _AHEAD
    return _Robot(jnp.where(drives, ahead, robot.cell), heading, stage)


@dataclasses.dataclass(frozen=True)
class CollectionConfig:
    """How many samples to make, and of what.

    Attributes:
      journeys: robots a house.
      views: moments of each of them, every fourth step of 0.1 s, at most 254.
      places: random places a house that robots are sent to, besides the goals.
      largest: cells along the side of the largest house to use.
      data_seed: of the journeys.
    """

    journeys: int = 6
    views: int = 48
    places: int = 3
    largest: int = 200
    data_seed: int = 0

    def __post_init__(self) -> None:
        check_number("views", self.views, whole=True, least=1, most=NEVER - 1)
        check_number("journeys", self.journeys, whole=True, least=1)
        check_number("places", self.places, whole=True, least=1)


def usable(houses: Sequence[IndoorHouse], largest: int) -> list[IndoorWorld]:
    """The worlds of the houses with sides of at most `largest` cells, padded to one size.

    Raises:
      InputError: there is none.
    """
    worlds = [house.world for house in houses if max(house.world.free.shape) <= largest]
    if not worlds:
        raise InputError(f"none of {len(houses)} houses has sides of at most {largest} cells; allow larger ones")
    return padded_alike(worlds)


def largest_region(world: IndoorWorld) -> Bool[np.ndarray, "h w"]:
    """The cells of the largest region of a house in which a robot can drive; none if it fits nowhere."""
    return largest_piece(np.asarray(world.fits))


def _random_places(world: IndoorWorld, count: int, rng: np.random.Generator) -> Int[np.ndarray, "place 2"]:
    """Rows and columns of random cells in the largest part of a house that a robot can drive about.

    Raises:
      InputError: the robot fits nowhere.
    """
    cells = np.argwhere(largest_region(world))
    if not len(cells):
        raise InputError("a robot fits nowhere in a house; give houses with wider rooms")
    return cells[rng.integers(len(cells), size=count)].astype(np.int32)


def distance_for_vehicle(
    obstacles: Bool[Array, "h w"], goals: Bool[Array, "h w"], radius: float, cell_size: float
) -> Float[Array, "h w"]:
    """Distance that the center of a round vehicle has to drive until it touches the goal (fast marching method).

    The vehicle cannot touch the goal through an obstacle.

    Args:
      obstacles: cells that the vehicle must not touch, except those of the goal.
      goals: cells of the goal, obstacles or free.
      radius: radius of the vehicle, meters.
      cell_size: edge of a cell, meters.

    Returns:
      float32 meters; infinity where the vehicle does not fit and where no path leads to the goal.
    """
    near = jnp.isfinite(straight_distance(goals, obstacles & ~goals, cell_size, radius + cell_size))
    touching = goals | (inflated(goals, radius, cell_size) & near & ~obstacles)
    return geodesic_distance(~inflated(obstacles, radius, cell_size), touching, cell_size)


def _distances(
    free: Bool[Array, "h w"], classes: UInt8[Array, "h w"], places: Int[Array, "place 2"], cell_size: float
) -> tuple[UInt16[Array, "goal h w"], Float[Array, "way h w"]]:
    """Labels of a house, and what its robots are led by: distances to places, then to goals."""

    def drive_to(goals: Bool[Array, "h w"]) -> Float[Array, "h w"]:
        return distance_for_vehicle(~free, goals, ROBOT_RADIUS, cell_size)

    def label(distance: Float[Array, "h w"]) -> UInt16[Array, "h w"]:
        return in_millimeters(with_tight_cells(distance, free, fits, cell_size))

    fits = ~inflated(~free, ROBOT_RADIUS, cell_size)
    to_goals = jax.lax.map(lambda goal: drive_to((classes == goal) & ~free), jnp.asarray(GOALS, jnp.uint8))
    to_places = jax.lax.map(lambda place: drive_to(jnp.zeros_like(free).at[place[0], place[1]].set(True)), places)
    return jax.lax.map(label, to_goals), jnp.concatenate([to_places, to_goals])


@jit
def _views(
    house: Scene, paint: UInt8[Array, "h w 3"], cells: Int[Array, "n 2"], headings: Float[Array, "n"]
) -> CameraView:
    return jax.lax.map(
        lambda pose: view(house, paint, camera_over(pose[0], pose[1], house.tile_size)), (cells, headings)
    )


def _given(world: IndoorWorld, config: CollectionConfig, number: int) -> tuple:
    """What one house is collected from: the house, its scene and colors, places, starts and random key."""
    rng = np.random.default_rng((config.data_seed, number))
    places = _random_places(world, config.places + config.journeys, rng)
    key = jax.random.key_data(jax.random.fold_in(jax.random.key(config.data_seed), number))
    return world, scene(world), painted(world, rng), places[: config.places], places[config.places :], key


@functools.partial(jit, static_argnames=("mesh", "cell_size", "views"))
def _collect_houses(
    houses: tuple, encoder: TrainedEncoder, *, mesh: Mesh, cell_size: float, views: int
) -> tuple[UInt16[Array, "devices 1 goal h w"], Journey, Float16[Array, "devices 1 n 2 f"]]:
    """Labels, journeys, and features of images and of their mirror images, of a house on each device."""

    def on_device(houses: tuple, encoder: TrainedEncoder) -> tuple[Array, Journey, Array]:
        world, house, paint, places, starts, key = jax.tree.map(lambda leaf: leaf[0], houses)
        labels, distances = _distances(world.free, world.classes, places, cell_size)
        keys = jax.random.split(jax.random.wrap_key_data(key), len(starts))
        journeys = jax.lax.map(
            lambda robot: explore(house, distances, *robot, cell_size=cell_size, views=views), (starts, keys)
        )
        cells, headings = journeys.cells.reshape(-1, 2), journeys.headings.reshape(-1)
        images = _views(house, paint, cells, headings).image
        features = jnp.stack([encoder.encode(images), encoder.encode(images[:, :, ::-1])], axis=1).astype(jnp.float16)
        return jax.tree.map(lambda leaf: leaf[None], (labels, journeys, features))

    return on_each(on_device, mesh, houses, encoder)


def collect(
    houses: Sequence[IndoorHouse],
    encoder: TrainedEncoder,
    config: CollectionConfig,
    on_progress: Callable[[int], None] | None = None,
) -> JourneySet:
    """Send robots through the houses that are not too large, on every device at once; the same for the same seed.

    Raises:
      InputError: no house can be used.
    """
    worlds = usable(houses, config.largest)
    mesh = mesh_of()
    encoder = replicate(encoder, mesh)
    # The nearest float to the size that was asked for, not to its 32 bits.
    cell_size = float(str(np.float32(worlds[0].cell_size)))
    rounds = []
    for first in range(0, len(worlds), mesh.size):
        given = [_given(world, config, first + n) for n, world in enumerate(worlds[first : first + mesh.size])]
        houses = deal(jax.tree.map(lambda *leaves: np.stack(leaves), *given), len(given), mesh)
        made = _collect_houses(houses, encoder, mesh=mesh, cell_size=cell_size, views=config.views)
        rounds.append(gather(made, len(given)))
        if on_progress is not None:
            on_progress(first + len(given))
    labels, journeys, features = jax.tree.map(lambda *leaves: np.concatenate(leaves), *rounds)
    headings = journeys.headings.reshape(-1, config.views)
    return JourneySet(
        cells=np.stack([np.asarray(map_of(world)) for world in worlds]),
        distance=labels,
        house=np.repeat(np.arange(len(worlds), dtype=np.int32), config.journeys),
        first_seen=journeys.first_seen.reshape(-1, *journeys.first_seen.shape[2:]),
        places=journeys.cells.reshape(*headings.shape, 2).astype(np.int16),
        headings=headings,
        features=features.reshape(*headings.shape, *features.shape[2:]),
    )


def random_views(
    houses: Sequence[IndoorHouse], count: int, seed: int, largest: int = CollectionConfig.largest
) -> CameraView:
    """`count` pictures a house from random places in random directions, to train an encoder on.

    Raises:
      InputError: no house can be used.
    """
    taken = []
    for number, world in enumerate(usable(houses, largest)):
        rng = np.random.default_rng((seed, number))
        cells = jnp.asarray(_random_places(world, count, rng))
        headings = jnp.asarray(rng.uniform(-np.pi, np.pi, count), jnp.float32)
        views = _views(scene(world), jnp.asarray(painted(world, rng)), cells, headings)
        taken.append(jax.tree.map(np.asarray, views))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *taken)
