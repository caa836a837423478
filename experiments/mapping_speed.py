"""Time the integration of depth images into semantic maps: `python -m experiments.mapping_speed`.

Each robot stands in the middle of its map and sees ground and a wall 7 m ahead, with 1 % depth noise.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.grid.terrain import HOUSE, ROAD
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax.robot.mapping.camera import Frame, Intrinsics, intrinsics, level_camera, rays
from dc2g_jax.robot.mapping.semantic_map import MapSettings, empty_map, integrate, terrain_map

from .benchmarks.machine import describe
from .benchmarks.timing import measure

#: Side length of the maps, height of the cameras and distance to the wall, meters.
_SIDE, _CAMERA_HEIGHT, _WALL = 50.0, 1.0, 7.0


class Case(NamedTuple):
    """Robots with one camera each, of so many rows and columns, and one map of 50 x 50 m, of so many cells a side."""

    robots: int
    image: tuple[int, int]
    cells: int


CASES = (Case(1, (480, 640), 50), Case(1, (480, 640), 200), Case(1, (120, 160), 50), Case(256, (48, 64), 50))


@dataclasses.dataclass(frozen=True)
class Options(OutOptions):
    """Time the integration of depth and class images into voxel maps, and the projection to 2D maps.

    Attributes:
      repeats: measurements of each case.
    """

    repeats: int = 15


def look(robot: Int[Array, ""], camera: Intrinsics) -> Frame:
    """The frame of a robot's camera. Each robot has its own direction."""
    pose = level_camera(_SIDE / 2, -_SIDE / 2, _CAMERA_HEIGHT, 0.3 * robot, 0.2)
    descent = -rays(camera, pose)[..., 2]
    ground = jnp.where(descent > 0, _CAMERA_HEIGHT / descent, jnp.inf)
    depth = jnp.minimum(ground, _WALL) * (1 + 0.01 * jax.random.normal(jax.random.key(robot), ground.shape))
    return Frame(depth, jnp.where(ground < _WALL, ROAD, HOUSE).astype(jnp.uint8), pose)


def mapping_row(case: Case, repeats: int) -> dict[str, Any]:
    """Measure one case. Times are in milliseconds for all robots together.

    Returns:
      The case; `integrate`, the median time of one frame per robot, and `worst`, that of the slowest repeat; frames of
      all robots per second, from the median; `terrain`, the median time to project all 2D maps; and the peak memory of
      the process or the device, GiB.
    """
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
    return {
        **case._asdict(),
        "integrate": round(1e3 * taking.median, 2),
        "worst": round(1e3 * taking.worst, 2),
        "frames_a_second": round(case.robots / taking.median, 1),
        "terrain": round(1e3 * reading.median, 2),
        "gib": round(taking.peak_memory / 2**30, 2),
    }


def main(options: Options) -> None:
    """Measure all cases, print a table and write `mapping_speed.json`."""
    require_positive(options, "repeats")
    out = output_folder(options, "mapping_speed")
    machine = describe()
    print(f"{machine['cpu']}, {machine['cores']} cores, {machine['platform']}, load {machine['load']}; times in ms")
    print("  robots      image   cells  integrate    worst   frames/s  terrain map    GiB")
    rows = []
    for case in CASES:
        rows.append(mapping_row(case, options.repeats))
        print(
            "{robots:8d}{image[1]:7d}x{image[0]:3d}{cells:8d}{integrate:11.2f}{worst:9.2f}"
            "{frames_a_second:11.1f}{terrain:13.2f}{gib:7.2f}".format(**rows[-1]),
            flush=True,
        )
    write_json(out / "mapping_speed.json", {"machine": machine, "rows": rows})
    print(f"Written: {out / 'mapping_speed.json'}")


if __name__ == "__main__":
    command_line(Options, main)
