"""SHA-256 digests of pytrees."""

import hashlib
from typing import Any

import jax
import numpy as np


def arrays_sha256(tree: Any) -> str:
    """SHA-256 of all arrays of a tree, such as a network's weights: names and bytes, in order."""
    digest = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        digest.update(jax.tree_util.keystr(path).encode())
        digest.update(np.asarray(leaf).tobytes())
    return digest.hexdigest()


def tree_sha256(tree: Any) -> str:
    """SHA-256 of a whole tree: its structure with static fields, and its arrays."""
    shapes = jax.tree.map(lambda leaf: (np.shape(leaf), np.asarray(leaf).dtype.name), tree)
    made_of = f"{jax.tree.structure(tree)} {jax.tree.leaves(shapes)} {arrays_sha256(tree)}"
    return hashlib.sha256(made_of.encode()).hexdigest()
