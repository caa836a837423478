import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid.label_noise import scaled
from dc2g_jax._src.grid.terrain import CLASS_NAMES, GRASS, ROAD
from dc2g_jax.robot.mapping.camera import Frame, level_camera
from dc2g_jax.robot.mapping.noise import PAPER_LIKE, NoiseLevels, drift_on, drifted, noisy_frame

noisy = jax.jit(noisy_frame)


def frame_of(depth: np.ndarray, classes: np.ndarray) -> Frame:
    pose = level_camera(1.0, -2.0, 1.0, 0.7, 0.2)
    return Frame(depth=jnp.asarray(depth, jnp.float32), classes=jnp.asarray(classes, jnp.uint8), pose=pose)


@pytest.fixture(scope="module")
def frame() -> Frame:
    """A frame with every class, depths up to 8 m, and a sky without return."""
    rng = np.random.default_rng(0)
    depth, classes = rng.uniform(0.5, 8, (60, 80)), rng.integers(1, len(CLASS_NAMES), (60, 80))
    depth[:20], classes[:20] = 0, 0
    return frame_of(depth, classes)


@pytest.mark.parametrize("levels", [NoiseLevels(), scaled(PAPER_LIKE, 0)])
def test_level_0_changes_nothing(frame, levels):
    for seed in range(5):
        key = jax.random.key(seed)
        out, drift = noisy(key, frame, levels), drift_on(key, jnp.zeros(3), levels)
        pose = drifted(frame.pose, drift)
        for got, want in zip(jax.tree.leaves(out.replace(pose=pose)), jax.tree.leaves(frame), strict=True):
            assert got.dtype == want.dtype
            np.testing.assert_array_equal(got, want)


def test_depth_noise_grows_with_the_square_of_depth():
    levels = NoiseLevels(depth=0.0016)
    for depth, spread in ((1.0, 0.0016), (5.0, 0.04), (8.0, 0.1024)):
        out = noisy(jax.random.key(1), frame_of(np.full((200, 200), depth), np.full((200, 200), ROAD)), levels)
        errors = np.asarray(out.depth) - depth
        assert errors.std() == pytest.approx(spread, rel=0.02)
        assert abs(errors.mean()) < 4 * spread / 200


def test_depth_stays_positive_and_what_would_not_is_dropped():
    out = noisy(
        jax.random.key(2), frame_of(np.full((100, 100), 8.0), np.full((100, 100), ROAD)), NoiseLevels(depth=0.2)
    )
    depth, classes = np.asarray(out.depth), np.asarray(out.classes)
    assert depth.min() == 0
    # Of normal errors with standard deviation 12.8 m, this share lies below -8 m.
    assert (depth == 0).mean() == pytest.approx(0.266, abs=0.02)
    np.testing.assert_array_equal(classes == 0, depth == 0)


def test_pixels_without_return_get_none(frame):
    out = noisy(jax.random.key(3), frame, scaled(PAPER_LIKE, 5))
    assert np.all(np.asarray(out.depth)[:20] == 0)
    assert np.all(np.asarray(out.classes)[:20] == 0)


def test_unlabeled_ground_keeps_its_depth():
    out = noisy(jax.random.key(3), frame_of(np.full((50, 50), 2.0), np.zeros((50, 50))), PAPER_LIKE)
    assert np.all(np.asarray(out.classes) == 0)
    assert (np.asarray(out.depth) > 0).mean() == pytest.approx(0.95, abs=0.03)


def test_the_share_of_dropped_pixels(frame):
    out = noisy(jax.random.key(4), frame, NoiseLevels(dropped=0.3))
    dropped = np.asarray(out.depth)[20:] == 0
    assert dropped.mean() == pytest.approx(0.3, abs=0.03)
    np.testing.assert_array_equal(np.asarray(out.classes)[20:] == 0, dropped)
    np.testing.assert_array_equal(np.asarray(out.depth)[20:][~dropped], np.asarray(frame.depth)[20:][~dropped])


@pytest.mark.parametrize("shown", ["house", "front_door", "fence", "traversable"])
def test_mislabeled_pixels_bear_one_of_the_other_classes_all_alike(shown):
    right = CLASS_NAMES.index(shown)
    out = noisy(
        jax.random.key(5), frame_of(np.ones((300, 300)), np.full((300, 300), right)), NoiseLevels(mislabeled=0.2)
    )
    labels = np.asarray(out.classes).ravel()
    assert (labels != right).mean() == pytest.approx(0.2, abs=0.01)
    counts = np.bincount(labels, minlength=16)
    taken_for = ("front_door", "grass", "road", "driveway", "car", "path", "house", "sidewalk")
    wrong = [CLASS_NAMES.index(name) for name in taken_for if name != shown]
    assert counts.sum() == counts[right] + counts[wrong].sum()
    np.testing.assert_allclose(counts[wrong] / counts[wrong].sum(), 1 / len(wrong), atol=0.01)
    np.testing.assert_array_equal(out.depth, 1)


