"""Extra steps, their summary, and intervals from houses drawn anew."""

import numpy as np
import pytest

from dc2g_jax._src.rollouts.statistics import extra_steps, house_bootstrap, summarize


@pytest.mark.parametrize(("steps", "shortest", "wanted"), [(10, 10, 0), (25, 10, 150), (11, 8, 37.5), (3, 1, 200)])
def test_extra_steps(steps, shortest, wanted):
    assert extra_steps(steps, shortest) == wanted


def test_extra_steps_need_an_oracle_that_moved():
    with pytest.raises(ValueError, match="0 steps"):
        extra_steps(5, 0)


def test_summary():
    summary = summarize([0.0, 10.0, 20.0, 170.0], [True, True, True, False])
    assert np.isnan([summary.pop("mean_low"), summary.pop("mean_high")]).all()
    assert summary == {
        "mean_extra": 50, "median_extra": 15, "quartile_25": 7.5, "quartile_75": 57.5, "success": 0.75, "episodes": 4,
    }  # fmt: skip
    assert {type(value) for value in summary.values()} == {float, int}


def test_a_summary_of_nothing_is_refused():
    with pytest.raises(ValueError, match="no episode"):
        summarize([], [])


def test_an_interval_is_that_of_houses_drawn_one_by_one():
    rng = np.random.default_rng(3)
    counts = np.arange(1, 11)
    houses = np.repeat([f"house{number}" for number in range(10)], counts)
    values = np.repeat(rng.normal(0, 10, 10), counts) + rng.normal(0, 1, counts.sum())
    means = []
    for _ in range(4000):
        drawn = [values[houses == f"house{number}"] for number in rng.integers(10, size=10)]
        means.append(np.mean(np.concatenate(drawn)))
    for share in (0.6, 0.95):
        wanted = np.quantile(means, ((1 - share) / 2, (1 + share) / 2))
        found = house_bootstrap(values, list(houses), resamples=4000, seed=0, share=share)
        np.testing.assert_allclose(found[1:], wanted, atol=0.05 * np.ptp(means))
        assert found.mean == pytest.approx(values.mean())


def test_an_interval_of_nothing_is_refused():
    with pytest.raises(ValueError, match="no episode"):
        house_bootstrap([], [], resamples=10, seed=0)
