"""Planners that mislead the robot, and maps with obstacles, rooms and corridors to be misled in."""

import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from flax import struct

from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.grid import bitboard, poses, search
from dc2g_jax._src.grid.ground import connected_to_goal
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, TO_GOAL, Frontier
from dc2g_jax._src.planning.rules import Rules
from tests.support import maps

#: Number of kinds of bad planner.
KINDS = 8

FLOOR, WALL, DOOR = (CLASS_NAMES.index(name) for name in ("path", "house", "front_door"))


@struct.dataclass
class Hostile:
    """Each world of a stack gets one of eight kinds of bad planner, in turn.

    It explores at random or from the farthest candidate, flees the goal, turns for ever, turns and claims to head
    for a goal, drives ahead into walls and off the map, takes random actions, or gives up.
    """

    rules: Rules = struct.field(pytree_node=False)
    batch_per_core: ClassVar[int] = 64

    def init(self, world):
        kind = jnp.arange(world.goals.shape[2], dtype=jnp.int32) % KINDS
        return kind, Frontier(self.rules).init(world), world_cost_to_go(world)

    def plan(self, belief, state) -> tuple[Any, Any]:
        kind, reachable, cost_to_go = state
        honest, reachable = Frontier(self.rules).assess(belief, reachable)
        row, column = jnp.indices((belief.height, belief.width))[..., None]
        dice = _mixed(jnp.uint32(row * belief.width + column) ^ _mixed(jnp.uint32(belief.steps)))
        nearness = -(abs(row - belief.pose.y) + abs(column - belief.pose.x))
        score = jnp.select([kind == 0, kind == 1], [(dice >> 8).astype(jnp.float32), nearness], -cost_to_go)
        score = jnp.where(bitboard.unpack(poses.occupied(honest.candidates), belief.width), score, jnp.inf)
        worst = honest.candidates & bitboard.pack(score == jnp.min(score, axis=(0, 1)))
        misled = search.first_action(belief.pose, worst, honest.ground)
        # Nothing is left to explore where there is no such action.
        misled = jnp.where(misled.found, misled.action, 1)
        thrown = (_mixed(jnp.uint32(belief.steps)) >> 8).astype(jnp.int32) % 3
        action = jnp.select([kind <= 2, kind <= 4, kind == 6], [misled, 1, thrown], 0)
        # Whatever it does, it claims to head for a goal at every other step.
        claims = (kind == 4) | (belief.steps % 2 == 0)
        mode = jnp.select([claims, kind == 7], [TO_GOAL, GAVE_UP], EXPLORE).astype(jnp.int32)
        plan = dataclasses.replace(honest.plan, action=action.astype(jnp.int32), mode=mode, subgoals=worst)
        return plan, (kind, reachable, cost_to_go)

    def revised(self, state, changed):
        return state


def _mixed(number):
    """A number that looks random, from a number."""
    for _ in range(2):
        number = (number ^ (number >> 16)) * jnp.uint32(0x45D9F3B)
    return number ^ (number >> 16)


def _rooms(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Rooms with openings in the walls between them."""
    free = np.ones(shape, bool)
    for axis, cells in enumerate(shape):
        for wall in range(5, cells - 2, 6):
            across = np.moveaxis(free, axis, 0)[wall]
            across[:] = False
            for begin in range(0, len(across), 6):
                across[min(begin + rng.integers(5), len(across) - 1)] |= rng.random() < 0.8
    return free


def _corridors(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """A maze of corridors one cell wide."""
    free = np.zeros(shape, bool)
    stack = [(0, 0)]
    free[0, 0] = True
    while stack:
        y, x = stack[-1]
        steps = [(0, 2), (2, 0), (0, -2), (-2, 0)]
        onward = [(y + dy, x + dx) for dy, dx in steps if 0 <= y + dy < shape[0] and 0 <= x + dx < shape[1]]
        onward = [cell for cell in onward if not free[cell]]
        if not onward:
            stack.pop()
            continue
        there = onward[rng.integers(len(onward))]
        free[there] = free[(y + there[0]) // 2, (x + there[1]) // 2] = True
        stack.append(there)
    return free | (rng.random(shape) < 0.05)


def misleading_worlds(shape: tuple[int, int], first_seed: int, episodes: int):
    """Maps with obstacles, rooms or corridors, and a start in each from which the door can be reached."""
    terrains, starts = [], []
    for seed in range(first_seed, first_seed + episodes):
        rng = np.random.default_rng([seed, 3])
        kinds = (lambda rng, shape: rng.random(shape) < rng.choice([0.65, 0.75, 0.9]), _rooms, _corridors)
        while True:
            terrain = np.where(kinds[seed % 3](rng, shape), FLOOR, WALL).astype(np.uint8)
            terrain[rng.integers(shape[0]), rng.integers(shape[1])] = DOOR
            ground = connected_to_goal(terrain) & (terrain != DOOR)
            if ground.sum() > 10:
                break
        terrains.append(terrain)
        starts.append(maps.random_pose(seed, ground))
    return np.stack(terrains), starts
