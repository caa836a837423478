"""From a recorded camera to a map: `python -m experiments.map_recording --sequence FOLDER`."""

import dataclasses
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro
from jaxtyping import Array
from tqdm import tqdm

from dc2g_jax.cli.common import DatasetOption, OutOption, command_line
from dc2g_jax.cli.map_options import StartOption, start_in
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.datasets.houses import House, open_dataset
from dc2g_jax.datasets.starts import Start
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.estimators import world_cost_to_go
from dc2g_jax.grid.poses import Pose, every_heading, make_pose, moved
from dc2g_jax.grid.search import first_action
from dc2g_jax.grid.terrain import FRONT_DOOR, UNKNOWN
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.inspection.camera_recording import CameraRecording, MappedFrame
from dc2g_jax.inspection.map_figures import plot_map
from dc2g_jax.mapping import sequences
from dc2g_jax.mapping.camera import Frame, intrinsics
from dc2g_jax.mapping.checks import check_frame
from dc2g_jax.mapping.scene import CELL_SIZE, scene_from_terrain
from dc2g_jax.mapping.semantic_map import MapSettings, empty_map, integrate, terrain_map
from dc2g_jax.mapping.sequences import ImageSequence, Shot
from dc2g_jax.mapping.simulator import FIELD_OF_VIEW, picture, render, robot_camera
from dc2g_jax.programs import jit

