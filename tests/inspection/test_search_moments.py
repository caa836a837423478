"""Moments of a search for its figure."""

import numpy as np

from dc2g_jax.inspection.search_moments import choose_legs


def test_the_last_two_moments_show_the_goal_reacher_if_it_takes_over():
    assert choose_legs(np.zeros(41, bool), 5) == [0, 10, 20, 30, 40]
    assert choose_legs(np.arange(41) >= 36, 5) == [0, 12, 24, 36, 40]
    assert choose_legs(np.arange(41) >= 20, 5) == [0, 10, 20, 30, 40]
    assert choose_legs(np.ones(3, bool), 5) == [0, 1, 2]
