"""The recurrent policy against plain NumPy: blocks, what it sees, its network and the subgoals it takes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.grid import bitboard, poses
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.planning.choosing import Situation, exploring_poses
from dc2g_jax._src.planning.planners import reachable_cells
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax.rivals.recurrent_policy import RecurrentPolicy, block_of_cells, policy_inputs, read_policy
from tests.oracles import numpy_gridworld as oracle
from tests.support.exploration import SENSING, belief_of, random_moment

RULES = complete_rules(SENSING)


def middles(pose):
    """Middle of each block: column, row; and its side."""
    (ahead_x, ahead_y), (right_x, right_y) = oracle.STEPS[pose[2]], oracle.STEPS[(pose[2] + 1) % 4]
    for side in (3, 9, 27, 81):
        for ahead in (-side, 0, side):
            for right in (-side, 0, side):
                x = pose[0] + ahead * ahead_x + right * right_x
                yield x, pose[1] + ahead * ahead_y + right * right_y, side


def plain_blocks(pose, shape):
    """The first block that holds each cell."""
    blocks = np.full(shape, -1)
    for y, x in np.ndindex(shape):
        blocks[y, x] = next(
            number
            for number, (middle_x, middle_y, side) in enumerate(middles(pose))
            if max(abs(x - middle_x), abs(y - middle_y)) <= side // 2
        )
    return blocks


def test_a_cell_is_in_the_smallest_block_that_holds_it():
    for seed in range(8):
        rng = np.random.default_rng(seed)
        shape = (60, 70)
        pose = (int(rng.integers(70)), int(rng.integers(60)), seed % 4)
        np.testing.assert_array_equal(block_of_cells(make_pose(*pose), *shape), plain_blocks(pose, shape))


explored = jax.jit(functools.partial(exploring_poses, rules=RULES))


def moment_of(seed, policy):
    """A random situation: belief and what is known of it in plain NumPy."""
    terrain, seen, pose = random_moment(seed, (40, 37), 0.7)
    belief = belief_of(terrain, seen, pose)
    reachable = jax.jit(reachable_cells)(belief, jnp.zeros_like(belief.seen))
    distance = oracle.distances_from(seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES), pose)
    candidates = explored(belief, reachable)
    visited = seen & (np.random.default_rng(seed).random(seen.shape) < 0.3)
    visited[pose[1], pose[0]] = True
    memory = policy.init(belief).estimator._replace(visited=bitboard.pack(jnp.asarray(visited)))
    situation = Situation(reachable, candidates, jnp.asarray(distance), candidates, memory)
    candidates = np.asarray(poses.unpack(candidates, belief.width))
    return belief, situation, (terrain, seen, pose, distance, visited, candidates)


def plain_surroundings(terrain, seen, pose, distance, visited, candidates):
    """Shares of blocks, numbers of subgoals, and which blocks have one."""
    kinds = np.where(seen, terrain, 0)
    named = lambda *names: np.isin(kinds, [CLASS_NAMES.index(name) for name in names])  # noqa: E731
    houses, near, goals = named("house", "garage door"), named("driveway", "path"), named("front_door")
    ground = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
    planes = np.stack([
        ~seen, seen & ~ground & ~houses, houses, named("driveway"), named("path"), ground & ~near & ~goals, goals,
        visited, candidates.any(axis=0),
    ])  # fmt: skip

    def share(x, y, side):
        top, left = max(0, y - side // 2), max(0, x - side // 2)
        return planes[:, top : max(0, y + side // 2 + 1), left : max(0, x + side // 2 + 1)].sum((1, 2)) / side**2

    blocks = plain_blocks(pose, terrain.shape)
    revealed = np.stack([oracle._counts(~seen, oracle.sensing_offsets(SENSING, heading)) for heading in range(4)])
    shares = np.array([share(*block) for block in middles(pose)])
    subgoals, present = np.zeros((36, 22)), np.zeros(36, bool)
    for block in range(36):
        own = np.argwhere(candidates & (distance >= 0) & (blocks == block))
        if not len(own):
            continue
        heading, y, x = min(own.tolist(), key=lambda one: (distance[tuple(one)], *one[1:], one[0]))
        way = distance[heading, y, x]
        numbers = [1, way / 100, np.log1p(way) / 5, revealed[heading, y, x] / 50]
        subgoals[block], present[block] = np.concatenate([share(x, y, 3), share(x, y, 9), numbers]), True
    return shares, subgoals, present


def plain_logits(weights, hidden, shares, subgoals, present):
    """The network, and the next state of its recurrent layer."""
    layer = lambda name, values: values @ weights[name]["kernel"] + weights[name].get("bias", 0)  # noqa: E731
    logistic = lambda values: 1 / (1 + np.exp(-values))  # noqa: E731
    seen, cell = np.maximum(0, layer("look", shares.reshape(-1))), weights["memory"]
    of_input, of_state = seen @ cell["dense_i"]["kernel"] + cell["dense_i"]["bias"], hidden @ cell["dense_h"]["kernel"]
    (reset_i, update_i, new_i), (reset_h, update_h, new_h) = np.split(of_input, 3), np.split(of_state, 3)
    update = logistic(update_i + update_h)
    hidden = (1 - update) * np.tanh(new_i + logistic(reset_i + reset_h) * new_h) + update * hidden
    numbers = np.hstack([shares, subgoals, np.eye(36)])
    rated = np.maximum(0, layer("subgoal", numbers) + layer("context", hidden))
    return np.where(present, (layer("rating", rated) + layer("direct", numbers))[:, 0], -1e9), hidden


def test_it_heads_for_the_block_that_the_network_prefers():
    """What it sees, remembers and prefers, and the candidates it then takes, at random moments."""
    weights = read_policy()
    policy, several = RecurrentPolicy(RULES), 0
    see = jax.jit(functools.partial(policy_inputs, sensing=RULES.sensing))
    prepare, rate = jax.jit(policy.prepare), jax.jit(policy.score)
    for seed in range(12):
        belief, situation, plain = moment_of(seed, policy)
        seen = see(belief, situation)
        expected = plain_surroundings(*plain)
        for found, wanted in zip(seen, expected, strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6)
        present = expected[-1]
        hidden = np.random.default_rng(seed).normal(size=64).astype(np.float32)
        situation = situation._replace(estimator=situation.estimator._replace(hidden=jnp.asarray(hidden)))
        memory = prepare(belief, situation)
        logits, hidden = plain_logits(weights, hidden, *expected)
        np.testing.assert_allclose(memory.hidden, hidden, rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(memory.logits, logits, rtol=1e-3, atol=1e-3)
        score = rate(belief, situation._replace(estimator=memory))
        blocks = plain_blocks(plain[2], plain[0].shape)
        np.testing.assert_allclose(score, np.broadcast_to(-logits[blocks], score.shape), rtol=1e-3, atol=1e-3)
        several += present.sum() > 2
    assert several > 4
