"""Mid-level features of camera images (section II-B): the interface of encoders, and two encoders.

The paper uses pretrained encoders for semantic segmentation, object classification and depth. The default here is a
small network trained for these three tasks together on images of the simulator. Its answers to all tasks depend on one
feature vector. Other encoders are read from files.
"""

import dataclasses
from pathlib import Path
from typing import Any, Protocol

import jax
import jax.numpy as jnp
from flax import nnx, struct
from jaxtyping import Array, Float, UInt8

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.compact_unet import patches
from dc2g_jax._src.estimation.weights import read_network, read_safetensors, with_weights
from dc2g_jax._src.search_indoors.maps.camera import VIEW_SIZE
from dc2g_jax._src.search_indoors.maps.classes import OBJECT_CLASSES

#: Side of the blocks of pixels for which the default encoder is trained to answer, and rows and columns of them.
BLOCK = 4
_ASKED = (VIEW_SIZE[0] // BLOCK, VIEW_SIZE[1] // BLOCK)


class ImageEncoder(Protocol):
    """Computes a vector of mid-level features of an image."""

    def encode(self, images: UInt8[Array, "b h w 3"]) -> Float[Array, "b f"]:
        """The features of images."""
        ...


def vector_size(encoder: ImageEncoder) -> int:
    """Length of an encoder's vector."""
    image = jax.ShapeDtypeStruct((1, *VIEW_SIZE, 3), jnp.uint8)
    return jax.eval_shape(lambda images: encoder.encode(images), image).shape[1]


@dataclasses.dataclass(frozen=True)
class EncoderArchitecture:
    """Hyperparameters of the default encoder.

    Attributes:
      widths: channels at 1/4, 1/8 and 1/16 of the image's resolution.
      features: length of the vector.
    """

    widths: tuple[int, int, int] = (24, 32, 48)
    features: int = 64


class Answers(struct.PyTreeNode):
    """Answers of the default encoder to the three tasks, for blocks of 4 x 4 pixels.

    Attributes:
      classes: log-odds of the class of each block.
      presence: log-odds that the image shows an object of each class.
      depth: depth of each block, tens of meters.
    """

    classes: Float[Array, "b 12 16 17"]
    presence: Float[Array, "b 17"]
    depth: Float[Array, "b 12 16"]


class SmallEncoder(nnx.Module):
    """Three layers of decreasing resolution to one vector, and decoders from this vector for the three tasks."""

    def __init__(self, architecture: EncoderArchitecture, *, rngs: nnx.Rngs):
        first, second, third = architecture.widths
        rows, columns = _ASKED[0] // 4, _ASKED[1] // 4
        self.take = nnx.Linear(3 * BLOCK**2, first, rngs=rngs)
        self.halve = nnx.Conv(first, second, (3, 3), strides=(2, 2), rngs=rngs)
        self.halve_again = nnx.Conv(second, third, (3, 3), strides=(2, 2), rngs=rngs)
        self.vector = nnx.Linear(rows * columns * third, architecture.features, rngs=rngs)
        self.widen = nnx.Linear(architecture.features, _ASKED[0] * _ASKED[1] * 8, rngs=rngs)
        self.smooth = nnx.Conv(8, 32, (3, 3), rngs=rngs)
        self.blocks = nnx.Linear(32, len(OBJECT_CLASSES) + 1, rngs=rngs)
        self.presence = nnx.Linear(architecture.features, len(OBJECT_CLASSES), rngs=rngs)

    def encode(self, images: UInt8[Array, "b 48 64 3"]) -> Float[Array, "b f"]:
        """The features of images, from -1 to 1."""
        at = patches(images, BLOCK).astype(jnp.float32) / 127.5 - 1
        for layer in (self.take, self.halve, self.halve_again):
            at = nnx.relu(layer(at))
        return jnp.tanh(self.vector(at.reshape(len(at), -1)))

    def answer(self, features: Float[Array, "b f"]) -> Answers:
        """The answers for images with these features."""
        blocks = nnx.relu(self.widen(features)).reshape(len(features), *_ASKED, 8)
        found = self.blocks(nnx.relu(self.smooth(blocks)))
        return Answers(found[..., 1:], self.presence(features), found[..., 0])


@struct.dataclass
class TrainedEncoder:
    """The default encoder, see `ImageEncoder`.

    Attributes:
      weights: weights of `SmallEncoder`.
      architecture: architecture of `SmallEncoder`.
    """

    weights: Any
    architecture: EncoderArchitecture = struct.field(pytree_node=False)

    def encode(self, images: UInt8[Array, "b 48 64 3"]) -> Float[Array, "b f"]:
        """The features of images."""
        return with_weights(SmallEncoder, self.architecture, self.weights).encode(images)


@struct.dataclass
class ConvolutionEncoder:
    """A foreign encoder, see `ImageEncoder`: convolutions with rectifiers, whose last output is the vector.

    Attributes:
      kernels: kernel of each layer with output channels first, as in PyTorch.
      biases: bias of each layer.
      stride: stride of all layers.
    """

    kernels: tuple[Float[Array, "out in rows columns"], ...]
    biases: tuple[Float[Array, "out"], ...]
    stride: int = struct.field(pytree_node=False, default=2)

    def encode(self, images: UInt8[Array, "b h w 3"]) -> Float[Array, "b f"]:
        """The features of images. Pixels are scaled to -1 to 1, and inputs of layers padded by half a kernel."""
        at = images.astype(jnp.float32).transpose(0, 3, 1, 2) / 127.5 - 1
        for kernel, bias in zip(self.kernels, self.biases, strict=True):
            padding = [(size // 2, size // 2) for size in kernel.shape[2:]]
            at = jax.lax.conv_general_dilated(at, kernel, (self.stride, self.stride), padding)
            at = nnx.relu(at + bias[:, None, None])
        return at.reshape(len(at), -1)


def load_encoder(path: str | Path) -> TrainedEncoder | ConvolutionEncoder:
    """Read an encoder from a safetensors file.

    A file with an architecture in its metadata holds the default encoder, see
    `estimation.weights.write_network`. Other files must hold a `ConvolutionEncoder`: arrays `layers.0.weight`
    [out in rows columns], `layers.0.bias` [out], `layers.1.weight` and so on, and in the metadata the `stride` of the
    layers, 2 by default. Other kinds of encoders need an implementation of `ImageEncoder`.

    Raises:
      InputError: the file cannot be read or holds no encoder.
    """
    tensors, facts = read_safetensors(path)
    if "architecture" in facts:
        return TrainedEncoder(*read_network(path, SmallEncoder, _read_architecture)[:2])
    remedy = "give a file of convolutions layers.0.weight, layers.0.bias, layers.1.weight and so on"
    names = [f"layers.{layer}.{part}" for layer in range(len(tensors) // 2) for part in ("weight", "bias")]
    if not names or sorted(names) != sorted(tensors):
        raise InputError(f"{path}: has arrays {', '.join(sorted(tensors)[:4]) or 'none'}; {remedy}")
    arrays = [jnp.asarray(tensors[name], jnp.float32) for name in names]
    kernels, biases = tuple(arrays[::2]), tuple(arrays[1::2])
    channels = 3
    for layer, (kernel, bias) in enumerate(zip(kernels, biases, strict=True)):
        if kernel.ndim != 4 or kernel.shape[1] != channels or bias.shape != kernel.shape[:1]:
            raise InputError(
                f"{path}: layer {layer} has a weight {kernel.shape} and a bias {bias.shape}, but {channels} channels "
                f"come to it; {remedy}"
            )
        channels = kernel.shape[0]
    stride = facts.get("stride", "2")
    if not stride.isdecimal() or int(stride) < 1:
        raise InputError(f"{path}: the stride is {stride!r}; write a whole number above 0 in its metadata")
    return ConvolutionEncoder(kernels=kernels, biases=biases, stride=int(stride))


def _read_architecture(facts: dict[str, Any]) -> EncoderArchitecture:
    """The architecture from JSON, which has lists instead of tuples."""
    return EncoderArchitecture(tuple(facts["widths"]), int(facts["features"]))
