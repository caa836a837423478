"""Mid-level features of camera images (section II-B): the interface of encoders, and two encoders.

The paper uses pretrained encoders for semantic segmentation, object classification and depth. The default here is a
small network trained for these three tasks together on images of the simulator. Its answers to all tasks depend on one
feature vector. Other encoders are read from files.
"""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import optax
from flax import nnx, struct
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.compact_unet import patches
from dc2g_jax._src.estimation.weights import fresh_weights, read_network, read_safetensors, with_weights
from dc2g_jax._src.programs import jit
from dc2g_jax._src.rollouts.devices import first_copy, mesh_for_batch, replicate
from dc2g_jax._src.search_indoors.maps.camera import VIEW_SIZE, CameraView
from dc2g_jax._src.search_indoors.maps.classes import OBJECT_CLASSES
from dc2g_jax._src.training.loop import Losses, Task
from dc2g_jax._src.training.step import Supervised, TrainingState, state_of, supervised_step

#: Side of the blocks of pixels for which the default encoder is trained to answer, and rows and columns of them.
_BLOCK = 4
_ASKED = (VIEW_SIZE[0] // _BLOCK, VIEW_SIZE[1] // _BLOCK)

#: Least number of pixels of a class that counts as present in an image, and the depth at which errors are cut, meters.
_PRESENT, _FAR = 12, 10.0

#: Largest number of images for validation.
_VALIDATION_VIEWS = 512


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
        self.take = nnx.Linear(3 * _BLOCK**2, first, rngs=rngs)
        self.halve = nnx.Conv(first, second, (3, 3), strides=(2, 2), rngs=rngs)
        self.halve_again = nnx.Conv(second, third, (3, 3), strides=(2, 2), rngs=rngs)
        self.vector = nnx.Linear(rows * columns * third, architecture.features, rngs=rngs)
        self.widen = nnx.Linear(architecture.features, _ASKED[0] * _ASKED[1] * 8, rngs=rngs)
        self.smooth = nnx.Conv(8, 32, (3, 3), rngs=rngs)
        self.blocks = nnx.Linear(32, len(OBJECT_CLASSES) + 1, rngs=rngs)
        self.presence = nnx.Linear(architecture.features, len(OBJECT_CLASSES), rngs=rngs)

    def encode(self, images: UInt8[Array, "b 48 64 3"]) -> Float[Array, "b f"]:
        """The features of images, from -1 to 1."""
        at = patches(images, _BLOCK).astype(jnp.float32) / 127.5 - 1
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


def task_losses(answers: Answers, views: CameraView) -> dict[str, Float[Array, ""]]:
    """Mean losses of the three tasks over a batch: cross entropies in nats, error of the depth in tens of meters."""
    classes = views.classes[:, _BLOCK // 2 :: _BLOCK, _BLOCK // 2 :: _BLOCK]
    depth = views.depth[:, _BLOCK // 2 :: _BLOCK, _BLOCK // 2 :: _BLOCK]
    present = jnp.sum(jax.nn.one_hot(views.classes, len(OBJECT_CLASSES)), axis=(1, 2)) >= _PRESENT
    error = jnp.abs(answers.depth - jnp.minimum(depth, _FAR) / 10)
    return {
        "segmentation": jnp.mean(optax.softmax_cross_entropy_with_integer_labels(answers.classes, classes)),
        "presence": jnp.mean(optax.sigmoid_binary_cross_entropy(answers.presence, present)),
        "depth": jnp.sum(jnp.where(depth > 0, error, 0)) / jnp.maximum(jnp.sum(depth > 0), 1),
    }


@dataclasses.dataclass(frozen=True)
class EncoderTraining(Supervised):
    """Training of the default encoder on images.

    Attributes:
      architecture: architecture of the encoder.
      steps: number of optimizer steps.
      batch_size: images per step.
      seed: seed of weights and batches.
    """

    architecture: EncoderArchitecture
    steps: int
    batch_size: int = 64
    seed: int = 0

    def first_state(self) -> TrainingState:
        """The state before the first step."""
        weights = fresh_weights(SmallEncoder, self.architecture, jax.random.key(self.seed))
        return state_of(weights, self.optimizer())

    def optimizer(self) -> optax.GradientTransformation:
        """Adam, with a cosine decay of the learning rate to zero."""
        return optax.adam(optax.cosine_decay_schedule(2e-3, max(self.steps, 1)))

    def draw(self, data: CameraView, step: Int[Array, ""]) -> CameraView:
        """Random images."""
        key = jax.random.fold_in(jax.random.key(self.seed + 1), step)
        chosen = jax.random.randint(key, (self.batch_size,), 0, len(data.image))
        return jax.tree.map(lambda leaf: leaf[chosen], data)

    def losses(self, weights: Any, views: CameraView) -> dict[str, Float[Array, ""]]:
        """See `task_losses`."""
        network = with_weights(SmallEncoder, self.architecture, weights)
        return task_losses(network.answer(network.encode(views.image)), views)

    def gradient(self, state: TrainingState, data: CameraView, batch: CameraView) -> tuple[Float[Array, ""], Any]:
        """The sum of the losses, and its gradient."""
        return jax.value_and_grad(lambda weights: sum(self.losses(weights, batch).values(), jnp.float32(0)))(
            state.weights
        )


def encoder_task(
    training: EncoderTraining, views: CameraView, save: Callable[[TrainedEncoder, dict[str, float]], None]
) -> Task[TrainingState]:
    """The task of training the default encoder. The result is reproducible by seed to the bit.

    Args:
      training: the training.
      views: all images.
      save: called at each validation with the encoder and its losses on the first images.
    """
    losses = jit(training.losses)

    def validate(state: TrainingState, step: int, loss: Losses | None) -> list[dict[str, float]]:
        weights = first_copy(state.weights)
        found = {name: float(loss) for name, loss in losses(weights, validation_views).items()}
        save(TrainedEncoder(weights=weights, architecture=training.architecture), found)
        return [{"step": step, **found}]

    validation_views = jax.tree.map(lambda leaf: leaf[:_VALIDATION_VIEWS], views)
    mesh = mesh_for_batch(training.batch_size)
    views, place = replicate(views, mesh), functools.partial(replicate, mesh=mesh)
    step = functools.partial(supervised_step, data=views, training=training, mesh=mesh)
    return Task(training.steps, training.first_state, step, validate, place=place, name="encoder")
