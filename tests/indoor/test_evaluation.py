"""What searches are judged by, on tracks drawn by hand."""

import numpy as np
import pytest

from dc2g_jax.indoor.maps.classes import GOALS
from dc2g_jax.indoor.search.evaluation import results_of, success_region
from dc2g_jax.indoor.search.searches import Search, Searches, sample_episodes
from tests.support.refusals import refusal
from tests.support.two_rooms import two_rooms


@pytest.fixture(scope="module")
def house():
    return two_rooms()


def straight(start, end, steps, limit=20):
    """A track at even speed, padded with its end."""
    places = np.linspace(start, end, steps + 1)
    speed = np.hypot(*(np.array(end) - start)) / steps / 0.1
    track = np.zeros((limit + 1, 5))
    track[: steps + 1, :2], track[1 : steps + 1, 3] = places, speed
    track[steps + 1 :, :2] = end
    return track


def judged(house, start, end, *, declared=True, target="plant", steps=10):
    searches = Searches(
        track=straight(start, end, steps)[None].astype(np.float32),
        declared=np.array([declared]),
        steps=np.array([steps]),
        collisions=np.array([3]),
    )
    (result,) = results_of("someone", [house], [Search(house.name, target, *start, 0.0)], searches)
    return result


def test_within_a_meter_counts_and_through_a_wall_does_not(house):
    _, there = success_region(house, "plant")
    # The plant's nearest cells have their middles at x = 4.7 and y = -2.7; row 26, column 46 or so.
    rows, columns = np.nonzero(house.world.classes == GOALS[3])
    nearest = np.array(
        [[np.hypot(rows - r, columns - c).min() for c in range(there.shape[1])] for r in range(there.shape[0])]
    )
    in_room = house.world.free & (house.world.rooms == 2)
    np.testing.assert_array_equal(there & in_room, in_room & (nearest <= 10 + 1e-6))
    beyond = house.world.free & (house.world.rooms == 1) & (np.arange(there.shape[1]) < 31)
    assert not there[beyond].any()


def test_a_success_is_weighted_by_path_length(house):
    result = judged(house, (3.95, -1.0), (4.15, -2.3))
    assert result.success
    assert result.driven == pytest.approx(np.hypot(0.2, 1.3), rel=1e-5)
    assert 0.3 < result.shortest < 1.2
    assert result.spl == pytest.approx(result.shortest / result.driven, rel=1e-5)
    assert (result.distance, result.steps, result.collisions) == (0, 10, 3)


def test_who_never_says_so_is_not_there(house):
    result = judged(house, (3.95, -1.0), (4.15, -2.3), declared=False)
    assert (result.success, result.spl, result.distance) == (False, 0, 0)


def test_distance_to_success_goes_through_the_door(house):
    result = judged(house, (4.15, -1.0), (2.85, -3.0))
    assert not result.success
    # As the crow flies it is 0.9 m to where the plant is within 1 m.
    assert 1.5 < result.distance < 3.5


def test_accelerations_are_differences_of_speeds(house):
    result = judged(house, (3.95, -1.0), (4.15, -2.3))
    speed = np.hypot(0.2, 1.3)
    # From rest to even speed in the first of 10 periods.
    assert result.acceleration == pytest.approx(speed / 0.1 / 10, rel=1e-4)
    assert result.jerk == pytest.approx(speed / 0.01 / 9, rel=1e-4)
    assert (result.turn_acceleration, result.turn_jerk) == (0, 0)


def test_searches_are_drawn_alike_whatever_houses_come_with_them(house):
    other = type(house)("other", house.world)
    alone = sample_episodes([house], 6, seed=1)
    assert sample_episodes([other, house], 6, seed=1)[6:] == alone
    assert sample_episodes([house], 6, seed=2) != alone
    assert {episode.target for episode in alone} <= {"bed", "plant"}
    for episode in alone:
        assert house.world.free[int(-episode.y / 0.1), int(episode.x / 0.1)]


def test_houses_without_anything_to_search_for_are_refused(house):
    bare = type(house)("bare", house.world.replace(classes=np.zeros_like(house.world.classes)))
    refusal(lambda: sample_episodes([bare], 3), "1 houses", "give others")
