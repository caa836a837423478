"""Training samples: what robots saw, labels, symmetries, and the maps that a network is shown."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.training.pairs import turned
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.houses.plans import Furniture, world_from_plan
from dc2g_jax.indoor.houses.worlds import scene
from dc2g_jax.indoor.learning.midlevel import EncoderArchitecture, TrainedEncoder
from dc2g_jax.indoor.maps import mapping
from dc2g_jax.indoor.maps.camera import camera_pose, indoor_camera
from dc2g_jax.indoor.maps.classes import BED, GOALS, PLANT, TABLE
from dc2g_jax.robot.mapping.simulator import render
from experiments.objectnav.collecting import NEVER, CollectionConfig, collect
from experiments.objectnav.data import (
    ALL_SYMMETRIES,
    GLOBAL,
    LOCAL,
    NORMALIZATIONS,
    SYMMETRIES,
    JourneySet,
    draw_samples,
    make_sample,
    map_of,
    turned_heading,
)
from tests.support.refusals import refusal
from tests.support.two_rooms import BED_BOX, PLANT_BOX, plan

#: A table in the room of the plant, to be looked over; a bed in the other.
TABLE_BOX = Furniture(TABLE, 4.5, 2.0, 0.8, 0.4, 0.0, 0.7)
CONFIG = CollectionConfig(journeys=3, views=20, places=2)


@struct.dataclass
class Quarters(TrainedEncoder):
    """The mean color of each quarter of a picture."""

    weights: None = None
    architecture: EncoderArchitecture = struct.field(pytree_node=False, default=EncoderArchitecture(features=4))

    def encode(self, images):
        return jnp.mean(images.reshape(-1, 2, 24, 2, 32, 3), axis=(2, 4, 5)).reshape(len(images), 4)


@pytest.fixture(scope="module")
def world():
    return world_from_plan(plan(BED_BOX, PLANT_BOX, TABLE_BOX), 0.1)


@pytest.fixture(scope="module")
def samples(world) -> JourneySet:
    """Journeys in one house; features are the mean colors of pictures' quarters."""
    made = collect([IndoorHouse("train-0", world)], Quarters(), CONFIG)
    return jax.tree.map(jnp.asarray, made)


@pytest.mark.slow
def test_robots_know_what_the_map_of_a_searching_robot_shows(samples, world):
    """The house seen from the places of a journey, frame by frame, on a map as large as a search's."""
    settings, camera, house = mapping.IndoorMapSettings(), indoor_camera(), scene(world)
    known = mapping.IndoorMap(jnp.zeros((settings.cells, settings.cells), jnp.uint32), jnp.array([-80, -90]))

    @jax.jit
    def look(known, x, y, yaw):
        frame = render(house, camera, camera_pose(x, y, yaw), settings.reach)
        return mapping.with_frame(known, frame, jnp.stack([x, y]), camera, settings)

    rows, columns = world.free.shape
    for view, ((row, column), yaw) in enumerate(zip(samples.places[0], samples.headings[0], strict=True)):
        known = look(known, 0.1 * (column + 0.5), -0.1 * (row + 0.5), yaw)
        explored = np.asarray(mapping.has(known.cells, mapping.EXPLORED_CHANNEL))[80 : 80 + rows, 90 : 90 + columns]
        np.testing.assert_array_equal(np.asarray(samples.first_seen[0]) <= view, explored)


def test_journeys_are_through_free_floor_and_reveal_the_house(samples, world):
    free = np.asarray(world.free)
    places, first_seen = np.asarray(samples.places), np.asarray(samples.first_seen)
    assert places.shape == (3, 20, 2)
    assert free[places[..., 0], places[..., 1]].all()
    steps = np.abs(np.diff(places, axis=1)).max(axis=-1)
    assert steps.max() == 2  # 0.24 m in cells of 0.1 m
    assert (steps > 0).any()
    assert np.isin(first_seen, [*range(20), NEVER]).all()
    assert (first_seen == 0).any(axis=(1, 2)).all()
    assert ((first_seen > 0) & (first_seen < NEVER)).any()
    turns = np.abs(np.angle(np.exp(1j * np.diff(np.asarray(samples.headings), axis=1))))
    assert 0.1 < turns.max() <= math.pi


@pytest.mark.slow
def test_the_same_seed_gives_the_same_journeys(samples, world):
    again = collect([IndoorHouse("train-0", world)], Quarters(), CONFIG)
    jax.tree.map(np.testing.assert_array_equal, again, samples)


def test_labels_are_distances_to_the_nearest_goal(samples, world):
    distance, free = np.asarray(samples.distance[0]), np.asarray(world.free)
    none = np.iinfo(np.uint16).max
    for goal, label in zip(GOALS, distance, strict=True):
        assert (label[~free] == none).all()
        assert (label[free] != none).all() == (goal in (BED, PLANT))
    # From beside the bed: less than a cell is left to drive. From the far room: at least as far as the crow flies.
    rows, columns = np.nonzero(world.classes == BED)
    beside = rows.max() + 3, int(columns.mean())
    assert free[beside]
    assert distance[0][beside] <= 150
    far = np.argwhere(np.asarray(world.rooms) == 2)
    crow = np.hypot(*(far[:, None] - np.stack([rows, columns], axis=-1)).T).min(axis=0) * 100
    found = distance[0][tuple(far.T)].astype(float)
    assert (found >= crow - 450)[found != none].all()


