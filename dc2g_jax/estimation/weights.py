"""A network's weights in one safetensors file: written whole, read with checks, matched with the network's shapes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dc2g_jax.errors import InputError
from dc2g_jax.files.atomic import replacing


def write_safetensors(path: str | Path, tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write arrays to a file, which is replaced at once, when all is written.

    Args:
      path: the file.
      tensors: name -> array.
      metadata: further facts, text by name.
    """
    dense = {name: np.asarray(tensor, order="C") for name, tensor in tensors.items()}
    with replacing(path) as unfinished:
        unfinished.write_bytes(save(dense, dict(metadata)))


def read_safetensors(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read the arrays of a file, and its metadata.

    Raises:
      InputError: the file cannot be read or is not in the format; says what is wrong with it.
    """
    try:
        with safe_open(path, framework="np") as file:
            names = file.keys()
            return {name: file.get_tensor(name) for name in names}, file.metadata() or {}
    except (OSError, SafetensorError, AttributeError, TypeError) as error:  # the latter for numbers that NumPy lacks
        raise InputError(
            f"{path}: cannot be read ({error}); give an undamaged file in the safetensors format"
        ) from None


def flattened(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Arrays of a nested dictionary under one name each, its parts joined by dots."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        flat |= flattened(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return flat


def read_weights(path: str | Path, shapes: Mapping[str, Any], tensors: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Weights of a known network among the arrays of a file, as float32.

    Args:
      path: the file, for messages.
      shapes: nested dictionary of what has the shapes that the network needs.
      tensors: the arrays of the file.

    Raises:
      InputError: one is missing or of another shape, or there are others.
    """
    wanted = {name: tuple(leaf.shape) for name, leaf in flattened(shapes).items()}
    found = {name: tensor.shape for name, tensor in tensors.items()}
    for name in sorted({**wanted, **found}):
        if wanted.get(name) != found.get(name):
            raise InputError(
                f"{path}: weights of another architecture: {name} has shape {found.get(name, 'none')}, but the "
                f"network needs {wanted.get(name, 'none')}; keep the files of one training together"
            )

    def nested(shape: Any, prefix: str) -> Any:
        if isinstance(shape, Mapping):
            return {name: nested(part, f"{prefix}{name}.") for name, part in shape.items()}
        return jnp.asarray(tensors[prefix[:-1]], jnp.float32)

    return nested(shapes, "")
