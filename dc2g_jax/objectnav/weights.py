"""Arrays by name in one file, in the safetensors format: the length of a header, the header in JSON, then the bytes."""

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from dc2g_jax.errors import InputError

#: Names of the format for kinds of numbers.
_DTYPES: dict[str, np.dtype] = {
    "F64": np.dtype(np.float64),
    "F32": np.dtype(np.float32),
    "F16": np.dtype(np.float16),
    "BF16": np.dtype(jnp.bfloat16),
    "I64": np.dtype(np.int64),
    "I32": np.dtype(np.int32),
    "I16": np.dtype(np.int16),
    "I8": np.dtype(np.int8),
    "U8": np.dtype(np.uint8),
    "BOOL": np.dtype(np.bool_),
}
_METADATA = "__metadata__"
_LENGTH = struct.Struct("<Q")


def write_safetensors(path: str | Path, tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write arrays to a file, which is replaced at once, when all is written.

    Args:
      path: the file.
      tensors: name -> array, of a kind that the format has.
      metadata: further facts, text by name.
    """
    names = {kind: name for name, kind in _DTYPES.items()}
    header: dict[str, Any] = {_METADATA: dict(metadata)}
    parts, end = [], 0
    for name, tensor in tensors.items():
        parts.append(np.ascontiguousarray(tensor).tobytes())
        header[name] = {
            "dtype": names[tensor.dtype],
            "shape": list(tensor.shape),
            "data_offsets": [end, end + len(parts[-1])],
        }
        end += len(parts[-1])
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    unfinished = Path(path).with_name(f".{Path(path).name}.partial")
    unfinished.write_bytes(b"".join([_LENGTH.pack(len(text)), text, *parts]))
    unfinished.rename(path)


def read_safetensors(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read the arrays of a file, and its metadata.

    Raises:
      InputError: the file cannot be read or is not in the format; names the array.
    """
    path, remedy = Path(path), "give an undamaged file in the safetensors format"
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {remedy}") from None
    try:
        (length,) = _LENGTH.unpack_from(content)
        if length > len(content) - _LENGTH.size:
            raise ValueError
        header = json.loads(content[_LENGTH.size : _LENGTH.size + length])
        metadata = header.pop(_METADATA, {})
        entries = list(header.items())
    except (struct.error, ValueError, AttributeError, RecursionError, TypeError):
        raise InputError(f"{path}: has no header that says what is in it; {remedy}") from None
    data = memoryview(content)[_LENGTH.size + length :]
    tensors = {}
    for name, entry in entries:
        try:
            kind, shape = _DTYPES[entry["dtype"]], tuple(int(size) for size in entry["shape"])
            begin, end = entry["data_offsets"]
            if min(shape, default=0) < 0 or not 0 <= begin <= end <= len(data):
                raise ValueError
            if end - begin != math.prod(shape) * kind.itemsize:
                raise ValueError
            tensors[name] = np.frombuffer(data[begin:end], kind).reshape(shape)
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path}: array {name!r} is {str(entry)[:80]}, which is not there; {remedy}") from None
    return tensors, {str(key): str(value) for key, value in dict(metadata).items()}


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
                f"{path}: {name} has shape {found.get(name, 'none')}, but the network needs "
                f"{wanted.get(name, 'none')}; give a file that was written for it"
            )

    def nested(shape: Any, prefix: str) -> Any:
        if isinstance(shape, Mapping):
            return {name: nested(part, f"{prefix}{name}.") for name, part in shape.items()}
        return jnp.asarray(tensors[prefix[:-1]], jnp.float32)

    return nested(shapes, "")
