"""The paper's image-to-image translator: the networks of pix2pix (section III-B; Isola et al., CVPR 2017).

Details that the paper leaves open follow the implementation it names, Hesse's pix2pix in TensorFlow: 4x4 convolutions,
weights with standard deviation 0.02, and normalization by the statistics of a batch of one image, which is instance
normalization. There are two differences. The innermost feature is not normalized: it is a single pixel, whose
normalized value would be zero. Dropout is off at inference, so that outputs are deterministic; in Hesse's, it stays on.
Four more differences are in the data, see `docs/how_it_works/estimator.md`.

With batch normalization, a trained generator uses the same statistics for all images, see `with_statistics`, and
outputs reach a little beyond black and white.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx, struct
from jaxtyping import Array, Float, UInt8

from dc2g_jax._src.estimation.checkpoints import Kind
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.estimation.weights import shapes_of_weights, with_weights
from dc2g_jax._src.grid.sampling import resize_nearest
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number
from dc2g_jax._src.runtime.programs import jit
from experiments.translator import images

_KERNEL = (4, 4)
_SPREAD = 0.02
_EPSILON = 1e-5

#: Dropout rate of the first decoder levels, and the number of these levels.
_DROPOUT, _DROPOUT_LEVELS = 0.5, 3

#: Halvings in the discriminator. Each output then has a receptive field of 70x70 pixels.
_DISCRIMINATOR_HALVINGS = 3

#: Outputs reach beyond black and white by this factor. At 1, most pixels being black or red saturates green and blue,
#: and what is near the door can stay red for thousands of steps.
_REACH = {"instance": 1.0, "batch": 1 / 0.9}

#: Data types for computations; weights are always float32.
_COMPUTE_DTYPES = {"float32": jnp.float32, "bfloat16": jnp.bfloat16}

#: Axes whose statistics normalize features in training: those of each image, or of the whole batch.
_AXES = {"instance": (1, 2), "batch": (0, 1, 2)}
Normalization = Literal["instance", "batch"]


@dataclasses.dataclass(frozen=True)
class TranslatorArchitecture:
    """Architecture of the generator and the discriminator.

    Attributes:
      size: rows and columns of the images, a power of two from 32 to 4096. The generator halves an image down to a
        single pixel: 8 times for 256.
      base_filters: channels at half the images' resolution; doubled at each further level, up to 8 times.
      compute_dtype: `float32` or `bfloat16`.
      normalization: `instance`: by the statistics of each image. `batch`: by those of the batch, and after training by
        those of some training images.
    """

    size: int = 256
    base_filters: int = 64
    compute_dtype: str = "float32"
    normalization: str = "instance"

    def __post_init__(self) -> None:
        if not 32 <= self.size <= 4096 or self.size & (self.size - 1):
            raise InputError(f"size {self.size}: give a power of two from 32 to 4096")
        check_number("base_filters", self.base_filters, whole=True, least=1, most=1024)
        check_name("compute_dtype", self.compute_dtype, _COMPUTE_DTYPES)
        check_name("normalization", self.normalization, _AXES)

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels at each level of the generator, outermost first."""
        return tuple(self.base_filters * min(2**level, 8) for level in range(self.size.bit_length() - 1))


class _Norm(nnx.Module):
    """Scale and shift of each channel."""

    def __init__(self, width: int):
        self.scale = nnx.Param(jnp.ones(width))
        self.offset = nnx.Param(jnp.zeros(width))

    def __call__(self, features: Float[Array, "b h w c"]) -> Float[Array, "b h w c"]:
        return (features.astype(jnp.float32) * self.scale[...] + self.offset[...]).astype(features.dtype)


#: Normalizes features.
_Normalize = Callable[[_Norm, Float[Array, "b h w c"]], Float[Array, "b h w c"]]


def _normalized(norm: _Norm, features: Float[Array, "b h w c"], *, axes: tuple[int, ...]) -> Float[Array, "b h w c"]:
    """Each channel with zero mean and unit variance over these axes, then scaled and shifted."""
    wide = features.astype(jnp.float32)
    mean, variance = jnp.mean(wide, axis=axes, keepdims=True), jnp.var(wide, axis=axes, keepdims=True)
    return norm((wide - mean) * jax.lax.rsqrt(variance + _EPSILON)).astype(features.dtype)


def _with_own_statistics(norm: _Norm, features: Float[Array, "b h w c"]) -> Float[Array, "b h w c"]:
    """Normalize by the batch, and fold its mean and variance into scale and offset."""
    wide = features.astype(jnp.float32)
    scale = norm.scale[...] * jax.lax.rsqrt(jnp.var(wide, axis=_AXES["batch"]) + _EPSILON)
    norm.offset[...] = norm.offset[...] - jnp.mean(wide, axis=_AXES["batch"]) * scale
    norm.scale[...] = scale
    return norm(features)


