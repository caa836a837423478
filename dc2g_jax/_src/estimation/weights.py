"""Weights of NNX networks as nested dictionaries, and networks in single safetensors files."""

import dataclasses
import functools
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from flax.traverse_util import flatten_dict, unflatten_dict
from jaxtyping import Array
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dc2g_jax._src.errors import InputError, short
from dc2g_jax._src.files.atomic import replacing
from dc2g_jax._src.files.reading import check_file, parse_json

#: Most bytes of a file of weights.
_LARGEST_NETWORK = 2**31

_Architecture = TypeVar("_Architecture")
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


def no_weights(network: Callable[..., nnx.Module], architecture: Any) -> dict[str, str]:
    """Name -> kind of what a network keeps besides its weights (`nnx.Param`), such as statistics of batches."""
    made = nnx.eval_shape(lambda: network(architecture, rngs=nnx.Rngs(0)))
    others = nnx.to_flat_state(nnx.state(made, nnx.Not(nnx.Param)))
    return {".".join(map(str, path)): type(kept).__name__ for path, kept in others}


def with_weights(network: Callable[..., _Network], architecture: Any, weights: dict[str, Any]) -> _Network:
    """The network with these weights, see `fresh_weights`."""
    graph, shapes = _structure(network, architecture)
    state = jax.tree.map(lambda shape: shape, shapes)  # a copy
    nnx.replace_by_pure_dict(state, weights)
    return nnx.merge(graph, state)


def _by_name(tree: dict[str, Any]) -> dict[str, Any]:
    """Weights by their names in files: their keys, and their numbers in lists of layers, with dots between."""
    return {".".join(map(str, path)): leaf for path, leaf in flatten_dict(tree).items()}


def write_safetensors(path: str | Path, tensors: dict[str, Any], metadata: Mapping[str, str]) -> None:
    """Write arrays to a file, always as the same bytes. An existing file is replaced atomically.

    Args:
      path: the file.
      tensors: name -> array. Nested dictionaries, such as `fresh_weights`, get names with dots.
      metadata: further facts, as strings by name.
    """
    dense = {name: np.asarray(tensor, order="C") for name, tensor in _by_name(tensors).items()}
    data = save(dense)
    length = int.from_bytes(data[:8], "little")
    # The library would write the metadata in random order.
    facts = {"__metadata__": dict(metadata)} | json.loads(data[8 : 8 + length])
    header = json.dumps(facts, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    with replacing(path) as unfinished:
        unfinished.write_bytes(len(header).to_bytes(8, "little") + header + data[8 + length :])


def read_safetensors(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read the arrays and the metadata of a file.

    Raises:
      InputError: the file cannot be read or has another format; the message gives the reason.
    """
    check_file(Path(path), "give a file in the safetensors format", at_most=_LARGEST_NETWORK)
    try:
        with safe_open(path, framework="np") as file:
            names = file.keys()
            return {name: file.get_tensor(name) for name in names}, file.metadata() or {}
    except (OSError, SafetensorError, AttributeError, TypeError, ValueError) as error:  # also data types NumPy lacks
        raise InputError(
            f"{path}: cannot be read ({error}); give an undamaged file in the safetensors format"
        ) from None


def read_weights(path: str | Path, shapes: dict[str, Any], tensors: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Weights of a known network from the arrays of a file, as float32.

    Args:
      path: the file, for messages.
      shapes: nested dictionary of values with the shapes of the network's weights.
      tensors: the arrays of the file.

    Raises:
      InputError: an array is missing, unexpected or of another shape.
    """
    wanted = {name: tuple(leaf.shape) for name, leaf in _by_name(shapes).items()}
    found = {name: tensor.shape for name, tensor in tensors.items()}
    for name in sorted({**wanted, **found}):
        if wanted.get(name) != found.get(name):
            raise InputError(
                f"{path}: weights of another architecture: {name} has shape {found.get(name, 'none')}, but the "
                f"network needs {wanted.get(name, 'none')}; keep the files of one training together"
            )
    arrays = (jnp.asarray(tensors[name], jnp.float32) for name in wanted)
    return unflatten_dict(dict(zip(flatten_dict(shapes), arrays, strict=True)))


def write_network(path: str | Path, weights: dict[str, Any], architecture: Any, card: Mapping[str, Any]) -> None:
    """Write a network to one file: weights in half precision, architecture and card as JSON in the metadata.

    Args:
      path: the file; replaced if it exists.
      weights: see `fresh_weights`.
      architecture: dataclass of the architecture.
      card: further facts about the network.
    """
    tensors = jax.tree.map(lambda leaf: np.asarray(leaf, np.float16), weights)
    metadata = {"architecture": json.dumps(dataclasses.asdict(architecture)), "card": json.dumps(dict(card))}
    write_safetensors(path, tensors, metadata)


def read_network(
    path: str | Path, network: Callable[..., nnx.Module], read_architecture: Callable[[dict[str, Any]], _Architecture]
) -> tuple[dict[str, Any], _Architecture, dict[str, Any]]:
    """Read a network written by `write_network`.

    Args:
      path: the file.
      network: class of the network.
      read_architecture: converts JSON to the architecture.

    Returns:
      Weights in float32, architecture and card. The card is empty for files without one.

    Raises:
      InputError: the file cannot be read or holds no such network.
    """
    tensors, metadata = read_safetensors(path)
    try:
        architecture = read_architecture(parse_json(metadata["architecture"]))
        shapes, card = shapes_of_weights(network, architecture), parse_json(metadata.get("card", "{}"))
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        raise InputError(f"{path}: holds no network with its architecture; write or copy it again") from None
    if not isinstance(card, dict):
        raise InputError(f"{path}: its card is {short(card)}, which is no JSON object; write or copy it again")
    return read_weights(path, shapes, tensors), architecture, card
