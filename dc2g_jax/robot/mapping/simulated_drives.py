"""Image sequences of a simulated camera that drives to a goal along a shortest path."""

from collections.abc import Iterable, Iterator

import jax
import numpy as np
from jaxtyping import Array, UInt8

from dc2g_jax.grid import FRONT_DOOR, Pose, World, every_heading, first_action, moved
from dc2g_jax.robot.mapping.camera import Frame, Intrinsics
from dc2g_jax.robot.mapping.scene import scene_from_terrain
from dc2g_jax.robot.mapping.sequences import Shot
from dc2g_jax.robot.mapping.simulator import picture, render, robot_camera
from dc2g_jax.runtime import jit


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
) -> Iterator[Shot]:
    """What a simulated camera sees from each pose of a path on a map with cells of `cell_size` meters."""
    scene = scene_from_terrain(terrain, cell_size)

    @jit
    def look(robot: Pose) -> tuple[Frame, Array]:
        pose = robot_camera(robot, cell_size)
        return render(scene, camera, pose), picture(scene, camera, pose)

    return (Shot(*jax.device_get(look(pose))) for pose in path)
