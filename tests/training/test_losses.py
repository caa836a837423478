"""Losses: what each is smallest at, and what does not count."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training.losses import LOSSES, map_loss, named_loss, parse_losses
from tests.support.refusals import refusal

LEVELS = jnp.array([0.1, 0.5, 0.9])


def minimizer(name: str, samples: np.ndarray) -> np.ndarray:
    """The estimates, one a level, whose mean loss over samples is smallest, by trying a grid of values."""
    grid = np.linspace(-1, 5, 1201)
    estimate = jnp.asarray(np.repeat(grid[:, None], len(LEVELS), axis=1), jnp.float32)[None]
    of_sample = lambda target: LOSSES[name](estimate, jnp.full((1, len(grid), 1), target), LEVELS)  # noqa: E731
    losses = jax.vmap(of_sample)(jnp.asarray(samples))
    return grid[np.argmin(np.asarray(losses.mean(axis=0))[0], axis=0)]


@pytest.fixture(scope="module")
def samples() -> np.ndarray:
    return np.random.default_rng(0).gamma(2.0, 0.6, 2001).astype(np.float32)


def test_quantiles_are_what_the_quantile_loss_is_smallest_at(samples):
    np.testing.assert_allclose(minimizer("quantile", samples), np.quantile(samples, LEVELS), atol=0.02)


@pytest.mark.parametrize(("name", "statistic"), [("l1", np.median), ("l2", np.mean), ("log", np.median)])
def test_other_losses_are_smallest_at_one_value_for_all_levels(samples, name, statistic):
    np.testing.assert_allclose(minimizer(name, samples), np.full(3, statistic(samples)), atol=0.02)


def test_the_quantile_loss_at_the_median_is_the_absolute_error():
    estimate, target = jnp.array([[[1.0], [3.0]]]), jnp.array([[[2.5], [2.5]]])
    np.testing.assert_allclose(
        LOSSES["quantile"](estimate, target, jnp.array([0.5])), LOSSES["l1"](estimate, target, jnp.array([0.5]))
    )


def test_the_huber_loss_grows_like_the_absolute_error_and_is_smooth_at_zero():
    target = jnp.zeros((1, 1, 1))
    loss = lambda error: float(LOSSES["huber"](jnp.full((1, 1, 1), error), target, jnp.array([0.5]))[0, 0, 0])  # noqa: E731
    assert loss(3.0) - loss(2.0) == pytest.approx(1.0)
    assert loss(0.02) == pytest.approx(4 * loss(0.01), rel=1e-4)
    assert loss(-2.0) == loss(2.0)


@pytest.mark.parametrize("name", LOSSES)
def test_a_loss_is_a_weighted_mean_of_what_counts(name):
    rng = np.random.default_rng(1)
    estimate = jnp.asarray(rng.normal(size=(2, 3, 3)), jnp.float32)
    target = jnp.array([[2.0, 2.0, jnp.inf], [1.0, jnp.inf, 7.0]])
    weight = jnp.array([[1.0, 1.0, 0.0], [4.0, 0.0, 2.0]])
    of_cell = np.asarray(LOSSES[name](estimate, jnp.where(weight > 0, target, 0)[..., None], LEVELS)).mean(axis=-1)
    wanted = (of_cell * np.asarray(weight)).sum() / 8
    assert float(map_loss(LOSSES[name], estimate, target, weight, LEVELS)) == pytest.approx(wanted, rel=1e-5)
    assert float(map_loss(LOSSES[name], estimate, target, jnp.zeros_like(weight), LEVELS)) == 0
    gradient = np.asarray(jax.grad(map_loss, argnums=1)(LOSSES[name], estimate, target, weight, LEVELS))
    assert np.isfinite(gradient).all()
    np.testing.assert_array_equal(gradient[np.asarray(weight) == 0], 0)
    assert np.all(gradient[np.asarray(weight) > 0] != 0)


def squares(estimate, target, levels):
    """As `l2`."""
    return jnp.square(target - estimate)


def of_two(estimate, target):
    return estimate - target


def mean_of_squares(estimate, target, levels):
    return jnp.mean(squares(estimate, target, levels))


def test_a_loss_of_the_users_own_goes_by_its_name():
    own = f"{__name__}:squares"
    assert parse_losses(f"l1=0.5,{own}=2") == (("l1", 0.5), (own, 2.0))
    estimate, target, weight = jnp.array([[[1.0], [5.0]]]), jnp.array([[2.0, 2.0]]), jnp.array([[1.0, 3.0]])
    values = [map_loss(named_loss(name), estimate, target, weight, jnp.array([0.5])) for name in (own, "l2")]
    assert [float(value) for value in values] == [7.0, 7.0]
    refusal(lambda: parse_losses(f"{__name__}:cubes"), "test_losses:cubes", "cannot be imported", "package.module:Name")
    for name, what in (
        ("mean_of_squares", "answers with shape () for arrays of shapes ((2, 3, 5), (2, 3, 1), (5,))"),
        ("of_two", "cannot be called with arrays of shapes ((2, 3, 5), (2, 3, 1), (5,)) (TypeError: of_two() takes 2"),
        ("LEVELS", "cannot be called"),
    ):
        refusal(lambda name=name: parse_losses(f"{__name__}:{name}"), f":{name}'", what, "one number for each estimate")


def test_an_unknown_loss_lists_the_known_ones():
    for name in LOSSES:
        assert parse_losses(name) == ((name, 1.0),)
    with pytest.raises(InputError, match=r"no loss is called 'l3'; give one of quantile, l1, l2, huber, log"):
        parse_losses("l1,l3")
