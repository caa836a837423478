"""A compact U-Net that maps a partial map to the cost-to-go of every cell; networks of the user's own in its place."""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float, Int, Shaped, UInt8

from dc2g_jax._src.estimation.weights import fresh_weights, shapes_of_weights, with_weights
from dc2g_jax._src.grid.terrain import CLASS_NAMES, OUTSIDE
from dc2g_jax._src.runtime.errors import InputError, check_number, short
from dc2g_jax._src.runtime.own_parts import own_part
from dc2g_jax._src.runtime.programs import apart, jit

#: Name of the class below among networks.
COMPACT_UNET = "compact_unet"

#: Largest number of channels.
_WIDEST = 4096

#: Points of interpolation for `_minimal_filtering`; a grid of n cells a side needs the first n + 1. For 5 cells a side
#: the error is at most 8e-6 of the largest value; other points that were tried are about as good.
_POINTS = (0.0, 1.0, -1.0, 2.0, -0.5, -2.0)

#: Smallest number of maps for which minimal filtering is about as fast on a CPU. Planners ask for as many at least, so
#: that a robot's estimate does not depend on the others.
LEAST_MAPS = 4


@dataclasses.dataclass(frozen=True)
class Architecture:
    """Architecture of a `CompactUNet`, or of a network of the user's own, which uses what it likes of it.

    Attributes:
      widths: channels at each scale, from the finest; each scale has half the resolution of the one before.
      quantiles: levels of the predicted quantiles of the cost-to-go, ascending, each between 0 and 1. Evenly spaced
        ones, (i + 1/2) / n, are equally likely outcomes.
      cost_scale: cells of cost-to-go per unit of the last layer's output.
      side: longer side of the training maps, in cells. A planner's larger maps are resampled to it.
      patch: side of a square patch, in cells, 16 at most. The finest scale has one position for each patch.
      embedding: number of hidden features of each patch, from which the first scale and the output are computed. With 0
        there are none: the first scale is linear in the cells of a patch, and the output uses the scales alone.
      network: `compact_unet`, or `package.module:Name` for a class of the user's own, see `make_network`.

    Raises:
      InputError: an attribute is out of its range.
    """

    widths: tuple[int, ...] = (24, 48, 96)
    quantiles: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9)
    cost_scale: float = 32.0
    side: int = 50
    patch: int = 5
    embedding: int = 64
    network: str = COMPACT_UNET

    def __post_init__(self) -> None:
        check_number("number of widths", len(self.widths), least=2, most=16)
        for width in self.widths:
            check_number("width", width, whole=True, least=1, most=_WIDEST, hint="channels")
        levels = self.quantiles
        if not levels or list(levels) != sorted(set(levels)) or not 0 < levels[0] <= levels[-1] < 1:
            raise InputError(f"quantiles {short(levels)}: give ascending levels between 0 and 1, one at least")
        check_number("cost_scale", self.cost_scale, above=0, hint="cells")
        check_number("side", self.side, whole=True, least=1, most=4096, hint="cells")
        check_number("patch", self.patch, whole=True, least=1, most=16, hint="cells")
        check_number("embedding", self.embedding, whole=True, least=0, most=_WIDEST, hint="features")


