import copy

import hypothesis
import hypothesis.extra.numpy
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st

from dc2g_jax._src.grid.gridworld import belief_from_map
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.terrain import CAR, CLASS_NAMES, DRIVEWAY, GRASS, HOUSE, ROAD
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, intrinsics, level_camera, points, rays
from dc2g_jax.robot.mapping.semantic_map import (
    HIGHEST,
    LOWEST,
    MOST_CONFIDENT,
    UNSEEN,
    MapSettings,
    SemanticMap,
    empty_map,
    integrate,
    terrain_map,
)
from tests.oracles.semantic_map_oracle import OracleMap
from tests.support.frames import CAMERA, FINE, SETTINGS, camera_matrix, random_frame
from tests.support.refusals import refusal

NOTHING = CLASS_NAMES.index("nothing")

integrated = jax.jit(integrate)
seen_from_above = jax.jit(terrain_map)


def assert_equal_maps(one: SemanticMap, other: SemanticMap) -> None:
    np.testing.assert_array_equal(one.log_odds, other.log_odds)
    np.testing.assert_array_equal(one.votes, other.votes)


def looking_at(classes: int, depth: float, pose: CameraPose) -> Frame:
    """A frame that shows one class at one depth everywhere."""
    shape = (CAMERA.height, CAMERA.width)
    return Frame(jnp.full(shape, depth, jnp.float32), jnp.full(shape, classes, jnp.uint8), pose)


#: From the middle of the map, level and half way up, to the east; the axis goes through the middles of voxels.
EASTWARD = level_camera(5.25, -4.25, 0.8, 0.0)


def oracle(settings: MapSettings) -> OracleMap:
    fields = ("rows", "columns", "cell_size", "levels", "level_height", "reach", "inset", "clearance")
    return OracleMap(**{name: getattr(settings, name) for name in fields})


def taken_in(expected: OracleMap, frame: Frame) -> OracleMap | None:
    """The oracle's map after one more frame, unless rounding could make a difference."""
    after = copy.deepcopy(expected)
    after.integrate(
        np.asarray(frame.depth, np.float64),
        np.asarray(frame.classes),
        camera_matrix(CAMERA),
        np.asarray(frame.pose.position, np.float64),
        np.asarray(frame.pose.rotation, np.float64),
    )
    return after if after.close_calls == 0 else None


@pytest.mark.parametrize(("seed", "settings"), [(0, SETTINGS), (1, FINE), (2, FINE)])
def test_equals_the_oracle_voxel_by_voxel(seed, settings):
    rng = np.random.default_rng(seed)
    semantic_map, expected, frames = empty_map(settings), oracle(settings), 0
    while frames < 12:
        frame = random_frame(rng, settings)
        after = taken_in(expected, frame)
        if after is None:
            continue
        semantic_map, expected, frames = integrated(semantic_map, frame, CAMERA, settings), after, frames + 1
        evidence, classes, confidence = expected.dense()
        np.testing.assert_array_equal(semantic_map.log_odds, evidence)
        np.testing.assert_array_equal(semantic_map.classes, classes)
        np.testing.assert_array_equal(semantic_map.confidence, confidence)
        np.testing.assert_array_equal(seen_from_above(semantic_map, settings), expected.terrain())
    # The frames have shown something of every kind.
    assert (evidence > 0).sum() > 150
    assert ((evidence <= 0) & (evidence > UNSEEN)).sum() > 50
    assert (evidence == UNSEEN).sum() > 150
    assert confidence.max() > 1
    assert len(np.unique(expected.terrain())) > 5


