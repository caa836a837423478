"""Integration of depth images into semantic maps.

Each robot stands in the middle of its map and sees ground and a wall 7 m ahead, with 1 % depth noise.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from dc2g_jax._src.grid.terrain import HOUSE, ROAD
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax.robot.mapping.camera import Frame, Intrinsics, intrinsics, level_camera, rays
from dc2g_jax.robot.mapping.semantic_map import MapSettings, empty_map, integrate, terrain_map

from .timing import measure

#: Side length of the maps, height of the cameras and distance to the wall, meters.
_SIDE, _CAMERA_HEIGHT, _WALL = 50.0, 1.0, 7.0


class Case(NamedTuple):
    """Robots with one camera and one map of 50 x 50 m each."""

    robots: int
    image: tuple[int, int]
    cells: int


class MappingRow(NamedTuple):
    """One case. Times are in milliseconds for all robots together.

    Attributes:
      robots: number of robots.
      image: rows and columns of each camera's image.
      cells: side length of each map.
      integrate: median time of one frame per robot.
      worst: time of the slowest repeat.
      frames_a_second: frames of all robots per second, from the median.
      terrain: median time to project all 2D maps.
      gib: peak memory of the process or the device, GiB.
    """

    robots: int
    image: tuple[int, int]
    cells: int
    integrate: float
    worst: float
    frames_a_second: float
    terrain: float
    gib: float


def look(robot: Int[Array, ""], camera: Intrinsics) -> Frame:
    """The frame of a robot's camera. Each robot has its own direction."""
    pose = level_camera(_SIDE / 2, -_SIDE / 2, _CAMERA_HEIGHT, 0.3 * robot, 0.2)
    descent = -rays(camera, pose)[..., 2]
    ground = jnp.where(descent > 0, _CAMERA_HEIGHT / descent, jnp.inf)
    depth = jnp.minimum(ground, _WALL) * (1 + 0.01 * jax.random.normal(jax.random.key(robot), ground.shape))
    return Frame(depth, jnp.where(ground < _WALL, ROAD, HOUSE).astype(jnp.uint8), pose)


def mapping_row(case: Case, repeats: int) -> MappingRow:
    """Measure one case."""
    camera = intrinsics(90.0, *case.image)
    settings = MapSettings(rows=case.cells, columns=case.cells, cell_size=_SIDE / case.cells)
    robots = jnp.arange(case.robots)
    frames = jit(jax.vmap(look, in_axes=(0, None)))(robots, camera)
    maps = jax.vmap(lambda _: empty_map(settings))(robots)
    take = jit(jax.vmap(integrate, in_axes=(0, 0, None, None)))
    read = jit(jax.vmap(terrain_map, in_axes=(0, None)))
    taking = measure(lambda: take(maps, frames, camera, settings), repeats=repeats)
    filled = take(maps, frames, camera, settings)
    reading = measure(lambda: read(filled, settings), repeats=repeats)
    median, worst = taking.median, taking.worst
    return MappingRow(
        *case,
        integrate=round(1e3 * median, 2),
        worst=round(1e3 * worst, 2),
        frames_a_second=round(case.robots / median, 1),
        terrain=round(1e3 * reading.median, 2),
        gib=round(taking.peak_memory / 2**30, 2),
    )
