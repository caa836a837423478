"""Mid-level features of camera images (section II-B), and the encoder that computes them.

The paper uses pretrained encoders for semantic segmentation, object classification and depth. Here, one small network
is trained for these three tasks on images of the simulator (`experiments.objectnav.encoder`). Its answers to all tasks
depend on one feature vector, which is all that the network for cost maps gets.
"""

import dataclasses
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import nnx, struct
from jaxtyping import Array, Float, UInt8

from dc2g_jax.estimation import Kind, patches, read_network, with_weights
from dc2g_jax.indoor.maps.camera import VIEW_SIZE
from dc2g_jax.indoor.maps.classes import OBJECT_CLASSES

#: Side of the blocks of pixels for which the encoder is trained to answer, and rows and columns of them.
BLOCK = 4
BLOCKS = (VIEW_SIZE[0] // BLOCK, VIEW_SIZE[1] // BLOCK)


@dataclasses.dataclass(frozen=True)
class EncoderArchitecture:
    """Hyperparameters of a `SmallEncoder`.

    Attributes:
      widths: channels at 1/4, 1/8 and 1/16 of the image's resolution.
      features: length of the vector.
    """

    widths: tuple[int, int, int] = (24, 32, 48)
    features: int = 64


class SmallEncoder(nnx.Module):
    """Three layers of decreasing resolution to one vector, and decoders from this vector for the three tasks."""

    def __init__(self, architecture: EncoderArchitecture, *, rngs: nnx.Rngs):
        first, second, third = architecture.widths
        rows, columns = BLOCKS[0] // 4, BLOCKS[1] // 4
        self.take = nnx.Linear(3 * BLOCK**2, first, rngs=rngs)
        self.halve = nnx.Conv(first, second, (3, 3), strides=(2, 2), rngs=rngs)
        self.halve_again = nnx.Conv(second, third, (3, 3), strides=(2, 2), rngs=rngs)
        self.vector = nnx.Linear(rows * columns * third, architecture.features, rngs=rngs)
        self.widen = nnx.Linear(architecture.features, BLOCKS[0] * BLOCKS[1] * 8, rngs=rngs)
        self.smooth = nnx.Conv(8, 32, (3, 3), rngs=rngs)
        self.blocks = nnx.Linear(32, len(OBJECT_CLASSES) + 1, rngs=rngs)
        self.presence = nnx.Linear(architecture.features, len(OBJECT_CLASSES), rngs=rngs)

    def encode(self, images: UInt8[Array, "b 48 64 3"]) -> Float[Array, "b f"]:
        """The features of images, from -1 to 1."""
        at = patches(images, BLOCK).astype(jnp.float32) / 127.5 - 1
        for layer in (self.take, self.halve, self.halve_again):
            at = nnx.relu(layer(at))
        return jnp.tanh(self.vector(at.reshape(len(at), -1)))


@struct.dataclass
class TrainedEncoder:
    """A trained encoder.

    Attributes:
      weights: weights of `SmallEncoder`.
      architecture: architecture of `SmallEncoder`.
    """

    weights: Any
    architecture: EncoderArchitecture = struct.field(pytree_node=False)

    def encode(self, images: UInt8[Array, "b 48 64 3"]) -> Float[Array, "b f"]:
        """The features of images."""
        return with_weights(SmallEncoder, self.architecture, self.weights).encode(images)


#: Encoders as they are saved.
ENCODER = Kind(
    "encoder",
    EncoderArchitecture,
    SmallEncoder,
    "python -m experiments.objectnav_train",
    classes=OBJECT_CLASSES,
    dtype=np.float16,
)


def load_encoder(folder: str | Path) -> TrainedEncoder:
    """Read an encoder, see `estimation.read_network`."""
    _, weights, architecture, _ = read_network(folder, ENCODER)
    return TrainedEncoder(weights, architecture)