def test_log_odds_are_clamped_and_something_gone_takes_nine_misses():
    near, far = looking_at(CAR, 1.3, EASTWARD), looking_at(HOUSE, 2.8, EASTWARD)
    semantic_map, voxel = empty_map(SETTINGS), (2, 8, 13)
    history = []
    for frame in [near] * 6 + [far] * 15 + [near] * 3:
        semantic_map = integrated(semantic_map, frame, CAMERA, SETTINGS)
        history.append((int(semantic_map.log_odds[voxel]), int(semantic_map.classes[voxel])))
    hits = [(value, CAR) for value in (17, 34, 51, 68, 70, 70)]
    misses = [(70 - 8 * count, CAR if 70 - 8 * count > 0 else 0) for count in range(1, 14)] + [(LOWEST, 0)] * 2
    assert history == hits + misses + [(-23, 0), (-6, 0), (11, CAR)]
    assert semantic_map.log_odds.max() == HIGHEST


def test_the_ground_is_never_missed():
    """Looking down through where it was seen before."""
    down = level_camera(5.25, -4.25, 1.9, 0.0, np.pi / 2)
    before = integrated(empty_map(SETTINGS), looking_at(ROAD, 1.9, down), CAMERA, SETTINGS)
    after = integrated(before, looking_at(0, 3.0, down), CAMERA, SETTINGS)
    assert (before.log_odds[0] > 0).sum() > 10
    np.testing.assert_array_equal(before.log_odds[0], after.log_odds[0])
    assert (after.log_odds[1:] < 0).any()


def test_classes_are_voted_for_by_frames():
    """The first frames' class stands until as many frames have voted against it."""
    voxel = (2, 8, 13)
    semantic_map, history = empty_map(SETTINGS), []
    for label in [CAR, CAR, HOUSE, HOUSE, HOUSE, 0, HOUSE, CAR]:
        semantic_map = integrated(semantic_map, looking_at(label, 1.3, EASTWARD), CAMERA, SETTINGS)
        history.append((int(semantic_map.classes[voxel]), int(semantic_map.confidence[voxel])))
    assert history == [(CAR, 1), (CAR, 2), (CAR, 1), (CAR, 0), (HOUSE, 1), (HOUSE, 1), (HOUSE, 2), (HOUSE, 1)]


def test_confidence_saturates():
    """However long a class was seen, another takes its place after so many frames."""
    voxel = (2, 8, 13)
    semantic_map = empty_map(SETTINGS)
    for _ in range(40):
        semantic_map = integrated(semantic_map, looking_at(CAR, 1.3, EASTWARD), CAMERA, SETTINGS)
    assert semantic_map.confidence[voxel] == MOST_CONFIDENT
    for _ in range(MOST_CONFIDENT):
        semantic_map = integrated(semantic_map, looking_at(HOUSE, 1.3, EASTWARD), CAMERA, SETTINGS)
        assert semantic_map.classes[voxel] == CAR
    semantic_map = integrated(semantic_map, looking_at(HOUSE, 1.3, EASTWARD), CAMERA, SETTINGS)
    assert semantic_map.classes[voxel] == HOUSE


