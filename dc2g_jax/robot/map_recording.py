"""Map a recorded sequence of depth images: `dc2g map recording --sequence FOLDER`."""

import dataclasses
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro
from jaxtyping import Array, UInt8
from tqdm import tqdm

from dc2g_jax import commands
from dc2g_jax.datasets import check_starts, open_dataset
from dc2g_jax.estimation import world_cost_to_go
from dc2g_jax.grid import FRONT_DOOR, UNKNOWN, Pose, World, every_heading, first_action, make_pose, moved
from dc2g_jax.inspection import plot_map
from dc2g_jax.robot.mapping import sequences
from dc2g_jax.robot.mapping.camera import Frame, Intrinsics, intrinsics
from dc2g_jax.robot.mapping.scene import CELL_SIZE, scene_from_terrain
from dc2g_jax.robot.mapping.semantic_map import MapSettings
from dc2g_jax.robot.mapping.simulator import FIELD_OF_VIEW, picture, render, robot_camera
from dc2g_jax.robot.recording import record_mapping
from dc2g_jax.runtime import InputError, check_number, jit


@dataclasses.dataclass(frozen=True)
class Options(commands.DatasetOptions, commands.OutOptions):
    """Map a recorded sequence of depth and class images: writes the map, a figure and a rerun recording.

    Attributes:
      sequence: folder of the sequence, in the layout of the TUM RGB-D benchmark, with class images (classes.txt) and
        intrinsics (camera.txt); see `mapping.sequences`.
      simulate: simulate the sequence instead, with a camera that drives along the shortest path in this house of the
        dataset.
      start: start of the simulated drive: column, row (growing downward) and heading (0 right, 1 down, 2 left, 3 up);
        sampled by default.
      seed: seed of the sampled start.
      image_size: width and height of the simulated images, pixels.
      cell_size: side length of the map's cells, meters.
      reach: longest depth that is used, meters.
      ground: height of the ground in the frame of the sequence, meters.
    """

    sequence: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    simulate: Annotated[str | None, tyro.conf.arg(metavar="HOUSE", help_behavior_hint="")] = None
    start: commands.StartOption = None
    seed: int = 0
    image_size: commands.ImageSizeOption = (160, 120)
    cell_size: float = CELL_SIZE
    reach: float = 10.0
    ground: float = 0.0


def main(options: Options) -> None:
    """Simulate or read the sequence, map it, draw and write the map."""
    if (options.sequence is None) == (options.simulate is None):
        raise InputError("give either --sequence with the folder of a sequence, or --simulate with a house")
    check_number("--cell-size", options.cell_size, above=0, hint="meters")
    check_number("--reach", options.reach, above=0, hint="meters")
    check_number("--ground", options.ground, hint="meters")
    for pixels in options.image_size:
        check_number("--image-size", pixels, whole=True, least=1)
    house = None
    if options.sequence is not None:
        folder = options.sequence
        sequence = sequences.moved(sequences.read_sequence(folder), np.array([0, 0, -options.ground]))
        sequence, settings = sequences.covered(sequence, options.cell_size, options.reach)
        out = commands.output_folder(options, "map_recording")
    elif options.simulate is not None:
        dataset = open_dataset(options.dataset)
        house = dataset.house(options.simulate)
        start = commands.start_in(house.name, house, options.start, options.seed)
        check_starts([start], dataset)
        out = commands.output_folder(options, "map_recording")
        folder = out / "sequence"
        camera = intrinsics(FIELD_OF_VIEW, options.image_size[1], options.image_size[0])
        path = path_to_goal(house.terrain, make_pose(start.x, start.y, start.heading))
        path_shown = tqdm(path, desc="driving", unit="frame", file=sys.stderr)
        shots = simulated_shots(house.terrain, path_shown, camera, options.cell_size)
        sequences.write_sequence(folder, camera, shots)
        sequence = sequences.read_sequence(folder)
        rows, columns = house.terrain.shape
        settings = MapSettings(rows=rows, columns=columns, cell_size=options.cell_size, reach=options.reach)
    name = folder.name if house is None else house.name
    terrain, wrong = record_mapping(out / "recording.rrd", sequence, settings, name)
    np.save(out / "map.npy", terrain)
    title = f"{name}: {len(sequence.frames) - wrong} frames, {settings.columns} x {settings.rows} cells"
    plot_map(out / "map", title, terrain, np.asarray(world_cost_to_go(World.from_terrain(terrain))))
    known = terrain != UNKNOWN
    print(f"{title}; {np.sum(known):,} cells known")
    if sequence.skipped or wrong:
        print(f"depth images without class image or pose: {sequence.skipped}; frames that were left out: {wrong}")
    if house is not None and np.any(known):
        print(f"of the known cells, {100 * np.mean((terrain == house.terrain)[known]):.1f} % are as in the house")
    commands.print_files(out)


def path_to_goal(terrain: UInt8[np.ndarray, "h w"], start: Pose) -> list[Pose]:
    """The poses of a shortest path from a start to the nearest goal, one per step. A path must exist."""
    world = World.from_terrain(terrain)

    @jit
    def step(pose: Pose) -> Pose:
        action = first_action(pose, every_heading(world.goals), world.traversable).action
        return moved(pose, action, *terrain.shape)

    path = [start]
    while terrain[path[-1].y, path[-1].x] != FRONT_DOOR:
        path.append(step(path[-1]))
    return path


def simulated_shots(
    terrain: UInt8[np.ndarray, "h w"], path: Iterable[Pose], camera: Intrinsics, cell_size: float
) -> Iterator[sequences.Shot]:
    """What a simulated camera sees from each pose of a path on a map with cells of `cell_size` meters."""
    scene = scene_from_terrain(terrain, cell_size)

    @jit
    def look(robot: Pose) -> tuple[Frame, Array]:
        pose = robot_camera(robot, cell_size)
        return render(scene, camera, pose), picture(scene, camera, pose)

    return (sequences.Shot(*jax.device_get(look(pose))) for pose in path)