def test_normalized_costs():
    meters, navigable = jnp.asarray([[2.0, 6.0, 60.0]]), jnp.asarray([[True, True, False]])
    expected = {"share": [1 / 3, 1.0], "relative": [0.0, 0.4]}
    for name, normalize in NORMALIZATIONS.items():
        np.testing.assert_allclose(normalize(meters, navigable)[0, :2], expected.pop(name), rtol=1e-6)
        assert np.isfinite(normalize(meters, ~navigable & navigable)[0, :2]).all()
    assert not expected


def test_the_network_is_shown_what_the_robots_map_would_show(world):
    """The window around a robot in an explored house."""
    cells, (row, column) = map_of(world), (14, 40)
    around = mapping.window(mapping.IndoorMap(cells, jnp.zeros(2, jnp.int32)), jnp.array([row, column]), GLOBAL)
    shown = np.asarray(mapping.network_maps(around, LOCAL))
    rows, columns = np.indices(world.free.shape)
    here = slice(None), rows - row + LOCAL // 2, columns - column + LOCAL // 2
    for channel in range(16):
        np.testing.assert_array_equal(shown[here][channel], (world.classes == channel + 1) & world.obstacle)
    np.testing.assert_array_equal(shown[here][16:18], [world.obstacle, world.obstacle | world.free])
    assert shown[BED - 1].any()
    assert shown[18 + TABLE - 1].any()


def test_headings_turn_with_their_maps():
    """A pointer of cells from the middle, turned, points along the turned heading."""
    for symmetry in SYMMETRIES:
        for heading, ahead in ((0.0, (10, 13)), (math.pi / 2, (7, 10)), (math.pi / 4, (8, 12))):
            grid = np.zeros((21, 21), np.uint8)
            grid[ahead] = 1
            row, column = np.argwhere(np.asarray(turned(jnp.asarray(grid), jnp.asarray(symmetry))))[0]
            expected = math.atan2(10 - row, column - 10)
            found = float(turned_heading(jnp.float32(heading), jnp.asarray(symmetry)))
            assert math.cos(found - expected) == pytest.approx(1, abs=1e-5)
    grid = np.arange(9).reshape(3, 3)
    for turns in range(4):
        found = turned(jnp.asarray(grid), jnp.asarray(SYMMETRIES[turns]))
        np.testing.assert_array_equal(found, np.rot90(grid, turns))


def test_a_sample_is_what_was_known_then(samples, world):
    make = jax.jit(
        lambda journey, view, target, symmetry: make_sample(
            samples, journey, view, target, symmetry, lambda meters, _: meters / 10
        )
    )
    target, view = GOALS.index(PLANT), 7
    sample = make(1, view, target, jnp.asarray(SYMMETRIES[0]))
    row, column = np.asarray(samples.places[1, view])
    middle = LOCAL // 2
    rows, columns = np.indices(world.free.shape)
    place = rows - row + middle, columns - column + middle
    inside = (np.stack(place) >= 0).all(axis=0) & (np.stack(place) < LOCAL).all(axis=0)
    assert inside.all()
    explored = np.asarray(samples.first_seen[1]) <= view
    maps = np.asarray(mapping.network_maps(sample.cells, LOCAL))
    np.testing.assert_array_equal(maps[17][place] == 1, explored & (world.free | world.obstacle))
    np.testing.assert_array_equal(maps[16][place] == 1, explored & world.obstacle)
    np.testing.assert_array_equal(sample.occupied[place], ~world.free)
    assert int(np.sum(~np.asarray(sample.occupied))) == world.free.sum()
    label = np.asarray(samples.distance[0, target])
    free = np.asarray(world.free)
    np.testing.assert_allclose(np.asarray(sample.cost)[place][free], label[free] / 10_000, rtol=1e-6)
    assert np.isinf(np.asarray(sample.cost)[np.asarray(sample.occupied)]).all()
    for symmetry in SYMMETRIES[1:]:
        other = make(1, view, target, jnp.asarray(symmetry))
        mirrored = symmetry.bit_count() % 2
        np.testing.assert_array_equal(other.features, samples.features[1, view, mirrored].astype(jnp.float32))
        np.testing.assert_array_equal(other.cost, turned(sample.cost, jnp.asarray(symmetry)))
        np.testing.assert_array_equal(other.cells, turned(sample.cells, jnp.asarray(symmetry)))


def test_a_batch_is_drawn_for_goals_that_are_there(samples):
    normalize = NORMALIZATIONS["relative"]
    draw = jax.jit(
        lambda key: draw_samples(key, samples, batch_size=32, symmetries=ALL_SYMMETRIES, normalize=normalize)
    )
    batch = draw(jax.random.key(0))
    assert set(np.asarray(batch.target).tolist()) == {GOALS.index(BED), GOALS.index(PLANT)}
    assert batch.cells.dtype == np.uint32
    lowest = np.asarray(batch.cost).min(axis=(1, 2))
    np.testing.assert_array_equal(lowest, np.zeros(32, np.float32))
    jax.tree.map(np.testing.assert_array_equal, batch, draw(jax.random.key(0)))
    assert not np.array_equal(batch.cells, draw(jax.random.key(1)).cells)


def test_houses_that_are_too_large_are_refused(world):
    config = CollectionConfig(largest=20)
    refusal(lambda: collect([IndoorHouse("train-0", world)], Quarters(), config), "20 cells", "larger")
    refusal(lambda: CollectionConfig(views=255), "views 255")
