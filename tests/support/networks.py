"""Networks that have learned nothing."""

import jax
import numpy as np

from dc2g_jax.estimation.compact_unet import Architecture, weight_shapes
from dc2g_jax.estimation.estimators import NetworkCostToGo


def random_network(architecture: Architecture) -> NetworkCostToGo:
    """A network of random weights, none of them zero as some are before training."""
    rng = np.random.default_rng(0)
    weights = jax.tree.map(lambda leaf: rng.normal(0, 0.2, leaf.shape).astype(leaf.dtype), weight_shapes(architecture))
    return NetworkCostToGo(weights=weights, architecture=architecture)
