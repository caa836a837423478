"""Frontiers by either rule against their plain definitions."""

import functools

import jax
import numpy as np
import pytest
from hypothesis import given, settings

from dc2g_jax._src.grid import bitboard, poses
from dc2g_jax._src.grid.sensing import expanding_kernel, field_of_view
from dc2g_jax._src.planning import frontiers
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps
from tests.support.exploration import EXPANDING, SENSING, belief_of, random_moment


@functools.cache
def frontier_sets(width: int, degrees: float = 90):
    def run(terrain, seen, pose):
        belief = belief_of(terrain, seen, pose)
        robot = bitboard.single(belief.pose.x, belief.pose.y, *belief.seen.shape)
        reachable = bitboard.flood(robot, belief.traversable)
        boards = (reachable, frontiers.frontier_cells(belief, reachable))
        pose_sets = (
            frontiers.complete(belief, reachable, field_of_view(SENSING, degrees)),
            frontiers.reference(belief, reachable, expanding_kernel(EXPANDING)),
        )
        unpacked = [bitboard.unpack(board, width) for board in boards] + [poses.unpack(p, width) for p in pose_sets]
        return unpacked, (*boards, *pose_sets)

    return jax.jit(run)


@pytest.mark.parametrize("shape", maps.SHAPES[::2], ids="{0[0]}x{0[1]}".format)
@given(seed=maps.seeds, density=maps.densities)
@settings(max_examples=25)
def test_both_rules(shape, seed, density):
    terrain, seen, pose = random_moment(seed, shape, density)
    sets, boards = frontier_sets(shape[1])(terrain, seen, pose)
    reached, cells, complete, reference = map(np.asarray, sets)

    wanted = oracle.reachable(seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES), *pose[:2])
    np.testing.assert_array_equal(reached, wanted)
    np.testing.assert_array_equal(cells, oracle.frontier_complete(seen, wanted))
    np.testing.assert_array_equal(complete, oracle.frontier_expanding_complete(seen, wanted, pose, SENSING))
    np.testing.assert_array_equal(reference, oracle.frontier_expanding_reference(seen, wanted, pose, EXPANDING))
    for board in boards:
        assert not (np.asarray(board) & ~bitboard.full(*shape)).any(), "padding must stay zero"


@pytest.mark.parametrize("degrees", [30, 200, 360])
def test_frontiers_of_other_fields_of_view(degrees):
    found = 0
    for seed in range(10):
        terrain, seen, pose = random_moment(seed, (7, 33), 0.75)
        reached, _, complete, _ = map(np.asarray, frontier_sets(33, degrees)(terrain, seen, pose)[0])
        wanted = oracle.frontier_expanding_complete(seen, reached, pose, SENSING, degrees)
        np.testing.assert_array_equal(complete, wanted)
        found += wanted.any()
    assert found


@pytest.mark.parametrize("seed", range(10))
def test_every_complete_pose_reveals_something(seed):
    shape = (7, 33)
    terrain, seen, pose = random_moment(seed, shape, 0.75)
    complete = np.asarray(frontier_sets(33)(terrain, seen, pose)[0][2])
    for heading, y, x in np.argwhere(complete):
        assert (oracle.visible((int(x), int(y), int(heading)), SENSING, shape) & ~seen).any()


def test_a_map_seen_whole_has_no_frontier(street):
    sets, _ = frontier_sets(10)(street, np.ones_like(street, bool), (0, 4, 0))
    for cells in sets[1:]:
        assert not np.asarray(cells).any()