def _usual(normalization: str, *, training: bool) -> _Normalize:
    """How features are normalized in training, or by a trained network."""
    fixed = normalization == "batch" and not training
    return _Norm.__call__ if fixed else functools.partial(_normalized, axes=_AXES[normalization])


class _Doubling(nnx.Module):
    """A transposed 4x4 convolution that doubles the resolution.

    It is written as matrix products whose 4x4 blocks overlap by two. In XLA's CPU backend, gradients of a transposed
    convolution are about fifteen times slower.
    """

    def __init__(self, width_in: int, width_out: int, *, dtype: Any):
        self.kernel = nnx.Param(jnp.zeros((*_KERNEL, width_in, width_out)))
        self.bias = nnx.Param(jnp.zeros(width_out))
        self.dtype = dtype

    def __call__(self, features: Float[Array, "b h w c"]) -> Float[Array, "b h2 w2 d"]:
        batch, height, width, width_in = features.shape
        width_out = self.bias.shape[0]
        # Axes of the kernel: block row, row in the block, block column, column in the block, input, output.
        kernel = self.kernel[...].reshape(2, 2, 2, 2, width_in, width_out).transpose(0, 2, 4, 1, 3, 5)
        kernel = kernel.reshape(2, 2, width_in, 4 * width_out).astype(self.dtype)
        blocks = sum(
            jnp.pad(
                features.astype(self.dtype) @ kernel[down, right],
                ((0, 0), (down, 1 - down), (right, 1 - right), (0, 0)),
            )
            for down in (0, 1)
            for right in (0, 1)
        )
        pixels = jnp.asarray(blocks).reshape(batch, height + 1, width + 1, 2, 2, width_out).transpose(0, 1, 3, 2, 4, 5)
        pixels = pixels.reshape(batch, 2 * height + 2, 2 * width + 2, width_out)
        return pixels[:, 1:-1, 1:-1] + self.bias[...].astype(self.dtype)


class _Layer(nnx.Module):
    """A convolution with optional normalization."""

    def __init__(self, convolution: nnx.Conv | _Doubling, width: int, *, normalize: bool):
        self.convolution = convolution
        self.norm = _Norm(width) if normalize else None

    def __call__(self, features: Float[Array, "b h w c"], normalize: _Normalize) -> Float[Array, "b h2 w2 d"]:
        features = self.convolution(features)
        return features if self.norm is None else normalize(self.norm, features)


_leaky = functools.partial(jax.nn.leaky_relu, negative_slope=0.2)


def _dropped(features: Array, key: Array) -> Array:
    kept = jax.random.bernoulli(key, 1 - _DROPOUT, features.shape)
    return jnp.where(kept, features / (1 - _DROPOUT), 0).astype(features.dtype)


class Generator(nnx.Module):
    """The U-Net: an encoder down to a single pixel, and a decoder with skip connections at each level."""

    def __init__(self, architecture: TranslatorArchitecture, *, rngs: nnx.Rngs):
        widths, dtype = architecture.widths, _COMPUTE_DTYPES[architecture.compute_dtype]
        self.normalization, self.levels = architecture.normalization, len(widths)
        innermost = self.levels - 1
        for level, width in enumerate(widths):
            below, skipped = (widths[level - 1] if level else 3), (1 if level == innermost else 2)
            halve = nnx.Conv(below, width, _KERNEL, strides=2, padding=1, dtype=dtype, rngs=rngs)
            double = _Doubling(skipped * width, below, dtype=dtype)
            setattr(self, f"down{level}", _Layer(halve, width, normalize=0 < level < innermost))
            setattr(self, f"up{level}", _Layer(double, below, normalize=level > 0))

    def __call__(
        self, images: Float[Array, "b s s 3"], key: Array | None = None, normalize: _Normalize | None = None
    ) -> Float[Array, "b s s 3"]:
        """Translate images of maps to images of their cost-to-go, see `experiments.translator.images`.

        With a key, as in training: there is dropout, and batch normalization uses the batch. Without it, the output is
        deterministic. `normalize` takes the place of the architecture's normalization.
        """
        normalize = normalize or _usual(self.normalization, training=key is not None)
        features, skipped = 2 * images - 1, []
        for level in range(self.levels):
            features = getattr(self, f"down{level}")(features if level == 0 else _leaky(features), normalize)
            skipped.append(features)
        for level in reversed(range(self.levels)):
            if level < self.levels - 1:
                features = jnp.concatenate([features, skipped[level]], axis=-1)
            features = getattr(self, f"up{level}")(jax.nn.relu(features), normalize)
            if key is not None and self.levels - level <= _DROPOUT_LEVELS:
                features = _dropped(features, jax.random.fold_in(key, level))
        return (_REACH[self.normalization] * jnp.tanh(features.astype(jnp.float32)) + 1) / 2


