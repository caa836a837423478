"""States of training, for the tests of all trainings."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def assert_same_bits(one: Any, other: Any) -> None:
    """Two states are alike to the last bit."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert np.asarray(a).dtype == np.asarray(b).dtype
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def infinite(optimizer_state: Any) -> Any:
    """An optimizer's state after which the next step, whatever its loss, leaves weights that are not finite."""
    return jax.tree.map(
        lambda leaf: jnp.full_like(leaf, jnp.inf) if jnp.issubdtype(leaf.dtype, jnp.inexact) else leaf, optimizer_state
    )