def test_every_label_changed_at_the_full_share_is_wrong(frame):
    out = noisy(jax.random.key(6), frame, NoiseLevels(mislabeled=1.0, blobs=8.0))
    labels, true = np.asarray(out.classes)[20:], np.asarray(frame.classes)[20:]
    assert np.all(labels != true)
    assert set(np.unique(labels)) == set(range(1, 9))


def test_a_blob_is_one_connected_region_of_one_surface_with_one_wrong_class():
    classes = np.full((60, 80), GRASS, np.uint8)
    classes[:, 40:] = ROAD
    regions, across_border = [], 0
    for seed in range(200):
        out = noisy(jax.random.key(seed), frame_of(np.ones((60, 80)), classes), NoiseLevels(blobs=0.5, blob_radius=0.1))
        labels = np.asarray(out.classes)
        changed = labels != classes
        across_border += np.any(changed[:, 39] & changed[:, 40])
        for true in (GRASS, ROAD):
            part = changed & (classes == true)
            count, pieces = cv2.connectedComponents(part.astype(np.uint8), connectivity=4)
            regions += [labels[pieces == piece] for piece in range(1, count)]
            # Radii are 4 to 12 pixels, so no region is larger than such a disc.
            assert all((pieces == piece).sum() <= np.pi * 13**2 for piece in range(1, count))
    # On average half a blob a frame; a few lie over one another.
    assert 70 < len(regions) < 130
    # One in five lies near the border of the two surfaces; only two at once can cover both sides of it.
    assert across_border <= 2
    assert np.mean([len(np.unique(labels)) == 1 for labels in regions]) > 0.9


def test_the_number_of_blobs_grows_with_their_level():
    classes = np.full((60, 80), GRASS, np.uint8)
    shares = []
    for blobs in (0.0, 1.0, 4.0, 8.0):
        levels = NoiseLevels(blobs=blobs)
        changed = [
            np.mean(
                np.asarray(noisy(jax.random.key(seed), frame_of(np.ones((60, 80)), classes), levels).classes) != GRASS
            )
            for seed in range(20)
        ]
        shares.append(np.mean(changed))
    assert shares[0] == 0
    assert np.all(np.diff(shares) > 0)


def test_scaling_leaves_the_size_of_blobs():
    double = scaled(PAPER_LIKE, 2)
    assert double.blob_radius == PAPER_LIKE.blob_radius
    for name in ("depth", "mislabeled", "blobs", "dropped", "position_drift", "yaw_drift"):
        assert getattr(double, name) == 2 * getattr(PAPER_LIKE, name) > 0


def test_many_cameras_at_many_levels_are_as_each_alone(frame):
    keys, levels = jax.random.split(jax.random.key(7), 3), jnp.array([0.0, 0.5, 2.0])
    many = jax.vmap(lambda key, level: noisy_frame(key, frame, scaled(PAPER_LIKE, level)))(keys, levels)
    for index in range(3):
        one = noisy(keys[index], frame, scaled(PAPER_LIKE, levels[index]))
        np.testing.assert_array_equal(many.classes[index], one.classes)
        np.testing.assert_allclose(many.depth[index], one.depth, rtol=1e-6)


def test_drift_is_a_random_walk():
    levels, steps, robots = NoiseLevels(position_drift=0.01, yaw_drift=0.002), 100, 2000

    def walk(key):
        def step(drift, key):
            drift = drift_on(key, drift, levels)
            return drift, drift

        return jax.lax.scan(step, jnp.zeros(3), jax.random.split(key, steps))[1]

    paths = np.asarray(jax.jit(jax.vmap(walk))(jax.random.split(jax.random.key(8), robots)))
    for step in (1, 10, 100):
        np.testing.assert_allclose(
            paths[:, step - 1].std(axis=0), np.array([0.01, 0.01, 0.002]) * np.sqrt(step), rtol=0.06
        )
    still = drift_on(jax.random.key(8), jnp.zeros(3), levels, 0.0)
    assert still.tolist() == [0, 0, 0]
    far = drift_on(jax.random.key(8), jnp.zeros(3), levels, 4.0)
    np.testing.assert_allclose(far, 2 * drift_on(jax.random.key(8), jnp.zeros(3), levels), rtol=1e-6)
    increments = np.diff(paths, axis=1)
    # Steps are independent of one another, and x, y and yaw of each other.
    assert abs(np.corrcoef(increments[:, 0, 0], increments[:, 1, 0])[0, 1]) < 0.08
    assert np.all(np.abs(np.corrcoef(increments[:, 0].T) - np.eye(3)) < 0.08)


def test_a_drifted_camera_is_moved_and_turned_about_the_vertical():
    drift = jnp.array([0.3, -0.2, 0.1])
    got, want = drifted(level_camera(1.0, 2.0, 0.9, 0.4, 0.2), drift), level_camera(1.3, 1.8, 0.9, 0.5, 0.2)
    np.testing.assert_allclose(got.position, want.position, atol=1e-6)
    np.testing.assert_allclose(got.rotation, want.rotation, atol=1e-6)