def patches(grid: Shaped[Array, "b h w c"], side: int) -> Shaped[Array, "b h2 w2 c2"]:
    """The square patches of a grid as features. Height and width are multiples of `side`."""
    batch, height, width, channels = grid.shape
    split = grid.reshape(batch, height // side, side, width // side, side, channels)
    return split.transpose(0, 1, 3, 2, 4, 5).reshape(batch, height // side, width // side, side**2 * channels)


def _one_hot_product(kernel: Array, terrain: Array, side: int) -> Array:
    """`embedded` as a matrix product."""
    return patches(jax.nn.one_hot(terrain, len(CLASS_NAMES), dtype=kernel.dtype), side) @ kernel


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def embedded(kernel: Float[Array, "c d"], terrain: UInt8[Array, "b h w"], side: int) -> Float[Array, "b h2 w2 d"]:
    """The product of the one-hot classes of each patch and `kernel`. Cells outside the map have no class.

    On a CPU, the rows of `kernel` for the cells of a patch are added, which is faster. The derivative with respect to
    `kernel` is a product on all devices.
    """

    def sums(kernel: Array, terrain: Array) -> Array:
        rows = kernel.reshape(side, side, len(CLASS_NAMES), -1)

        def of_cell(i: int, j: int) -> Array:
            return rows[i, j].at[terrain[:, i::side, j::side]].get(mode="fill", fill_value=0)

        return functools.reduce(jnp.add, itertools.starmap(of_cell, itertools.product(range(side), repeat=2)))

    product = functools.partial(_one_hot_product, side=side)
    return jax.lax.platform_dependent(kernel, terrain, cpu=functools.partial(apart, sums), default=product)


@embedded.defjvp
def _derivative_of_embedded(side: int, given: Any, tangents: Any) -> tuple[Array, Array]:
    """`embedded` is linear in `kernel`."""
    kernel, terrain = given
    return embedded(kernel, terrain, side), _one_hot_product(tangents[0], terrain, side)


def unpatched(features: Float[Array, "b h2 w2 c2"], side: int) -> Float[Array, "b h w c"]:
    """The inverse of `patches`."""
    batch, height, width, _ = features.shape
    split = features.reshape(batch, height, width, side, side, -1).transpose(0, 1, 3, 2, 4, 5)
    return split.reshape(batch, side * height, side * width, -1)


#: Rows and columns of a map in the upper left corner of a larger grid; `None` for a map that fills the grid.
Size = tuple[Int[Array, ""], Int[Array, ""]] | None


def reduced(size: Size, factor: int) -> Size:
    """The size of a map at a lower resolution. An incomplete row or column at the end counts."""
    return None if size is None else (-(-size[0] // factor), -(-size[1] // factor))


@functools.cache
def _filter_matrices(cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matrices by which three taps filter a row of cells with zeros at both ends.

    The result is `out @ ((of_cells @ row) * (of_taps @ taps))`, with `cells + 2` products instead of `3 * cells`.
    Polynomials are multiplied by multiplying their values at points, and filtering is the transpose of that.

    Returns:
      `of_cells`, `of_taps` and `out`.
    """

    def values(coefficients: int) -> np.ndarray:
        """From the coefficients of a polynomial to its values at the points and to the last coefficient itself."""
        return np.vstack([np.vander(_POINTS[: cells + 1], coefficients, increasing=True), np.eye(coefficients)[-1:]])

    # The first and the last column belong to the zeros. Rounding makes other zeros exact, which are then left out.
    return np.linalg.inv(values(cells + 2)).T[:, 1:-1].round(12), values(3), values(cells).T


def _both_axes(rows: np.ndarray, columns: np.ndarray, grid: Float[Array, "h w ..."]) -> Float[Array, "h2 w2 ..."]:
    """`rows @ grid @ columns.T`, added term by term: products of matrices as small as these are slow."""

    def weighted(weights: np.ndarray, lines: Sequence[Array]) -> Array:
        terms = [float(weight) * line for weight, line in zip(weights, lines, strict=True) if weight]
        return functools.reduce(jnp.add, terms)

    for axis, matrix in enumerate((rows, columns)):
        lines = jax.lax.split(grid, [1] * grid.shape[axis], axis)
        grid = jnp.concatenate([weighted(weights, lines) for weights in matrix], axis)
    return grid


@jit
def _minimal_filtering(features: Float[Array, "b h w c"], kernel: Float[Array, "3 3 c d"]) -> Float[Array, "b h w d"]:
    """A 3x3 convolution of small grids by Winograd's minimal filtering (Lavin and Gray, CVPR 2016)."""
    (rows, row_taps, out_rows), (columns, column_taps, out_columns) = map(_filter_matrices, features.shape[1:3])
    cells = apart(functools.partial(_both_axes, rows, columns), jnp.moveaxis(features, 0, 2))
    taps = apart(functools.partial(_both_axes, row_taps, column_taps), kernel)
    filtered = apart(functools.partial(_both_axes, out_rows, out_columns), cells @ taps)
    return jnp.moveaxis(filtered, 2, 0)


def _usual(features: Float[Array, "b h w c"], kernel: Float[Array, "3 3 c d"]) -> Float[Array, "b h w d"]:
    return jax.lax.conv_general_dilated(features, kernel, (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"))


def _filtered(features: Float[Array, "b h w c"], kernel: Float[Array, "3 3 c d"]) -> Float[Array, "b h w d"]:
    """A 3x3 convolution, on a CPU by minimal filtering."""
    return jax.lax.platform_dependent(features, kernel, cpu=_minimal_filtering, default=_usual)


_small_convolution = jax.custom_jvp(_filtered)


@_small_convolution.defjvp
def _derivative_of_small_convolution(given: Any, tangents: Any) -> tuple[Array, Array]:
    """The usual derivative with respect to the kernel: Adam would make steps of a gradient that is only rounding."""
    features, kernel = given
    return _small_convolution(*given), _filtered(tangents[0], kernel) + _usual(features, tangents[1])


def _convolved(features: Array, kernel: Array, strides: Any, padding: Any, **options: Any) -> Array:
    """`jax.lax.conv_general_dilated`, with minimal filtering on a CPU for small grids of several maps."""
    small = max(features.shape[1:3]) < len(_POINTS) and features.dtype == jnp.float32
    if strides == (1, 1) and small and features.shape[0] >= LEAST_MAPS:
        return _small_convolution(features, kernel)
    return jax.lax.conv_general_dilated(features, kernel, strides, padding, **options)


class Convolution(nnx.Conv):
    """A 3x3 convolution that sees zeros beyond the map's edge, also where the grid is larger than the map."""

    def __init__(self, width_in: int, width_out: int, *, stride: int = 1, **options: Any):
        super().__init__(
            width_in, width_out, (3, 3), strides=(stride, stride), conv_general_dilated=_convolved, **options
        )
        self.stride = stride

    def __call__(self, features: Float[Array, "b h w c"], size: Size = None) -> Float[Array, "b h2 w2 d"]:
        """Convolved features; undefined beyond the map, whose size is in cells of the features."""
        if size is None:
            return super().__call__(features)
        stride, shape = self.stride, features.shape[1:3]
        inside, first, sides = jnp.ones(shape, bool), [], []
        for axis, (side, map_side) in enumerate(zip(shape, size, strict=True)):
            inside &= jax.lax.broadcasted_iota(jnp.int32, shape, axis) < map_side
            # Padding of one cell before the first; none for an even number of cells with stride 2.
            first.append(((map_side - 1) % stride != 0).astype(jnp.int32))
            sides.append(stride * (-(-side // stride) - 1) + 3)
        features = jnp.where(inside[None, :, :, None], features, 0)
        framed = jnp.pad(features, ((0, 0), (1, stride), (1, stride), (0, 0)))
        framed = jax.lax.dynamic_slice(framed, (0, *first, 0), (len(features), *sides, features.shape[3]))
        axes = ("NHWC", "HWIO", "NHWC")
        kernel, bias = self.kernel[...], self.bias[...]  # type: ignore[index]
        return jax.lax.conv_general_dilated(framed, kernel, (stride, stride), "VALID", dimension_numbers=axes) + bias


class Residual(nnx.Module):
    """A residual block of two convolutions."""

    def __init__(self, width: int, *, rngs: nnx.Rngs):
        self.first = Convolution(width, width, rngs=rngs)
        self.second = Convolution(width, width, kernel_init=nnx.initializers.zeros, rngs=rngs)

    def __call__(self, features: Float[Array, "b h w c"], size: Size = None) -> Float[Array, "b h w c"]:
        """Refine the features."""
        return features + self.second(nnx.relu(self.first(nnx.relu(features), size)), size)


class Down(nnx.Module):
    """Halve the resolution."""

    def __init__(self, width_in: int, width_out: int, *, rngs: nnx.Rngs):
        self.halve = Convolution(width_in, width_out, stride=2, rngs=rngs)
        self.residual = Residual(width_out, rngs=rngs)

    def __call__(self, features: Float[Array, "b h w c"], size: Size = None) -> Float[Array, "b h2 w2 d"]:
        """Features at half the resolution."""
        return self.residual(self.halve(nnx.relu(features), size), reduced(size, 2))


class Up(nnx.Module):
    """Double the resolution and add the encoder's features at that scale (the U-Net's skip connection)."""

    def __init__(self, width_in: int, width_out: int, *, rngs: nnx.Rngs):
        self.narrow = nnx.Linear(width_in, width_out, rngs=rngs)
        self.residual = Residual(width_out, rngs=rngs)

    def __call__(
        self, features: Float[Array, "b h w c"], skipped: Float[Array, "b h2 w2 d"], size: Size = None
    ) -> Float[Array, "b h2 w2 d"]:
        """Features at twice the resolution, at which the map has this size."""
        narrow = self.narrow(nnx.relu(features))
        doubled = jnp.repeat(jnp.repeat(narrow, 2, axis=1), 2, axis=2)
        # Halving an odd number of rows or columns rounds up.
        return self.residual(skipped + doubled[:, : skipped.shape[1], : skipped.shape[2]], size)


class CompactUNet(nnx.Module):
    """A small U-Net from classes to quantiles of the cost-to-go, in cells.

    Classes are one-hot, so an unobserved cell (class 0) differs from a cell outside the map (all zeros). The input is
    split into patches, so all convolutions work at the resolution of the patches or less.
    """

    def __init__(self, architecture: Architecture, *, rngs: nnx.Rngs):
        widths, area, embedding = architecture.widths, architecture.patch**2, architecture.embedding
        scales = range(1, len(widths))
        self.architecture = architecture
        self.embed = nnx.Linear(area * len(CLASS_NAMES), embedding or widths[0], rngs=rngs)
        if embedding:
            self.narrow = nnx.Linear(embedding, widths[0], rngs=rngs)
            self.mix = nnx.Linear(widths[0] + embedding, embedding, rngs=rngs)
        self.local = Residual(widths[0], rngs=rngs)
        for scale in scales:
            setattr(self, f"down{scale}", Down(widths[scale - 1], widths[scale], rngs=rngs))
        self.context = Residual(widths[-1], rngs=rngs)
        for scale in reversed(scales):
            setattr(self, f"up{scale}", Up(widths[scale], widths[scale - 1], rngs=rngs))
        self.head = nnx.Linear(embedding or widths[0], area * len(architecture.quantiles), rngs=rngs)

    def __call__(self, terrain: UInt8[Array, "b h w"], size: Size = None) -> Float[Array, "b h w quantiles"]:
        """Quantiles of every cell's cost-to-go, in cells, from observed class indices (0 = not observed).

        Maps smaller than the grid, all of this size, are in its upper left corner, with `OUTSIDE` cells around.
        """
        height, width = terrain.shape[1:]
        patch, scales = self.architecture.patch, range(1, len(self.architecture.widths))
        padding = ((0, 0), (0, -height % patch), (0, -width % patch))
        filled = jnp.pad(terrain, padding, constant_values=OUTSIDE)
        kernel, bias = self.embed.kernel[...], self.embed.bias[...]  # type: ignore[index]
        first = embedded(jnp.asarray(kernel), filled, patch) + bias
        sizes = [reduced(size, patch << scale) for scale in (0, *scales)]
        local = self.narrow(nnx.relu(first)) if self.architecture.embedding else first
        encoded = [self.local(local, sizes[0])]
        for scale in scales:
            encoded.append(getattr(self, f"down{scale}")(encoded[-1], sizes[scale - 1]))
        features = self.context(encoded[-1], sizes[-1])
        for scale in reversed(scales):
            features = getattr(self, f"up{scale}")(features, encoded[scale - 1], sizes[scale - 1])
        if self.architecture.embedding:
            features = self.mix(nnx.relu(jnp.concatenate([features, first], axis=-1)))
        cells = unpatched(self.head(nnx.relu(features)), patch)[:, :height, :width]
        return self.architecture.cost_scale * (1 + cells)


def make_network(architecture: Architecture, *, rngs: nnx.Rngs) -> Any:
    """An architecture's network with random initial weights: a `CompactUNet` or one of the user's own.

    The user's class is called as `network(architecture, rngs=...)`. The network maps observed class indices, uint8
    `[b h w]` (0 = not observed), to the quantiles of every cell's cost-to-go in cells, float32 `[b h w quantiles]`, for
    maps of any size.

    Raises:
      InputError: the class cannot be imported, or is no network's.
    """
    if architecture.network == COMPACT_UNET:
        return CompactUNet(architecture, rngs=rngs)
    own = own_part("network", architecture.network, (COMPACT_UNET,))
    if not (isinstance(own, type) and issubclass(own, nnx.Module)):
        raise InputError(f"network {architecture.network!r}: is {short(own)}; give a subclass of flax.nnx.Module")
    return own(architecture, rngs=rngs)  # type: ignore[call-arg]


def check_network(architecture: Architecture) -> None:
    """Check, without computing anything, that a network of the user's own can be made and answers in the right shape.

    Raises:
      InputError: it cannot or does not; see also `make_network`.
    """
    side, name = architecture.side, architecture.network
    maps = jax.ShapeDtypeStruct((1, side, side), jnp.uint8)
    try:
        weights = shapes_of_weights(make_network, architecture)
        answer = jax.eval_shape(
            lambda weights, maps: with_weights(make_network, architecture, weights)(maps), weights, maps
        )
    except InputError:
        raise
    except Exception as error:  # whatever the user's class raises
        raise InputError(
            f"network {name!r}: cannot be made, or run on a map of {side} x {side} cells ({type(error).__name__}: "
            f"{error}); it is called as network(architecture, rngs=...)(terrain)"
        ) from error
    made = nnx.eval_shape(lambda: make_network(architecture, rngs=nnx.Rngs(0)))
    for path, kept in nnx.to_flat_state(nnx.state(made)):
        if not isinstance(kept, nnx.Param) or not jnp.issubdtype(kept.dtype, jnp.floating):
            raise InputError(
                f"network {name!r}: {'.'.join(map(str, path))} is a {type(kept).__name__} of {kept.dtype}, which is "
                "not trained; use layers of floating-point nnx.Param alone: GroupNorm in place of BatchNorm, no Dropout"
            )
    wanted = (1, side, side, len(architecture.quantiles))
    if not isinstance(answer, jax.ShapeDtypeStruct):
        raise InputError(f"network {name!r}: answers with a {type(answer).__name__}; expected one array")
    if answer.shape != wanted or not jnp.issubdtype(answer.dtype, jnp.floating):
        raise InputError(
            f"network {name!r}: answers with {answer.dtype}{list(answer.shape)} for a map of {side} x {side} cells; "
            f"expected float32{list(wanted)}"
        )


def init_weights(architecture: Architecture, key: Array) -> dict[str, Any]:
    """Random initial weights, see `estimation.weights`."""
    return fresh_weights(make_network, architecture, key)


def apply(
    architecture: Architecture, weights: dict[str, Any], terrain: UInt8[Array, "b h w"]
) -> Float[Array, "b h w quantiles"]:
    """Run the network on a batch of partial maps: quantiles of the cost-to-go in cells."""
    return with_weights(make_network, architecture, weights)(terrain)


def multiply_accumulates(architecture: Architecture, height: int, width: int) -> int:
    """Multiply-accumulates per map: half of the floating-point operations that XLA counts in its program for a GPU."""
    maps = jax.ShapeDtypeStruct((1, height, width), jnp.uint8)
    traced = jit(functools.partial(apply, architecture)).trace(shapes_of_weights(make_network, architecture), maps)
    return round((traced.lower(lowering_platforms=("cuda",)).cost_analysis() or {})["flops"] / 2)
