"""Robots under way on random maps, and an estimator to lead them."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import struct

from dc2g_jax._src.grid import bitboard, gridworld, poses, search
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import EXPLORE, Frontier, Planner
from dc2g_jax._src.planning.rules import Rules
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps

STEP_LIMIT = 120
EPISODES = 10

SENSING, EXPANDING = 4, 3


def belief_of(terrain, seen, pose) -> Belief:
    """The belief of a robot that has seen these cells, by whatever way."""
    seen = bitboard.pack(jnp.asarray(seen))
    return gridworld.belief_of(World.from_terrain(terrain), make_pose(*pose), jnp.int32(0), seen)


def random_moment(seed: int, shape: tuple[int, int], density: float):
    """A random map of which a random part has been seen: a few looks around, or cells at random."""
    rng = np.random.default_rng([seed, 2])
    terrain = maps.random_terrain(seed, shape, density)
    terrain.flat[seed % terrain.size] = 3
    pose = maps.random_pose(seed, np.isin(terrain, oracle.TRAVERSABLE_CLASSES))
    seen = oracle.visible(pose, SENSING, shape)
    if seed % 3:
        for _ in range(rng.integers(8)):
            look = (int(rng.integers(shape[1])), int(rng.integers(shape[0])), int(rng.integers(4)))
            seen |= oracle.visible(look, SENSING, shape)
    else:
        seen |= rng.random(shape) < rng.choice([0.2, 0.6, 0.9, 1.0])
    return terrain, seen, pose


def random_worlds(shape, first_seed: int, doors: int = 1, episodes: int = EPISODES):
    """Random maps, and a start on traversable ground that is no door in each."""
    terrains, starts = [], []
    for seed in range(first_seed, first_seed + episodes):
        terrain = maps.random_terrain(seed, shape, (0.65, 0.75, 0.85)[seed % 3], doors=doors if seed % 4 else 2 * doors)
        terrain.flat[0 if terrain.flat[0] != oracle.FRONT_DOOR else -1] = 3
        ground = np.isin(terrain, oracle.TRAVERSABLE_CLASSES) & (terrain != oracle.FRONT_DOOR)
        terrains.append(terrain)
        starts.append(maps.random_pose(seed, ground))
    return np.stack(terrains), starts


@struct.dataclass
class PlanAlone:
    """A planner of a user's own that has nothing but a plan, that of frontier exploration."""

    rules: Rules = struct.field(pytree_node=False)

    def init(self, world):
        return Frontier(self.rules).init(world)

    def plan(self, belief, state):
        return Frontier(self.rules).plan(belief, state)


@struct.dataclass
class LowestColumn(Planner):
    """A planner of a user's own that explores from the candidates farthest to the left and tells so."""

    rules: Rules = struct.field(pytree_node=False)

    def init(self, world):
        return Frontier(self.rules).init(world)

    def assess(self, belief, state):
        assessment, state = Frontier(self.rules).assess(belief, state)
        cells = poses.occupied(assessment.candidates)
        column = jnp.broadcast_to(jnp.arange(belief.width, dtype=jnp.float32), (belief.height, belief.width))
        score = jnp.where(bitboard.unpack(cells, belief.width), column, jnp.inf)
        best = assessment.candidates & bitboard.pack(score == jnp.min(score))
        subgoals = jnp.where(assessment.plan.mode == EXPLORE, best, assessment.plan.subgoals)
        first = search.first_action(belief.pose, subgoals, assessment.ground)
        plan = assessment.plan.replace(action=first.action, length=first.length, subgoals=subgoals)
        return assessment.replace(plan=plan, score=column), state


@struct.dataclass
class Scattered:
    """An estimator that depends on where and what has been observed, in whole numbers, with many ties."""

    def init(self, world) -> tuple[()]:
        del world
        return ()

    def estimate(self, terrain, state: Any):
        del state
        y, x = (
            index.reshape(*index.shape, *(1 for _ in terrain.shape[2:])) for index in jnp.indices(terrain.shape[:2])
        )
        unknown = jnp.sum(terrain == 0, axis=(0, 1))
        return ((7 * x + 5 * y + unknown + terrain) % 11).astype(jnp.float32)[None]


@struct.dataclass
class NoNumber(Scattered):
    """An estimator that answers with no number, as a network that has diverged does."""

    def estimate(self, terrain, state):
        return jnp.full_like(super().estimate(terrain, state), jnp.nan)