HouseOption = Annotated[str | None, tyro.conf.arg(metavar="HOUSE", help_behavior_hint="")]
ImageSizeOption = Annotated[tuple[int, int], tyro.conf.arg(metavar="WIDTH HEIGHT")]
SequenceOption = Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")]


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Map a recorded sequence of depth images with classes, frame by frame: the map, a figure and a rerun recording.

    Attributes:
      sequence: folder of the sequence, laid out as by the TUM RGB-D benchmark, with class images (classes.txt) and
        intrinsics (camera.txt) besides; `dc2g_jax.mapping.sequences` says how.
      simulate: make the sequence instead, by driving a simulated camera along the shortest way in this house.
      dataset: where the house is, a folder or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      start: where the simulated drive starts: column, row (growing downward) and heading (0 right, 1 down, 2 left,
        3 up); sampled where not given.
      seed: of the sampled start.
      image_size: width and height of the simulated images, pixels.
      cell_size: side of the map's cells, meters.
      reach: returns from farther away are skipped, meters from the camera.
      ground: height of the ground in the world of the sequence, meters.
      out: folder to write to; a new one below outputs/ where not given.
    """

    sequence: SequenceOption = None
    simulate: HouseOption = None
    dataset: DatasetOption = None
    start: StartOption = None
    seed: int = 0
    image_size: ImageSizeOption = (160, 120)
    cell_size: float = CELL_SIZE
    reach: float = 10.0
    ground: float = 0.0
    out: OutOption = None


def way_to_goal(house: House, start: Start) -> list[Pose]:
    """The poses of a shortest way from a start to the nearest goal, one a step. There is one."""
    world = world_from_terrain(house.terrain)

    @jit
    def step(pose: Pose) -> Pose:
        action = first_action(pose, every_heading(world.goals), world.traversable).action
        return moved(pose, action, *house.terrain.shape)

    way = [make_pose(start.x, start.y, start.heading)]
    while house.terrain[way[-1].y, way[-1].x] != FRONT_DOOR:
        way.append(step(way[-1]))
    return way


def simulate(options: Options, house: House, start: Start, folder: Path) -> None:
    """Write what a simulated camera sees along the shortest way of a house."""
    width, height = options.image_size
    camera = intrinsics(FIELD_OF_VIEW, height, width)
    scene = scene_from_terrain(house.terrain, options.cell_size)

    @jit
    def look(robot: Pose) -> tuple[Frame, Array]:
        pose = robot_camera(robot, options.cell_size)
        return render(scene, camera, pose), picture(scene, camera, pose)

    def shots() -> Iterator[Shot]:
        for pose in tqdm(way_to_goal(house, start), desc="driving", unit="frame", file=sys.stderr):
            frame, colors = jax.device_get(look(pose))
            yield Shot(frame, colors)

    sequences.write_sequence(folder, camera, shots())


def map_sequence(sequence: ImageSequence, settings: MapSettings, out: Path, name: str) -> tuple[np.ndarray, int]:
    """Take in all frames, and record it.

    Returns:
      The map as seen from above, and how many frames were left out because something is wrong with them.
    """
    take = jit(integrate, static_argnums=3)
    read = jit(terrain_map, static_argnums=1)
    voxels, wrong = empty_map(settings), 0
    path = np.stack([moment.pose.position for moment in sequence.moments])
    file = out / "recording.rrd"
    with CameraRecording(file, camera=sequence.intrinsics, settings=settings, path=path, name=name) as recording:
        for moment in tqdm(sequence.moments, desc="mapping", unit="frame", file=sys.stderr):
            frame = sequences.read_frame(sequence, moment)
            try:
                check_frame(frame, sequence.intrinsics, settings)
            except InputError as error:
                tqdm.write(f"left out {moment.depth}: {error}", file=sys.stderr)
                wrong += 1
                continue
            voxels = take(voxels, frame, sequence.intrinsics, settings)
            terrain, after = jax.device_get((read(voxels, settings), voxels))
            recording.add(MappedFrame(frame, sequences.read_picture(moment), after, terrain))
    if wrong == len(sequence.moments):
        raise InputError(f"{name}: something is wrong with all of its {wrong} frames; see the lines above")
    return np.asarray(read(voxels, settings)), wrong


def check_options(options: Options) -> None:
    """Refuse options that make no map, before anything is written."""
    if (options.sequence is None) == (options.simulate is None):
        raise InputError("give either --sequence with the folder of a sequence, or --simulate with a house")
    for option, value in (("--cell-size", options.cell_size), ("--reach", options.reach)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{option} {value:g}: give meters, above 0")
    if not math.isfinite(options.ground):
        raise InputError(f"--ground {options.ground:g}: give meters")
    if min(options.image_size) < 1:
        raise InputError(f"--image-size {options.image_size[0]} {options.image_size[1]}: give pixels, at least 1")


def main(options: Options) -> None:
    """Make or read the sequence, map it, draw and write the map."""
    check_options(options)
    house = None
    if options.sequence is not None:
        folder = options.sequence
        sequence = sequences.moved(sequences.read_sequence(folder), np.array([0, 0, -options.ground]))
        sequence, settings = sequences.covered(sequence, options.cell_size, options.reach)
        out = output_folder(options, "map_recording")
    elif options.simulate is not None:
        house = open_dataset(options.dataset).house(options.simulate)
        start = start_in(house.name, house, options.start, options.seed)
        out = output_folder(options, "map_recording")
        folder = out / "sequence"
        simulate(options, house, start, folder)
        sequence = sequences.read_sequence(folder)
        rows, columns = house.terrain.shape
        settings = MapSettings(rows=rows, columns=columns, cell_size=options.cell_size, reach=options.reach)
    name = folder.name if house is None else house.name
    terrain, wrong = map_sequence(sequence, settings, out, name)
    np.save(out / "map.npy", terrain)
    title = f"{name}: {len(sequence.moments) - wrong} frames, {settings.columns} x {settings.rows} cells"
    plot_map(out / "map", title, terrain, np.asarray(world_cost_to_go(world_from_terrain(terrain))))
    known = terrain != UNKNOWN
    print(f"{title}; {np.sum(known):,} cells known")
    if sequence.skipped or wrong:
        print(f"depth images without class image or pose: {sequence.skipped}; frames that were left out: {wrong}")
    if house is not None and np.any(known):
        print(f"of the known cells, {100 * np.mean((terrain == house.terrain)[known]):.1f} % are as in the house")
    print(f"Written: {out}: map.png, map.svg, map.npy, recording.rrd (open it with: rerun {out / 'recording.rrd'})")


if __name__ == "__main__":
    command_line(Options, main)
