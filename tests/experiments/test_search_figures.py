"""Moments of a search for its figures, and what a network predicts at one of them."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from matplotlib.colors import to_rgb
from PIL import Image

from dc2g_jax.indoor.maps.classes import GOALS, PLANT
from dc2g_jax.indoor.search.guides import true_distance
from dc2g_jax.indoor.search.searches import reset, site_of
from experiments.support.search_figures import (
    PATH_COLOR,
    ROBOT_COLOR,
    TARGET_COLOR,
    RecordedSearch,
    SearchMoment,
    animate_search,
    plot_prediction,
    search_pictures,
)
from experiments.support.search_moments import choose_legs, prediction_at
from experiments.support.search_recording import record_search
from tests.support.recordings import read
from tests.support.two_rooms import AGENT, two_rooms


def test_the_last_two_moments_show_the_goal_reacher_if_it_takes_over():
    assert choose_legs(np.zeros(41, bool), 5) == [0, 10, 20, 30, 40]
    assert choose_legs(np.arange(41) >= 36, 5) == [0, 12, 24, 36, 40]
    assert choose_legs(np.arange(41) >= 20, 5) == [0, 10, 20, 30, 40]
    assert choose_legs(np.ones(3, bool), 5) == [0, 1, 2]


@struct.dataclass
class EastIsGood:
    """Predicts that costs fall by a meter from column to column, and that the first row is occupied."""

    def estimate(self, maps, target, heading, image):
        return jnp.broadcast_to(jnp.arange(maps.shape[-1])[::-1].astype(float), maps.shape[1:]).at[0].set(jnp.inf)


def test_a_prediction_lies_beside_the_truth_of_the_same_cells(tmp_path):
    world, side = two_rooms().world, AGENT.mapping.local
    robot = reset(jax.random.key(0), (jnp.array([2.55, -2.05, 0.0]), jnp.int32(GOALS.index(PLANT))), AGENT, 5)
    site = site_of(world, "two_rooms", AGENT)
    truth = true_distance(world, AGENT)
    knowing = AGENT.replace(estimator=EastIsGood(), true_distance=truth)
    found = jax.tree.map(np.asarray, prediction_at(robot, site, knowing))
    assert found.occupied[0].all()
    assert not found.occupied[1:].any()
    np.testing.assert_allclose(found.cost[1:], np.broadcast_to(np.arange(side)[::-1], (side - 1, side)), atol=1e-4)
    # The robot is in row 20 and column 25 of the house, and in the middle of its local map.
    rows, columns = np.nonzero(world.free)
    row, column = rows + side // 2 - 20, columns + side // 2 - 25
    assert not found.truly_occupied[row, column].any()
    assert (~found.truly_occupied).sum() == len(rows)
    distance = truth[robot.target][rows, columns]
    np.testing.assert_allclose(found.true_cost[row, column], distance - distance.min(), atol=1e-5)
    plot_prediction(tmp_path / "fig4", found, "plant")
    for path in tmp_path.iterdir():
        assert path.stat().st_size > 5_000


def a_search() -> RecordedSearch:
    """A track eastward, and two moments on it with a map of nothing and costs of a meter."""
    step = np.arange(6)
    track = np.stack([1.0 + 0.2 * step, -2.0 + 0 * step, 0 * step, 0 * step, 0 * step], axis=-1)
    zero = np.zeros(2, int)
    moments = [
        SearchMoment(at, doing, np.zeros((30, 30), np.uint32), zero, np.ones((9, 9)), zero + 3, np.zeros((0, 2, 2)))
        for at, doing in ((0, "exploring"), (5, "goal reacher"))
    ]
    return RecordedSearch(two_rooms().world, PLANT, track, moments)


def test_the_animation_of_a_search_shows_robot_path_and_costs(tmp_path):
    search = a_search()
    first, last = (picture.astype(int) for picture in search_pictures(search, [0, 1]))
    assert first.shape == last.shape
    assert (np.array(first.shape[:2]) % 2 == 0).all()

    def places(picture, color):
        return np.argwhere((np.abs(picture - 255 * np.array(to_rgb(color))) < 2).all(axis=-1))  # rounded in drawing

    # The robot has gone one meter to the right on each of the three panels, and has left a path on the first.
    robots = [places(picture, ROBOT_COLOR) for picture in (first, last)]
    moved = robots[1].mean(axis=0) - robots[0].mean(axis=0)
    paths = [places(picture, PATH_COLOR)[:, 1] for picture in (first, last)]
    assert abs(moved[0]) < 1
    assert len(paths[0]) == 0
    assert np.ptp(paths[1]) > 0.7 * moved[1] > 20
    assert paths[1].max() < last.shape[1] / 3
    assert len(places(first, TARGET_COLOR)) > 20
    animate_search(tmp_path / "search.gif", search)
    with Image.open(tmp_path / "search.gif") as image:
        assert image.n_frames == 2


def test_the_recording_of_a_search_has_its_path_and_maps(tmp_path):
    search = a_search()
    record_search(tmp_path / "search.rrd", "search", search)
    found = read(tmp_path / "search.rrd")
    for step in range(6):
        (place,) = found["/robot", "Points2D:positions"][step]
        np.testing.assert_allclose(place, search.track[step, :2] / (search.size, -search.size), rtol=1e-5)
    assert sorted(found["/robots_map", "Image:buffer"]) == sorted(found["/costs", "Image:buffer"]) == [0, 5]
    assert found["/doing", "TextLog:text"] == {0: ["exploring"], 5: ["goal reacher"]}
    ((corner,),) = {tuple(map(tuple, there)) for there in found["/costs", "Transform3D:translation"].values()}
    assert corner == (3.0, 3.0, 0.0)