def test_a_frame_votes_for_what_most_of_its_returns_are():
    frame = looking_at(CAR, 1.3, EASTWARD)
    voxel = points(frame.depth, CAMERA, EASTWARD)
    inside = np.floor(np.asarray(voxel) / (0.5, -0.5, 0.4) + (0, 0, 0.5)) == (13, 8, 2)
    rows, columns = np.nonzero(inside.all(axis=-1))
    assert len(rows) > 8
    for houses, expected in ((len(rows) // 2 - 1, CAR), (len(rows) // 2 + 1, HOUSE)):
        classes = np.asarray(frame.classes).copy()
        classes[rows[:houses], columns[:houses]] = HOUSE
        found = integrated(empty_map(SETTINGS), frame.replace(classes=jnp.asarray(classes)), CAMERA, SETTINGS)
        assert found.classes[2, 8, 13] == expected


def test_a_wall_on_the_border_of_two_cells_belongs_to_the_farther():
    """The camera stands at x 5.25, the wall at 6.5, where cell 13 begins."""
    found = integrated(empty_map(SETTINGS), looking_at(HOUSE, 1.25, EASTWARD), CAMERA, SETTINGS)
    columns = np.unique(np.nonzero(np.asarray(found.occupied))[2])
    assert columns.tolist() == [13]


def column(*voxels: tuple[int, int, int]) -> SemanticMap:
    """A map whose first cell holds voxels given as level, class and confidence, and nothing else."""
    semantic_map = empty_map(SETTINGS)
    log_odds, votes = np.array(semantic_map.log_odds), np.array(semantic_map.votes)
    for level, index, confidence in voxels:
        log_odds[level, 0, 0], votes[level, 0, 0] = 17, index << 4 | confidence
    return SemanticMap(jnp.asarray(log_odds), jnp.asarray(votes))


@pytest.mark.parametrize(
    ("voxels", "expected"),
    [
        ([], 0),
        ([(0, ROAD, 3)], ROAD),
        ([(0, 0, 0)], 0),
        ([(0, ROAD, 15), (1, CAR, 1)], CAR),
        ([(2, CAR, 1)], CAR),
        ([(0, ROAD, 15), (1, 0, 0)], NOTHING),
        ([(1, 0, 0), (2, CAR, 0)], CAR),
        ([(1, CAR, 3), (2, HOUSE, 1), (3, HOUSE, 1)], CAR),
        ([(1, CAR, 3), (2, HOUSE, 1), (3, HOUSE, 2)], HOUSE),
        # Levels are 0.4 m apart, the first but the ground's begins at 0.2 m: the fourth at 1.4, above the clearance.
        ([(0, ROAD, 3), (4, HOUSE, 15)], ROAD),
        ([(4, HOUSE, 15)], 0),
        ([(0, ROAD, 3), (3, HOUSE, 15)], HOUSE),
    ],
)
def test_terrain_of_a_column(voxels, expected):
    picture = seen_from_above(column(*voxels), SETTINGS)
    assert picture.dtype == jnp.uint8
    assert picture.shape == (17, 20)
    assert picture[0, 0] == expected
    assert (np.asarray(picture).ravel()[1:] == 0).all()


def test_free_voxels_above_the_ground_are_no_obstacle():
    semantic_map = column((0, GRASS, 1))
    free = semantic_map.replace(log_odds=semantic_map.log_odds.at[1:, 0, 0].set(LOWEST))
    assert seen_from_above(free, SETTINGS)[0, 0] == GRASS


def test_the_map_is_in_the_rows_and_columns_of_the_grid():
    """A camera that looks straight down from the middle of each cell in turn."""
    settings = MapSettings(rows=3, columns=4, cell_size=1.0)
    terrain = np.arange(1, 13, dtype=np.uint8).reshape(3, 4)
    camera = intrinsics(40.0, 8, 8)
    semantic_map = empty_map(settings)
    take = jax.jit(integrate)
    for row, column_index in np.ndindex(3, 4):
        pose = level_camera(column_index + 0.5, -(row + 0.5), 1.0, 0.3, np.pi / 2)
        frame = Frame(jnp.ones((8, 8)), jnp.full((8, 8), terrain[row, column_index]), pose)
        semantic_map = take(semantic_map, frame, camera, settings)
    found = terrain_map(semantic_map, settings)
    np.testing.assert_array_equal(found, terrain)
    belief = belief_from_map(found, make_pose(x=2, y=1, heading=0))
    np.testing.assert_array_equal(belief.terrain, terrain)


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, np.pi, -np.pi / 2])
def test_points_off_the_map_are_dropped(yaw):
    """From just inside each edge, outward: nothing appears on the other side, nor anywhere else."""
    x = {0.0: 9.9, np.pi: 0.1}.get(yaw, 5.0)
    y = {np.pi / 2: -0.1, -np.pi / 2: -8.4}.get(yaw, -4.0)
    before = empty_map(SETTINGS)
    after = integrated(before, looking_at(HOUSE, 1.5, level_camera(x, y, 0.8, yaw)), CAMERA, SETTINGS)
    assert not after.occupied.any()
    ground_and_sky = [looking_at(HOUSE, 2.5, level_camera(5.0, -4.0, 1.2, yaw, pitch)) for pitch in (1.5, -1.5)]
    for frame in ground_and_sky:
        assert not integrated(before, frame, CAMERA, SETTINGS).occupied.any()


