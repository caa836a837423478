"""Weights of NNX networks as nested dictionaries, and arrays in safetensors files."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax.tree_util import keystr, tree_leaves_with_path
from jaxtyping import Array
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dc2g_jax._src.files.atomic import replacing
from dc2g_jax._src.files.digests import tree_sha256
from dc2g_jax._src.files.reading import check_file
from dc2g_jax._src.runtime.errors import InputError

#: Most bytes of a file of weights.
_LARGEST_NETWORK = 2**31

_Network = TypeVar("_Network", bound=nnx.Module)


def fresh_weights(network: Callable[..., nnx.Module], architecture: Any, key: Array) -> dict[str, Any]:
    """Random initial weights of a network: a nested dictionary of arrays.

    Args:
      network: class of the network, called as `network(architecture, rngs=...)`.
      architecture: architecture of the network.
      key: random key.
    """
    return nnx.to_pure_dict(nnx.split(network(architecture, rngs=nnx.Rngs(key)))[1])


@functools.cache  # a network is built anew in every trace of it
def _structure(network: Callable[..., nnx.Module], architecture: Any) -> tuple[Any, Any]:
    """The graph of a network, and its weights' shapes and dtypes."""
    graph, weights = nnx.split(nnx.eval_shape(lambda: network(architecture, rngs=nnx.Rngs(0))))
    # Within a sharded program, shapes would belong to its mesh, and could not be used elsewhere.
    return graph, jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), weights)


def shapes_of_weights(network: Callable[..., nnx.Module], architecture: Any) -> dict[str, Any]:
    """Shapes and dtypes of `fresh_weights`, without computing them."""
    return nnx.to_pure_dict(_structure(network, architecture)[1])


def with_weights(network: Callable[..., _Network], architecture: Any, weights: dict[str, Any]) -> _Network:
    """The network with these weights, see `fresh_weights`."""
    graph, shapes = _structure(network, architecture)
    state = jax.tree.map(lambda shape: shape, shapes)  # a copy
    nnx.replace_by_pure_dict(state, weights)
    return nnx.merge(graph, state)


def _by_name(tree: Any) -> dict[str, Any]:
    """Arrays of a tree by their names in files: keys, attributes and numbers in lists, with dots between."""
    return {keystr(path, simple=True, separator="."): leaf for path, leaf in tree_leaves_with_path(tree)}


def write_safetensors(path: str | Path, tensors: Any) -> None:
    """Write the arrays of a tree, such as `fresh_weights`, to a file, always as the same bytes.

    An existing file is replaced atomically. Arrays get the names of their keys or attributes, with dots between. The
    metadata of the file has their SHA-256.
    """
    arrays = {name: np.asarray(leaf, order="C") for name, leaf in _by_name(tensors).items()}
    with replacing(path) as unfinished:
        unfinished.write_bytes(save(arrays, {"sha256": tree_sha256(arrays)}))


def read_safetensors(
    path: str | Path,
    remedy: str = "give an undamaged file in the safetensors format",
    *,
    at_most: int | None = _LARGEST_NETWORK,
) -> dict[str, np.ndarray]:
    """Read the arrays of a file.

    Args:
      path: the file.
      remedy: end of the message: what to do.
      at_most: largest size in bytes, by default that of a network; `None` for any.

    Raises:
      InputError: the file is larger, cannot be read, has another format, or has arrays of another SHA-256 than it says.
    """
    check_file(Path(path), remedy, at_most=at_most)
    try:
        with safe_open(path, framework="np") as file:
            names, digest = file.keys(), (file.metadata() or {}).get("sha256")
            arrays = {name: file.get_tensor(name) for name in names}
    except (OSError, SafetensorError, AttributeError, TypeError, ValueError) as error:  # also data types NumPy lacks
        raise InputError(f"{path}: cannot be read ({error}); {remedy}") from None
    if digest is not None and digest != tree_sha256(arrays):
        raise InputError(f"{path}: cannot be read (is damaged: its arrays have another SHA-256 than it says); {remedy}")
    return arrays


def read_weights(path: str | Path, shapes: dict[str, Any]) -> dict[str, Any]:
    """Read the weights of a known network from a file, as float32.

    Args:
      path: the file.
      shapes: nested dictionary of values with the shapes of the network's weights.

    Raises:
      InputError: the file cannot be read, or an array is missing, unexpected or of another shape.
    """
    remedy = "keep the files of one training together"
    tensors = read_safetensors(path, remedy)
    wanted = {name: tuple(leaf.shape) for name, leaf in _by_name(shapes).items()}
    found = {name: tensor.shape for name, tensor in tensors.items()}
    for name in sorted({**wanted, **found}):
        if wanted.get(name) != found.get(name):
            raise InputError(
                f"{path}: weights of another architecture: {name} has shape {found.get(name, 'none')}, but the "
                f"network needs {wanted.get(name, 'none')}; {remedy}"
            )
    return jax.tree.unflatten(jax.tree.structure(shapes), [jnp.asarray(tensors[name], jnp.float32) for name in wanted])
