import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings

from experiments.driving.lines import distance_to_segment, needed_clearance
from tests.oracles import vehicle_oracle
from tests.support.maps import seeds


@settings(max_examples=30)
@given(seed=seeds)
def test_what_is_clear_at_both_ends_of_an_arc_is_clear_all_along(seed):
    rng = np.random.default_rng(seed)
    radius, traveled, turned = rng.uniform(0.1, 0.5), rng.uniform(0, 0.4), rng.uniform(-0.6, 0.6)
    places = vehicle_oracle.driven([0, 0], rng.uniform(-3, 3), traveled, turned, 1.0, 50)
    needed = float(needed_clearance(radius, jnp.float32(traveled), jnp.float32(turned), jnp.float32(np.inf)))
    obstacles = rng.uniform(-1, 1, (400, 2)) * (radius + traveled)
    apart = np.linalg.norm(obstacles[:, None] - places, axis=-1)
    clear = np.minimum(apart[:, 0], apart[:, -1]) >= needed
    assert apart[clear].min(initial=np.inf) > radius
    assert needed <= np.hypot(radius + 0.001 + traveled * abs(turned) / 8, traveled / 2) + 1e-6


def test_a_footprint_that_touches_blocked_ground_need_only_touch_it_no_deeper():
    needed = needed_clearance(0.3, jnp.array([0.0, 0.2]), 0.0, jnp.float32(0.2))
    assert needed.tolist() == pytest.approx([0.2, 0.2])


def test_distance_to_a_segment():
    segment = jnp.array([1.0, 1.0]), jnp.array([2.0, 0.0])
    for point, expected in (((2.5, 3.0), 2.0), ((0.0, 1.0), 1.0), ((6.0, 5.0), 5.0)):
        assert float(distance_to_segment(jnp.array(point), *segment)) == pytest.approx(expected)
    assert float(distance_to_segment(jnp.array([4.0, 5.0]), segment[0], jnp.zeros(2))) == pytest.approx(5)
