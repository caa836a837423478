"""The ONNX graph of a compact network."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from dc2g_jax.estimation import NetworkCostToGo
from dc2g_jax.files import arrays_sha256, replacing
from dc2g_jax.grid import CLASS_NAMES
from dc2g_jax.runtime import InputError, require_extra

require_extra("onnx", extra="onnx")
import onnx  # noqa: E402

#: Versions of the operators and of the format, which runtimes from 2023 on can read.
_OPERATORS, _FORMAT = 18, 9


class _Graph:
    """Nodes and constants of a graph. Features have the axes n, channels, rows, columns."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, operator: str, *inputs: Any, **attributes: Any) -> str:
        """Add a node. Inputs are names of other nodes' outputs, or constants. Returns the name of its output."""
        names = []
        for value in inputs:
            if not isinstance(value, str):
                value, constant = f"constant_{len(self.constants)}", onnx.numpy_helper.from_array(np.asarray(value))
                constant.name = value
                self.constants.append(constant)
            names.append(value)
        name = f"{operator}_{len(self.nodes)}"
        self.nodes.append(onnx.helper.make_node(operator, names, [name], name=name, **attributes))
        return name

    def conv(self, features: str, kernel: Any, bias: Any, stride: int = 1, **padding: Any) -> str:
        """A convolution with a kernel [rows, columns, in, out], padded as Flax pads unless `padding` says otherwise."""
        kernel = np.transpose(kernel, (3, 2, 0, 1))
        padding = padding or {"auto_pad": "SAME_UPPER"}
        return self.add("Conv", features, kernel, bias, strides=[stride, stride], **padding)

    def linear(self, features: str, weights: Mapping[str, Any]) -> str:
        return self.conv(self.add("Relu", features), weights["kernel"][None, None], weights["bias"])

    def residual(self, features: str, weights: Mapping[str, Any]) -> str:
        refined = features
        for layer in ("first", "second"):
            refined = self.conv(self.add("Relu", refined), **weights[layer])
        return self.add("Add", features, refined)

    def down(self, features: str, weights: Mapping[str, Any]) -> str:
        halved = self.conv(self.add("Relu", features), **weights["halve"], stride=2)
        return self.residual(halved, weights["residual"])

    def up(self, features: str, skipped: str, weights: Mapping[str, Any]) -> str:
        repeated = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        narrow = self.linear(features, weights["narrow"])
        doubled = self.add("Resize", narrow, "", np.array([1, 1, 2, 2], np.float32), **repeated)
        cropped = self.cropped(doubled, self.add("Shape", skipped, start=2))
        return self.residual(self.add("Add", skipped, cropped), weights["residual"])

    def cropped(self, features: str, shape: str) -> str:
        return self.add("Slice", features, np.array([0, 0]), shape, np.array([2, 3]))


def _add_network(graph: _Graph, network: NetworkCostToGo) -> str:
    """Add the nodes of `estimation.compact_unet.CompactUNet`, from `classes` to the quantiles in cells."""
    weights, count = jax.tree.map(np.asarray, network.weights), len(CLASS_NAMES)
    patch, scales = network.architecture.patch, range(1, len(network.architecture.widths))
    indices = graph.add("Cast", "classes", to=onnx.TensorProto.INT64)
    classes = graph.add("OneHot", indices, np.int64(count), np.array([0, 1], np.float32), axis=1)
    # A linear map of each patch is a convolution whose kernel and stride are the patch's side.
    kernel, pads = weights["embed"]["kernel"].reshape(patch, patch, count, -1), [0, 0, patch - 1, patch - 1]
    embedded = graph.conv(classes, kernel, weights["embed"]["bias"], stride=patch, pads=pads)
    finest = graph.linear(embedded, weights["narrow"]) if network.architecture.embedding else embedded
    encoded = [graph.residual(finest, weights["local"])]
    for scale in scales:
        encoded.append(graph.down(encoded[-1], weights[f"down{scale}"]))
    features = graph.residual(encoded[-1], weights["context"])
    for scale in reversed(scales):
        features = graph.up(features, encoded[scale - 1], weights[f"up{scale}"])
    if network.architecture.embedding:
        features = graph.linear(graph.add("Concat", features, embedded, axis=1), weights["mix"])
    cells = graph.add("DepthToSpace", graph.linear(features, weights["head"]), blocksize=patch, mode="DCR")
    scaled = graph.add("Mul", graph.add("Add", cells, np.float32(1)), np.float32(network.architecture.cost_scale))
    return graph.cropped(scaled, graph.add("Shape", "classes", start=1))


def export_onnx(network: Any, path: str | Path) -> None:
    """Write a compact network as an ONNX file.

    Its input `classes` is uint8 [n, h, w], observed class indices (0 = not observed) of maps of any number and size.
    Its output `quantiles` is float32 [n, quantiles, h, w], the cost-to-go in cells. The file's metadata are JSON:
    `classes`, `quantiles`, `cost_scale`, `side` (planners resample larger maps) and `sha256` of the weights.

    Args:
      network: a `NetworkCostToGo`.
      path: the file; replaced if it exists.

    Raises:
      InputError: the network is of another kind or one of the user's own, or the file cannot be written.
    """
    if not getattr(network, "is_compact", False):
        raise InputError("only compact networks can be exported; give one from `dc2g train` without --architecture")
    graph, architecture = _Graph(), network.architecture
    found = _add_network(graph, network)
    graph.nodes.append(onnx.helper.make_node("Identity", [found], ["quantiles"]))
    classes = onnx.helper.make_tensor_value_info("classes", onnx.TensorProto.UINT8, ["n", "h", "w"])
    sizes: list[str | int | None] = ["n", len(architecture.quantiles), "h", "w"]
    quantiles = onnx.helper.make_tensor_value_info("quantiles", onnx.TensorProto.FLOAT, sizes)
    whole = onnx.helper.make_graph(graph.nodes, "compact_unet", [classes], [quantiles], graph.constants)
    model = onnx.helper.make_model(whole, opset_imports=[onnx.helper.make_opsetid("", _OPERATORS)], ir_version=_FORMAT)
    facts = {
        "classes": CLASS_NAMES,
        "quantiles": architecture.quantiles,
        "cost_scale": architecture.cost_scale,
        "side": architecture.side,
        "sha256": arrays_sha256(network.weights),
    }
    onnx.helper.set_model_props(model, {name: json.dumps(value) for name, value in facts.items()})
    onnx.checker.check_model(model, full_check=True)
    try:
        with replacing(path) as unfinished:
            unfinished.write_bytes(model.SerializeToString())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another file") from None
