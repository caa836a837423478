"""How many depth images a second go into semantic maps: `python -m experiments.mapping_speed`.

Each robot looks, from the middle of its map, at ground and at a wall 7 m ahead, with noise of 1 % of the depth.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from dc2g_jax.cli.common import OutOption, command_line
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.errors import InputError
from dc2g_jax.files.atomic import write_json
from dc2g_jax.grid.terrain import HOUSE, ROAD
from dc2g_jax.mapping.camera import Frame, Intrinsics, intrinsics, level_camera, rays
from dc2g_jax.mapping.semantic_map import MapSettings, empty_map, integrate, terrain_map
from dc2g_jax.programs import jit

from .benchmarks.machine import describe
from .benchmarks.timing import measure


class Case(NamedTuple):
    """Robots that each have a camera of their own and a map of 50 x 50 m."""

    robots: int
    image: tuple[int, int]
    cells: int


CASES = (Case(1, (480, 640), 50), Case(1, (480, 640), 200), Case(1, (120, 160), 50), Case(256, (48, 64), 50))

#: Side of every map, meters; height of the cameras and how far ahead of them the wall is.
_SIDE, _CAMERA_HEIGHT, _WALL = 50.0, 1.0, 7.0


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Time how depth images with classes are taken into voxel maps, and how the 2D maps are read off.

    Attributes:
      repeats: how many times to measure each case.
      out: folder to write to; a new one below outputs/ where not given.
    """

    repeats: int = 15
    out: OutOption = None


class MappingRow(NamedTuple):
    """One case; times in milliseconds for all its robots together.

    Attributes:
      robots: how many.
      image: rows and columns of each camera's image.
      cells: sides of each map.
      integrate: one frame for each robot, median.
      worst: the slowest repeat.
      frames_a_second: of all robots together, by the median.
      terrain: reading off all 2D maps, median.
      gib: most memory held, by the process or on the device.
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
    """What a robot's camera delivers; each robot looks another way."""
    pose = level_camera(_SIDE / 2, -_SIDE / 2, _CAMERA_HEIGHT, 0.3 * robot, 0.2)
    descent = -rays(camera, pose)[..., 2]
    ground = jnp.where(descent > 0, _CAMERA_HEIGHT / descent, jnp.inf)
    depth = jnp.minimum(ground, _WALL) * (1 + 0.01 * jax.random.normal(jax.random.key(robot), ground.shape))
    return Frame(depth, jnp.where(ground < _WALL, ROAD, HOUSE).astype(jnp.uint8), pose)


def run(case: Case, repeats: int) -> MappingRow:
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
    median, worst = taking.timing.median, taking.timing.worst
    return MappingRow(
        *case,
        integrate=round(1e3 * median, 2),
        worst=round(1e3 * worst, 2),
        frames_a_second=round(case.robots / median, 1),
        terrain=round(1e3 * reading.timing.median, 2),
        gib=round(taking.peak_memory / 2**30, 2),
    )


def main(options: Options) -> None:
    """Measure all cases, print a table and write `mapping_speed.json`."""
    if options.repeats < 1:
        raise InputError(f"repeats is {options.repeats}; give 1 or more")
    out = output_folder(options, "mapping_speed")
    machine = describe()
    print(f"{machine['cpu']}, {machine['cores']} cores, {machine['platform']}, load {machine['load']}; times in ms")
    print("  robots      image   cells  integrate    worst   frames/s  terrain map    GiB")
    rows = []
    for case in CASES:
        row = run(case, options.repeats)
        rows.append(row._asdict())
        print(
            f"{row.robots:8d}{row.image[1]:7d}x{row.image[0]:3d}{row.cells:8d}{row.integrate:11.2f}{row.worst:9.2f}"
            f"{row.frames_a_second:11.1f}{row.terrain:13.2f}{row.gib:7.2f}",
            flush=True,
        )
    write_json(out / "mapping_speed.json", {"machine": machine, "rows": rows})
    print(f"Written: {out / 'mapping_speed.json'}")


if __name__ == "__main__":
    command_line(Options, main)