class Discriminator(nnx.Module):
    """The 70x70 PatchGAN: for every patch, the log-odds that an image is the true one for a given input."""

    def __init__(self, architecture: TranslatorArchitecture, *, rngs: nnx.Rngs):
        filters, dtype = architecture.base_filters, _COMPUTE_DTYPES[architecture.compute_dtype]
        self.normalization = architecture.normalization
        self.layers = _DISCRIMINATOR_HALVINGS + 2
        width_in = 6
        for layer in range(self.layers):
            last = layer == self.layers - 1
            width = 1 if last else filters * 2**layer
            step = 2 if layer < _DISCRIMINATOR_HALVINGS else 1  # halves the resolution, or reduces it by one pixel
            convolution = nnx.Conv(width_in, width, _KERNEL, strides=step, padding=1, dtype=dtype, rngs=rngs)
            setattr(self, f"layer{layer}", _Layer(convolution, width, normalize=layer > 0 and not last))
            width_in = width

    def __call__(self, images: Float[Array, "b s s 3"], answers: Float[Array, "b s s 3"]) -> Float[Array, "b p q"]:
        """Log-odds for every patch of each pair of an input and an output image."""
        normalize = _usual(self.normalization, training=True)
        features = 2 * jnp.concatenate([images, answers], axis=-1) - 1
        for layer in range(self.layers):
            features = getattr(self, f"layer{layer}")(features if layer == 0 else _leaky(features), normalize)
        return features[..., 0].astype(jnp.float32)


Network = type[Generator] | type[Discriminator]


@functools.partial(jit, static_argnums=(0, 1))
def init_weights(network: Network, architecture: TranslatorArchitecture, key: Array) -> dict[str, Any]:
    """Random initial weights of either network: a nested dictionary of float32 arrays.

    All are slices of one sample, since a program that samples each array separately takes long to compile.
    """
    shapes = shapes_of_weights(network, architecture)
    leaves, structure = jax.tree_util.tree_flatten_with_path(shapes)
    ends = np.cumsum([leaf.size for _, leaf in leaves])
    draws = _SPREAD * jax.random.normal(key, (int(ends[-1]),))

    def weight(path: Any, leaf: jax.ShapeDtypeStruct, end: int) -> Array:
        own = draws[end - leaf.size : end].reshape(leaf.shape)
        return {"kernel": own, "scale": 1 + own}.get(path[-1].key, jnp.zeros(leaf.shape))

    weights = [weight(path, leaf, end) for (path, leaf), end in zip(leaves, ends.tolist(), strict=True)]
    return jax.tree_util.tree_unflatten(structure, weights)


@functools.partial(jit, static_argnums=0)
def with_statistics(
    architecture: TranslatorArchitecture, weights: dict[str, Any], images: Float[Array, "b s s 3"]
) -> dict[str, Any]:
    """The weights of a generator after training with batch normalization, to be used as they are.

    Each scale and offset includes the mean and variance of the layer's features, over these images together.
    """
    generator = with_weights(Generator, architecture, weights)
    generator(images, normalize=_with_own_statistics)
    return nnx.to_pure_dict(nnx.state(generator))


@struct.dataclass
class TranslatorCostToGo(Estimator):
    """The paper's image-to-image translator. It reads an image of the map and draws one of the cost-to-go.

    Attributes:
      weights: the generator's weights.
      architecture: architecture of the networks.
    """

    weights: Any
    architecture: TranslatorArchitecture = struct.field(pytree_node=False)
    #: Brightness is relative to the brightest cell.
    in_cells: ClassVar[bool] = False

    def translate(self, terrain: UInt8[Array, "b h w"]) -> Float[Array, "b s s 3"]:
        """Cost-to-go images of partial maps, which are first resized to the network's size."""
        size = self.architecture.size
        return self.answer(jax.vmap(lambda one: images.semantic_image(resize_nearest(one, size, size)))(terrain))

    def answer(self, pictures: Float[Array, "b s s 3"]) -> Float[Array, "b s s 3"]:
        """Cost-to-go images, quantized to 8 bits, for images of partial maps of the network's size."""
        generator = with_weights(Generator, self.architecture, self.weights)
        return jax.vmap(images.in_eight_bits)(generator(pictures))

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: tuple[()]) -> Float[Array, "1 h w *batch"]:
        """Costs read off the network's image, see `images.read_cost_to_go`."""
        del state
        height, width, *batch = terrain.shape
        maps = jnp.moveaxis(terrain.reshape(height, width, -1), -1, 0)
        costs = jax.vmap(images.read_cost_to_go)(self.translate(maps), maps)
        return jnp.moveaxis(costs, 0, -1).reshape(1, height, width, *batch)


#: Translators as they are saved.
TRANSLATOR = Kind(
    "experiments.translator.network:TRANSLATOR",
    TranslatorArchitecture,
    Generator,
    "python -m experiments.reproduce_fig5",
    TranslatorCostToGo,
)
