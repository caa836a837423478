"""Training pairs: masks hide, labels are exact, symmetries agree; and the masks a moving robot makes."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.grid import bitboard, gridworld, poses
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import field_of_view, line_of_sight
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import Frontier
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.rollouts.rollout import rollout
from dc2g_jax._src.runtime.devices import mesh_of
from dc2g_jax._src.training import masks
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.masks import View, by_house, collect_masks, moments_along
from dc2g_jax._src.training.pairs import SYMMETRY_COUNT, Pair, TrainingSet, jittered, make_pair
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps

N_WORLDS, N_MASKS, N_OWN = 4, 30, 12


def training_set(shape: tuple[int, int]) -> tuple[TrainingSet, np.ndarray]:
    """Random worlds under random masks, and the masks as boolean grids."""
    terrains = np.stack([maps.random_terrain(seed, shape, 0.75) for seed in range(N_WORLDS)])
    owners = np.sort(np.random.default_rng(0).integers(N_WORLDS, size=N_MASKS))
    seen = np.stack([maps.random_cells(seed, shape, (0.3, 0.7, 0.97)[seed % 3]) for seed in range(N_MASKS)])
    data = TrainingSet(
        terrain=jnp.asarray(terrains),
        cost_to_go=jnp.stack([world_cost_to_go(World.from_terrain(terrain)) for terrain in terrains]),
        masks=jax.vmap(bitboard.pack)(jnp.asarray(seen)),
        mask_world=jnp.asarray(owners, jnp.int32),
        n_own=jnp.int32(N_OWN),
    )
    return data, seen


@functools.cache
def pair_maker(edge_weight: float = 4.0, edge_width: int = 2, half_weight_cost: float = np.inf):
    make = functools.partial(
        make_pair, edge_weight=edge_weight, edge_width=edge_width, half_weight_cost=half_weight_cost
    )
    return jax.jit(jax.vmap(make, in_axes=(None, 0, 0)))


def near(cells: np.ndarray, distance: int) -> np.ndarray:
    padded = np.pad(cells, distance)
    size = 2 * distance + 1
    return np.lib.stride_tricks.sliding_window_view(padded, (size, size)).any(axis=(2, 3))


@pytest.mark.parametrize("shape", [(12, 12), (7, 33)], ids="{0[0]}x{0[1]}".format)
@pytest.mark.parametrize("edge_width", [1, 2])
def test_pairs(shape, edge_width):
    data, seen = training_set(shape)
    pairs = pair_maker(4.0, edge_width)(data, jnp.arange(N_MASKS), jnp.zeros(N_MASKS, jnp.int32))
    assert (pairs.terrain.dtype, pairs.target.dtype, pairs.weight.dtype) == (np.uint8, np.float32, np.float32)
    for index in range(N_MASKS):
        world = int(data.mask_world[index])
        terrain, cost = np.asarray(data.terrain[world]), np.asarray(data.cost_to_go[world])
        # A mask only hides.
        np.testing.assert_array_equal(pairs.terrain[index], np.where(seen[index], terrain, 0))
        # Labels are those of the whole map.
        counts = np.asarray(pairs.weight[index]) > 0
        np.testing.assert_array_equal(counts, seen[index] & np.isfinite(cost))
        np.testing.assert_array_equal(np.asarray(pairs.target[index])[counts], cost[counts])
        weight = np.where(near(~seen[index], edge_width), 4.0, 1.0) * counts
        np.testing.assert_array_equal(pairs.weight[index], weight)


def test_cells_far_from_a_goal_count_less():
    data, _ = training_set((12, 12))
    numbers, straight = jnp.arange(N_MASKS), jnp.zeros(N_MASKS, jnp.int32)
    alike = pair_maker()(data, numbers, straight)
    fading = pair_maker(half_weight_cost=5.0)(data, numbers, straight)
    weight, target = np.asarray(alike.weight), np.asarray(alike.target)
    expected = np.where(weight > 0, weight * 5 / (5 + np.where(weight > 0, target, 0)), 0)
    np.testing.assert_allclose(fading.weight, expected, rtol=1e-6)
    assert len(np.unique(expected)) > 5


def test_labels_do_not_depend_on_what_is_hidden(street):
    """The cost is of the hidden map, so a visible cell keeps its label under every mask."""
    cost = np.asarray(world_cost_to_go(World.from_terrain(street)))
    masks = np.stack([maps.random_cells(seed, street.shape, 0.5) for seed in range(8)])
    data = TrainingSet(
        terrain=jnp.asarray(street)[None],
        cost_to_go=jnp.asarray(cost)[None],
        masks=jax.vmap(bitboard.pack)(jnp.asarray(masks)),
        mask_world=jnp.zeros(8, jnp.int32),
        n_own=jnp.int32(8),
    )
    pairs = pair_maker()(data, jnp.arange(8), jnp.zeros(8, jnp.int32))
    for index in range(8):
        counts = np.asarray(pairs.weight[index]) > 0
        assert counts.any()
        np.testing.assert_array_equal(np.asarray(pairs.target[index])[counts], cost[counts])


def test_all_symmetries_are_distinct_and_turn_everything_alike():
    data, _ = training_set((12, 12))
    index = 2
    pairs = pair_maker()(data, jnp.full(SYMMETRY_COUNT, index), jnp.arange(SYMMETRY_COUNT))
    terrain, target, weight = (np.asarray(part) for part in (pairs.terrain, pairs.target, pairs.weight))
    assert len({grid.tobytes() for grid in terrain}) == 8
    assert len({grid.tobytes() for grid in target}) == 8
    # One of the eight ways to turn and mirror a square, the same one for all three grids.
    ways = [lambda g, k=k, f=f: np.rot90(g[:, ::-1] if f else g, k) for k in range(4) for f in (False, True)]
    used = set()
    for symmetry in range(SYMMETRY_COUNT):
        matching = [
            number
            for number, way in enumerate(ways)
            if np.array_equal(way(terrain[0]), terrain[symmetry])
            and np.array_equal(way(target[0]), target[symmetry])
            and np.array_equal(way(weight[0]), weight[symmetry])
        ]
        assert len(matching) == 1
        used.update(matching)
    assert used == set(range(8))


def test_cost_to_go_of_a_turned_map_is_the_turned_cost_to_go():
    data, _ = training_set((12, 12))
    full = TrainingSet(
        terrain=data.terrain,
        cost_to_go=data.cost_to_go,
        masks=jnp.asarray(bitboard.full(12, 12))[None],
        mask_world=jnp.zeros(1, jnp.int32),
        n_own=jnp.int32(1),
    )
    pairs = pair_maker()(full, jnp.zeros(SYMMETRY_COUNT, jnp.int32), jnp.arange(SYMMETRY_COUNT))
    costs = jax.jit(world_cost_to_go)(World.from_terrain(jnp.moveaxis(pairs.terrain, 0, -1)))
    np.testing.assert_array_equal(jnp.moveaxis(costs, -1, 0), pairs.target)


@pytest.mark.parametrize("shape", [(12, 12), (7, 33)])
def test_each_symmetry_reverses_columns_then_rows_then_transposes_squares(shape):
    data, _ = training_set(shape)
    pairs = pair_maker()(data, jnp.full(SYMMETRY_COUNT, 1), jnp.arange(SYMMETRY_COUNT))
    assert pairs.terrain.shape == (SYMMETRY_COUNT, *shape)
    assert len({np.asarray(grid).tobytes() for grid in pairs.terrain}) == (8 if shape[0] == shape[1] else 4)
    for grids in (pairs.terrain, pairs.target, pairs.weight):
        for symmetry, grid in enumerate(grids):
            expected = np.asarray(grids[0])
            expected = expected[:, ::-1] if symmetry & 1 else expected
            expected = expected[::-1] if symmetry & 2 else expected
            expected = expected.T if symmetry & 4 and shape[0] == shape[1] else expected
            np.testing.assert_array_equal(grid, expected)


def masks_drawn(data: TrainingSet, batch: Pair) -> list[int]:
    """The mask of each pair of a batch, told by what it shows."""
    every = pair_maker()(data, jnp.repeat(jnp.arange(N_MASKS), 8), jnp.tile(jnp.arange(8), N_MASKS))
    owner = {np.asarray(grid).tobytes(): number // 8 for number, grid in enumerate(every.terrain)}
    return [owner[np.asarray(grid).tobytes()] for grid in batch.terrain]


def draw_with(batch_size: int, **changes):
    """Draws batches of pairs that are not stretched, by default of masked maps."""
    config = DataConfig(**{"half_weight_cost": np.inf, "jitter": 0.0, "whole_share": 0.0, **changes})
    return jax.jit(functools.partial(config.draw_batch, batch_size=batch_size))


@pytest.mark.parametrize(("own_share", "low", "high"), [(1.0, 0, N_OWN), (0.0, N_OWN, N_MASKS)])
def test_batches_are_drawn_from_the_masks_asked_for(own_share, low, high):
    data, _ = training_set((12, 12))
    draw = draw_with(200, own_share=own_share)
    batch = draw(jax.random.key(0), data)
    assert batch.terrain.shape == (200, 12, 12)
    assert set(masks_drawn(data, batch)) == set(range(low, high))
    again = draw(jax.random.key(0), data)
    jax.tree.map(np.testing.assert_array_equal, again, batch)
    other = draw(jax.random.key(1), data)
    assert not np.array_equal(other.terrain, batch.terrain)


@pytest.mark.parametrize("n_own", [0, N_MASKS])
def test_masks_of_one_kind_are_all_drawn_alike(n_own):
    data, _ = training_set((12, 12))
    data = dataclasses.replace(data, n_own=jnp.int32(n_own))
    batch = draw_with(64 * N_MASKS, own_share=0.4)(jax.random.key(0), data)
    drawn = np.bincount(masks_drawn(data, batch), minlength=N_MASKS)
    assert drawn.min() > 32
    assert drawn.max() < 128


def test_a_share_of_pairs_shows_the_whole_map():
    data, _ = training_set((12, 12))
    batch = draw_with(400, whole_share=0.25)(jax.random.key(0), data)
    whole = np.asarray((batch.terrain != 0).all(axis=(1, 2)))
    assert 60 < whole.sum() < 140
    weight = np.asarray(batch.weight)
    assert set(np.unique(weight[whole])) == {0.0, 1.0}
    assert (weight[~whole] == 4).any()


def test_jitter_stretches_and_moves_a_map_with_its_labels():
    shape = (20, 33)
    terrain = maps.random_terrain(0, shape, 0.7)
    y, x = np.indices(shape)
    # The label tells where a cell is from.
    place = (100.0 * y + x).astype(np.float32)
    pair = Pair(terrain=jnp.asarray(terrain), target=jnp.asarray(place), weight=jnp.ones(shape))
    keys = jax.random.split(jax.random.key(0), 60)
    made = jax.jit(jax.vmap(functools.partial(jittered, jitter=0.2), in_axes=(0, None)))(keys, pair)
    unchanged = 0
    for grid, target, weight in zip(
        *(np.asarray(part) for part in (made.terrain, made.target, made.weight)), strict=True
    ):
        there = weight > 0
        np.testing.assert_array_equal(grid[~there], 0)
        if there.all() and np.array_equal(target, place):
            unchanged += 1
            np.testing.assert_array_equal(grid, terrain)
            continue
        # One factor for all labels; with it taken out, each says which cell of the map it belongs to.
        factors = np.exp(np.linspace(-0.2, 0.2, 4001))
        rows = target[there][:, None] / factors / 100
        factor = factors[np.argmin(np.abs(rows * 100 - np.round(rows * 100)).max(axis=0))]
        source = np.round(target / factor).astype(int)
        np.testing.assert_array_equal(grid[there], terrain[source // 100, source % 100][there])
        assert (np.diff(source // 100, axis=0)[there[1:] & there[:-1]] >= 0).all()
        assert (np.diff(source % 100, axis=1)[there[:, 1:] & there[:, :-1]] >= 0).all()
    assert 10 < unchanged < 50


# --- masks of moving robots -------------------------------------------------------------------------------


@pytest.mark.parametrize("view", [field_of_view, line_of_sight])
@pytest.mark.parametrize("shape", [(12, 12), (7, 33)], ids="{0[0]}x{0[1]}".format)
def test_moments_equal_stepping_the_gridworld(shape, view):
    sensing = view(3)
    along = jax.jit(functools.partial(moments_along, sensing=sensing))
    step = jax.jit(functools.partial(gridworld.step, sensing=sensing))
    exploring = []
    for seed in range(6):
        terrain = maps.random_terrain(seed, shape, 0.85, doors=4)
        world = World.from_terrain(terrain)
        pose = maps.random_pose(seed, np.isin(terrain, oracle.TRAVERSABLE_CLASSES))
        actions = np.random.default_rng(seed).choice([0, 0, 0, 1, 2], 20).astype(np.int8)
        times = np.array([0, 20, 7, 7, 1, 19])
        moments = along(world, make_pose(*pose), jnp.asarray(actions), jnp.asarray(times))
        beliefs = [gridworld.reset(world, make_pose(*pose), sensing)]
        for action in actions:
            beliefs.append(step(world, beliefs[-1], jnp.int32(action)))
        for seen, in_question, time in zip(moments.seen, moments.exploring, times, strict=True):
            belief = beliefs[time]
            np.testing.assert_array_equal(seen, belief.seen)
            free = np.asarray(bitboard.unpack(belief.traversable, shape[1]))
            reached = oracle.reachable(free, int(belief.pose.x), int(belief.pose.y))
            exploring.append(bool(in_question))
            assert exploring[-1] == (not (reached & (terrain == oracle.FRONT_DOOR)).any())
    assert any(exploring)
    assert not all(exploring)


@pytest.mark.parametrize("degrees", [90, 300, 360])
def test_one_program_has_fields_of_view_of_several_ranges(degrees):
    ranges, shape, width = (1, 2, 5), (9, 33), 33

    @jax.jit
    def look(number, pose, cells):
        view, board = View(number, ranges, degrees), bitboard.pack(cells)
        return (
            bitboard.unpack(view.visible(pose, board, width), width),
            poses.unpack(view.poses_that_see(board, board), width),
        )

    for seed, (number, reach) in enumerate(enumerate(ranges)):
        cells, pose = maps.random_cells(seed, shape, 0.05), maps.random_pose(seed, np.ones(shape, bool))
        seen, seeing = look(jnp.int32(number), make_pose(*pose), cells)
        np.testing.assert_array_equal(seen, oracle.visible(pose, reach, shape, degrees))
        for heading in range(4):
            wanted = oracle._sources(cells, oracle.sensing_offsets(reach, heading, degrees))
            np.testing.assert_array_equal(seeing[heading], wanted)


def test_masks_collected_along_paths(street, island, monkeypatch):
    rules = complete_rules(2)
    planner = Frontier(rules)
    worlds = World.from_terrain(np.stack([street, island], axis=-1))
    # More episodes than are looked at in one call.
    count = 130
    index = np.arange(count) % 2
    x = np.arange(count) % 10
    episodes = jnp.asarray(index), make_pose(x, np.where(index == 0, 4, 7), np.arange(count) % 4)
    options = {"sensing": rules.sensing, "step_limit": 40}
    collected = collect_masks(planner, worlds, *episodes, per_episode=3, seed=1, **options)
    assert len(collected.boards) == len(collected.world) > count
    assert set(np.unique(collected.world)) == {0, 1}
    # On the island no goal is ever in reach, so every moment counts.
    assert np.sum(collected.world == 1) == 3 * np.sum(index == 1)

    done = rollout(planner, worlds, *episodes, **options)
    walked = {0: set(), 1: set()}
    for number in range(count):
        pose = (int(x[number]), 4 if index[number] == 0 else 7, number % 4)
        seen = oracle.visible(pose, 2, street.shape)
        walked[index[number]].add(seen.tobytes())
        for action in done.actions[number, : done.steps[number]]:
            pose = oracle.moved(pose, int(action), street.shape)
            seen |= oracle.visible(pose, 2, street.shape)
            walked[index[number]].add(seen.tobytes())
    for board, world in zip(collected.boards, collected.world, strict=True):
        assert np.asarray(bitboard.unpack(jnp.asarray(board), 10)).tobytes() in walked[int(world)]

    monkeypatch.setattr(masks, "mesh_of", lambda: mesh_of(jax.devices()[:1]))
    again = collect_masks(planner, worlds, *episodes, per_episode=3, seed=1, **options)
    jax.tree.map(np.testing.assert_array_equal, tuple(again), tuple(collected))
    both = by_house([collected, again])
    np.testing.assert_array_equal(both.world, np.sort(np.concatenate([collected.world] * 2)))
    of_worlds = [np.concatenate([collected.boards[collected.world == world]] * 2) for world in (0, 1)]
    np.testing.assert_array_equal(both.boards, np.concatenate(of_worlds))


def test_map_noise_changes_some_observed_cells_and_nothing_else():
    data, _ = training_set((12, 12))
    clean, noisy = (draw_with(200, map_noise=level)(jax.random.key(0), data) for level in (0.0, 2.0))
    np.testing.assert_array_equal(noisy.target, clean.target)
    np.testing.assert_array_equal(noisy.weight, clean.weight)
    before, after = np.asarray(clean.terrain), np.asarray(noisy.terrain)
    assert not after[before == 0].any()
    changed = np.mean((after != before)[before > 0])
    assert 0.005 < changed < 0.1
    assert np.any((after == 0) & (before > 0))
