"""The compact network and a step of its training in PyTorch, from the weights of this package.

Importing this module needs PyTorch (`pip install torch`). Of equivalent operations, those are used that PyTorch ran
fastest on a CPU: `channels_last`, an embedding bag instead of one-hot classes, 1x1 convolutions instead of `Linear`.
On a busy machine, set `OMP_WAIT_POLICY=PASSIVE`.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import embedding_bag, interpolate, pad, relu

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.training.cost_to_go import TrainingConfig

_Weights = Mapping[str, Any]


def tensors(*arrays: Any) -> list[Tensor]:
    """Copies of arrays."""
    return [torch.from_numpy(np.array(array)) for array in arrays]


def _parameter(array: Any) -> nn.Parameter:
    (tensor,) = tensors(array)
    return nn.Parameter(tensor.contiguous(memory_format=torch.channels_last) if tensor.ndim == 4 else tensor)


class _Convolution(nn.Conv2d):
    """A 3x3 convolution, or a linear layer of the channels."""

    def __init__(self, weights: _Weights, stride: int):
        kernel = np.asarray(weights["kernel"])
        kernel = kernel.reshape((1, 1, *kernel.shape)[-4:])
        side, _, width_in, width_out = kernel.shape
        super().__init__(width_in, width_out, side, stride, padding=side // 2 if stride == 1 else 0)
        self.weight, self.bias = _parameter(kernel.transpose(3, 2, 0, 1)), _parameter(weights["bias"])

    def forward(self, features: Tensor) -> Tensor:
        if self.stride[0] == 2:  # an even number of cells is padded at the end only
            features = pad(features, (features.shape[3] % 2, 1, features.shape[2] % 2, 1))
        return super().forward(features)


def _layers(weights: _Weights, name: str = "") -> nn.Module:
    if "kernel" in weights:
        return _Convolution(weights, stride=2 if name == "halve" else 1)
    return nn.ModuleDict({name: _layers(of_name, name) for name, of_name in weights.items()})


def _residual(layers: Any, features: Tensor) -> Tensor:
    return features + layers["second"](relu(layers["first"](relu(features))))


class Network(nn.Module):
    """`CompactUNet` with an embedding, for maps whose sides are multiples of the patch's.

    Args:
      architecture: architecture of the network.
      weights: its weights, see `compact_unet.init_weights`.
    """

    def __init__(self, architecture: Architecture, weights: _Weights):
        super().__init__()
        self.architecture = architecture
        self.layers: Any = _layers({name: of_name for name, of_name in weights.items() if name != "embed"})
        self.embed, self.embed_bias = _parameter(weights["embed"]["kernel"]), _parameter(weights["embed"]["bias"])
        self.register_buffer("first_row", len(CLASS_NAMES) * torch.arange(architecture.patch**2, dtype=torch.int32))

    def forward(self, terrain: Tensor) -> Tensor:
        """Quantiles of every cell's cost-to-go, float32 [b h w quantiles], from class indices, uint8 [b h w]."""
        layers, side, scales = self.layers, self.architecture.patch, range(1, len(self.architecture.widths))
        batch, rows, columns = len(terrain), terrain.shape[1] // side, terrain.shape[2] // side
        patches = terrain.reshape(batch, rows, side, columns, side).transpose(2, 3)
        embedded = embedding_bag(patches.reshape(-1, side**2) + self.first_row, self.embed, mode="sum")
        embedded = (embedded + self.embed_bias).view(batch, rows, columns, -1).permute(0, 3, 1, 2)
        encoded = [_residual(layers["local"], layers["narrow"](relu(embedded)))]
        for scale in scales:
            down = layers[f"down{scale}"]
            encoded.append(_residual(down["residual"], down["halve"](relu(encoded[-1]))))
        features = _residual(layers["context"], encoded.pop())
        for scale in reversed(scales):
            up, skipped = layers[f"up{scale}"], encoded.pop()
            doubled = interpolate(up["narrow"](relu(features)), scale_factor=2, mode="nearest")
            features = _residual(up["residual"], skipped + doubled[:, :, : skipped.shape[2], : skipped.shape[3]])
        features = layers["mix"](relu(torch.cat([features, embedded], dim=1)))
        cells = layers["head"](relu(features)).permute(0, 2, 3, 1).reshape(batch, rows, columns, side, side, -1)
        return self.architecture.cost_scale * (1 + cells.transpose(2, 3).reshape(*terrain.shape, -1))


def estimator(architecture: Architecture, weights: _Weights, *, compiled: bool = False) -> Callable[[Tensor], Tensor]:
    """The network as a function, without gradients; `torch.compile` may compile it."""
    network = Network(architecture, weights)
    return torch.inference_mode()(torch.compile(network, dynamic=False) if compiled else network)


class Trainer:
    """Training with the loss `quantile`; each call is an optimizer step on given pairs.

    Args:
      config: training configuration.
      weights: weights before the first step.
      compiled: whether `torch.compile` compiles the network; with the loss, it was slower.
    """

    def __init__(self, config: TrainingConfig, weights: _Weights, *, compiled: bool = False):
        self.config, self.network = config, Network(config.architecture, weights)
        self.estimate = torch.compile(self.network, dynamic=False) if compiled else self.network
        self.levels = torch.tensor(config.architecture.quantiles)
        self.weights = list(self.network.parameters())
        self.average = [weight.detach().clone() for weight in self.weights]
        self.optimizer = torch.optim.AdamW(
            self.weights, config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        warm, steps = min(200, config.steps // 10), config.steps

        def rate(step: int) -> float:
            return step / warm if step < warm else (1 + math.cos(math.pi * (step - warm) / (steps - warm))) / 2

        self.schedule = torch.optim.lr_scheduler.LambdaLR(self.optimizer, rate)

    def __call__(self, terrain: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        """Take a step; returns the loss before it."""
        self.optimizer.zero_grad()
        scale, step = self.config.architecture.cost_scale, self.schedule.last_epoch
        error = (torch.where(weight > 0, target, 0.0)[..., None] - self.estimate(terrain)) / scale
        of_cell = 2 * (self.levels * error + relu(-error)).mean(-1)
        loss = ((of_cell * weight).sum((1, 2)) / weight.sum((1, 2)).clamp(min=1e-6)).mean()
        loss.backward()
        nn.utils.clip_grad_norm_(self.weights, 1.0)
        self.optimizer.step()
        self.schedule.step()
        kept = min(self.config.average_decay, (1 + step) / (10 + step))
        with torch.no_grad():
            torch._foreach_lerp_(self.average, self.weights, 1 - kept)
        return loss.detach()