def test_returns_out_of_reach_are_skipped():
    before = empty_map(SETTINGS)
    assert_equal_maps(integrated(before, looking_at(HOUSE, 3.2, EASTWARD), CAMERA, SETTINGS), before)


images = hypothesis.extra.numpy.arrays(
    np.float32, (CAMERA.height, CAMERA.width), elements=st.floats(width=32), fill=st.floats(-1, 4, width=32)
)
labels = hypothesis.extra.numpy.arrays(np.uint8, (CAMERA.height, CAMERA.width))


@hypothesis.given(images, labels, st.integers(0, 100))
@hypothesis.settings(max_examples=60)
def test_garbage_leaves_the_map_sound(depth, classes, seed):
    """Evidence stays in its bounds, what cannot be seen stays as it was, and unusable pixels are as good as absent."""
    rng = np.random.default_rng(seed)
    pose = random_frame(rng).pose
    before = integrated(empty_map(SETTINGS), random_frame(rng), CAMERA, SETTINGS)
    after = integrated(before, Frame(jnp.asarray(depth), jnp.asarray(classes), pose), CAMERA, SETTINGS)
    evidence = np.asarray(after.log_odds)
    assert ((evidence == UNSEEN) | ((evidence >= LOWEST) & (evidence <= HIGHEST))).all()
    assert (np.asarray(after.votes)[evidence <= 0] == 0).all()

    level, row, column_index = np.indices(SETTINGS.shape)
    centers = np.stack([(column_index + 0.5) * 0.5, -(row + 0.5) * 0.5, level * 0.4], axis=-1)
    offset = centers - np.asarray(pose.position)
    ahead, radius = offset @ np.asarray(pose.rotation)[:, 2], np.hypot(0.5 * np.sqrt(0.5), 0.2) + 0.05
    unseen = (ahead < -radius) | (np.linalg.norm(offset, axis=-1) > SETTINGS.reach + radius)
    assert unseen.any()
    np.testing.assert_array_equal(evidence[unseen], np.asarray(before.log_odds)[unseen])
    np.testing.assert_array_equal(np.asarray(after.votes)[unseen], np.asarray(before.votes)[unseen])

    lengths = np.linalg.norm(rays(CAMERA, pose), axis=-1)
    with np.errstate(all="ignore"):
        usable = (depth > 0) & (depth * lengths < SETTINGS.reach + 1e-3)
    cleaned = Frame(jnp.asarray(np.where(usable, depth, 0)), jnp.asarray(np.where(classes < 16, classes, 0)), pose)
    assert_equal_maps(integrated(before, cleaned, CAMERA, SETTINGS), after)


@hypothesis.given(
    hypothesis.extra.numpy.arrays(np.float32, 3, elements=st.floats(width=32)),
    hypothesis.extra.numpy.arrays(np.float32, (3, 3), elements=st.floats(width=32)),
)
@hypothesis.settings(max_examples=60)
def test_garbage_poses_leave_the_map_sound(position, rotation):
    before = integrated(empty_map(SETTINGS), random_frame(np.random.default_rng(0)), CAMERA, SETTINGS)
    pose = CameraPose(jnp.asarray(position), jnp.asarray(rotation))
    after = integrated(before, looking_at(HOUSE, 1.3, pose), CAMERA, SETTINGS)
    evidence = np.asarray(after.log_odds)
    assert ((evidence == UNSEEN) | ((evidence >= LOWEST) & (evidence <= HIGHEST))).all()
    if not (np.isfinite(position).all() and np.isfinite(rotation).all()):
        assert_equal_maps(after, before)


def test_many_robots_are_each_their_own():
    rng = np.random.default_rng(5)
    frames = [random_frame(rng) for _ in range(4)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *frames)
    maps = jax.vmap(lambda _: empty_map(SETTINGS))(jnp.arange(4))
    together = jax.jit(jax.vmap(integrate, in_axes=(0, 0, None, None)))(maps, stacked, CAMERA, SETTINGS)
    for index, frame in enumerate(frames):
        alone = integrated(empty_map(SETTINGS), frame, CAMERA, SETTINGS)
        assert_equal_maps(jax.tree.map(lambda leaf, index=index: leaf[index], together), alone)


