"""Networks that have learned nothing."""

import jax
import numpy as np

from dc2g_jax._src.estimation.compact_unet import Architecture, CompactUNet
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.estimation.weights import shapes_of_weights


def random_network(architecture: Architecture, seed: int = 0) -> NetworkCostToGo:
    """A network of random weights, none of them zero as some are before training."""
    rng, shapes = np.random.default_rng(seed), shapes_of_weights(CompactUNet, architecture)
    weights = jax.tree.map(lambda leaf: rng.normal(0, 0.2, leaf.shape).astype(leaf.dtype), shapes)
    return NetworkCostToGo(weights=weights, architecture=architecture)
