"""The compact network and a step of its training in PyTorch, with the weights of this package.

Importing this module needs PyTorch (`pip install torch`). Features are in the memory format `channels_last`.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import pad, relu

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.training.cost_to_go import TrainingConfig

_Weights = Mapping[str, Any]


def _loaded(layer: nn.Module, kernel: np.ndarray, weights: _Weights) -> nn.Module:
    tensors = {"weight": kernel, "bias": np.asarray(weights["bias"])}
    layer.load_state_dict({name: torch.from_numpy(np.array(array)) for name, array in tensors.items()})
    return layer.to(memory_format=torch.channels_last)


def _linear(weights: _Weights) -> nn.Module:
    kernel = np.asarray(weights["kernel"])
    return _loaded(nn.Linear(*kernel.shape), kernel.T, weights)


def _convolution(weights: _Weights, stride: int = 1) -> nn.Module:
    kernel = np.asarray(weights["kernel"])
    layer = nn.Conv2d(*kernel.shape[2:], kernel_size=3, stride=stride, padding=1 if stride == 1 else 0)
    return _loaded(layer, kernel.transpose(3, 2, 0, 1), weights)


def _of_cells(layer: nn.Module, features: Tensor) -> Tensor:
    """A linear layer of the channels."""
    return layer(features.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class _Residual(nn.Module):
    def __init__(self, weights: _Weights):
        super().__init__()
        self.first, self.second = _convolution(weights["first"]), _convolution(weights["second"])

    def forward(self, features: Tensor) -> Tensor:
        return features + self.second(relu(self.first(relu(features))))


class _Down(nn.Module):
    def __init__(self, weights: _Weights):
        super().__init__()
        self.halve, self.residual = _convolution(weights["halve"], stride=2), _Residual(weights["residual"])

    def forward(self, features: Tensor) -> Tensor:
        height, width = features.shape[2:]
        # An even number of cells is padded at the end only.
        framed = pad(relu(features), (width % 2, 1, height % 2, 1))
        return self.residual(self.halve(framed))


class _Up(nn.Module):
    def __init__(self, weights: _Weights):
        super().__init__()
        self.narrow, self.residual = _linear(weights["narrow"]), _Residual(weights["residual"])

    def forward(self, features: Tensor, skipped: Tensor) -> Tensor:
        narrow = _of_cells(self.narrow, relu(features))
        doubled = narrow.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
        return self.residual(skipped + doubled[:, :, : skipped.shape[2], : skipped.shape[3]])


class Network(nn.Module):
    """`CompactUNet` with an embedding, for maps whose sides are multiples of the patch's.

    Args:
      architecture: architecture of the network.
      weights: its weights, see `compact_unet.init_weights`.
    """

    def __init__(self, architecture: Architecture, weights: _Weights):
        super().__init__()
        self.architecture, scales = architecture, range(1, len(architecture.widths))
        self.embed, self.narrow, self.mix, self.head = (
            _linear(weights[name]) for name in ("embed", "narrow", "mix", "head")
        )
        self.local, self.context = _Residual(weights["local"]), _Residual(weights["context"])
        self.down = nn.ModuleList(_Down(weights[f"down{scale}"]) for scale in scales)
        self.up = nn.ModuleList(_Up(weights[f"up{scale}"]) for scale in scales)
        self.register_buffer("classes", torch.arange(len(CLASS_NAMES), dtype=torch.uint8))

    def forward(self, terrain: Tensor) -> Tensor:
        """Quantiles of every cell's cost-to-go, float32 [b h w quantiles], from class indices, uint8 [b h w]."""
        batch, height, width = terrain.shape
        side = self.architecture.patch
        rows, columns = height // side, width // side
        split = terrain.reshape(batch, rows, side, columns, side).transpose(2, 3)
        one_hot = (split[..., None] == self.classes).float()
        embedded = self.embed(one_hot.reshape(batch, rows, columns, -1)).permute(0, 3, 1, 2)
        encoded = [self.local(_of_cells(self.narrow, relu(embedded)))]
        for down in self.down:
            encoded.append(down(encoded[-1]))
        features = self.context(encoded.pop())
        for up, skipped in zip(reversed(self.up), reversed(encoded), strict=True):
            features = up(features, skipped)
        features = _of_cells(self.mix, relu(torch.cat([features, embedded], dim=1)))
        patches = self.head(relu(features).permute(0, 2, 3, 1)).reshape(batch, rows, columns, side, side, -1)
        cells = patches.transpose(2, 3).reshape(batch, height, width, -1)
        return self.architecture.cost_scale * (1 + cells)


class Trainer:
    """Training with the loss `quantile`: every call is an optimizer step on given pairs.

    Args:
      config: training configuration.
      weights: first weights of the network.
      compiled: whether `torch.compile` compiles loss and gradient.
    """

    def __init__(self, config: TrainingConfig, weights: _Weights, *, compiled: bool = False):
        self.network = Network(config.architecture, weights)
        self.scale, self.decay = config.architecture.cost_scale, config.average_decay
        self.levels = torch.tensor(config.architecture.quantiles)
        self.parameters = list(self.network.parameters())
        self.average = [parameter.detach().clone() for parameter in self.parameters]
        self.optimizer = torch.optim.AdamW(
            self.parameters, lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        warm = min(200, config.steps // 10)

        def rate(step: int) -> float:
            rest = (step - warm) / (config.steps - warm)
            return step / warm if step < warm else (1 + math.cos(math.pi * rest)) / 2

        self.schedule = torch.optim.lr_scheduler.LambdaLR(self.optimizer, rate)
        self._loss = torch.compile(self.loss) if compiled else self.loss

    def loss(self, terrain: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        """Mean quantile loss of pairs, see `training.losses`."""
        target = torch.where(weight > 0, target / self.scale, 0.0)
        error = target[..., None] - self.network(terrain) / self.scale
        of_cell = 2 * torch.maximum(self.levels * error, (self.levels - 1) * error).mean(-1)
        return ((of_cell * weight).sum((1, 2)) / weight.sum((1, 2)).clamp(min=1e-6)).mean()

    def __call__(self, terrain: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        """Take a step; the loss before it."""
        self.optimizer.zero_grad()
        loss = self._loss(terrain, target, weight)
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters, 1.0)
        self.optimizer.step()
        step = self.schedule.last_epoch
        self.schedule.step()
        with torch.no_grad():
            kept = min(self.decay, (1 + step) / (10 + step))
            torch._foreach_lerp_(self.average, self.parameters, 1 - kept)
        return loss.detach()