def test_types_stay_what_they_are():
    before = empty_map(SETTINGS)
    after = jax.eval_shape(integrate, before, looking_at(HOUSE, 1.3, EASTWARD), CAMERA, SETTINGS)
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (old.shape, old.dtype, old.weak_type) == (new.shape, new.dtype, new.weak_type)


def test_memory_of_a_map():
    """As the module says: two bytes a voxel."""
    small = empty_map(MapSettings(rows=50, columns=50, cell_size=1.0))
    assert sum(leaf.nbytes for leaf in jax.tree.leaves(small)) == 80_000
    assert MapSettings(rows=1, columns=1, cell_size=1.0).levels * 0.25 == 4.0


def test_maps_of_too_many_voxels_are_refused():
    refusal(lambda: empty_map(SETTINGS.replace(rows=30_000, columns=30_000)), (6, 30_000, 30_000), "fewer")


def test_frames_and_maps_of_another_size_are_refused():
    frame = looking_at(HOUSE, 1.3, EASTWARD)
    wrong = frame.replace(depth=frame.depth[:-1])
    refusal(lambda: integrated(empty_map(SETTINGS), wrong, CAMERA, SETTINGS), "depth", (17, 28), (18, 28))
    other = SETTINGS.replace(rows=18)
    refusal(lambda: integrated(empty_map(SETTINGS), frame, CAMERA, other), "the map", (6, 17, 20), (6, 18, 20))


def test_occupancy_is_that_of_octomap():
    """The same clouds into OctoMap: the same voxels occupied above the ground, and none free here that is not there.

    On the ground, all that is occupied there is so here; OctoMap wears some of it away where rays graze it.
    """
    octomap = pytest.importorskip("octomap", reason="octomap-python is not installed")
    settings = MapSettings(rows=32, columns=32, cell_size=0.25, levels=12, level_height=0.25, reach=20.0, inset=0.0)
    camera, tree, semantic_map = intrinsics(70.0, 72, 96), octomap.OcTree(0.25), empty_map(settings)
    level, row, column_index = np.indices(settings.shape)
    centers = np.stack([(column_index + 0.5) * 0.25, -(row + 0.5) * 0.25, (level + 0.5) * 0.25], axis=-1)
    for step in range(6):
        pose = level_camera(1.1 + 0.3 * step, -4.1, 0.93, 0.3 - 0.1 * step, 0.25)
        directions = np.asarray(rays(camera, pose))
        to_ground = np.where(directions[..., 2] < 0, -0.93 / np.minimum(directions[..., 2], -1e-6), np.inf)
        to_wall = (7.1 - float(pose.position[0])) / np.maximum(directions[..., 0], 1e-6)
        depth = jnp.asarray(np.minimum(to_ground, to_wall), jnp.float32)
        frame = Frame(depth, jnp.full(depth.shape, DRIVEWAY, jnp.uint8), pose)
        semantic_map = jax.jit(integrate)(semantic_map, frame, camera, settings)
        # Our lowest level is centered on the ground; OctoMap's voxels begin there.
        lift = np.array([0, 0, 0.125])
        cloud = np.asarray(points(depth, camera, pose), np.float64).reshape(-1, 3) + lift
        tree.insertPointCloud(cloud, np.asarray(pose.position, np.float64) + lift)
        known = tree.getLabels(centers.reshape(-1, 3)).reshape(settings.shape)
        occupied = np.asarray(semantic_map.occupied)
        np.testing.assert_array_equal(occupied[1:], known[1:] == 1)
        assert occupied[0][known[0] == 1].all()
        assert occupied[1:].sum() > 20
        free = np.asarray((semantic_map.log_odds <= 0) & (semantic_map.log_odds > UNSEEN))
        assert (known[free] == 0).all()
    assert free.sum() > 0.7 * (known[1:] == 0).sum()
