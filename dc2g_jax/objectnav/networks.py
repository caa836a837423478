"""The network that reads a partial indoor map and writes a dense cost map (section II-B, Fig. 2).

A U-Net: one encoder, and two decoders of one shape, for occupancy and for navigation cost. At the bottleneck the
encoder's features are joined by the embedding of the target, the same everywhere, and by the mid-level features of what
the camera sees, in the region of the map that it looks at (Fig. 3).

The map's 36 channels are those of two maps, as `dc2g_jax.objectnav.mapping.network_input` makes them: the local one,
and the global one around the same middle, averaged over 3x3 cells. Each has 16 semantic classes, then obstacle, then
explored.
"""

import dataclasses
import functools
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx, struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Integer, UInt8

from dc2g_jax.errors import InputError
from dc2g_jax.estimation.networks.compact_unet import Down, Residual, Up
from dc2g_jax.estimation.weights import flattened, read_safetensors, read_weights, write_safetensors
from dc2g_jax.objectnav.classes import GOALS, OBJECT_CLASSES, SEMANTIC_CLASSES
from dc2g_jax.objectnav.mapping import MAP_CHANNELS

#: Channels of the network's input: of the local map, then of the global one.
INPUT_CHANNELS = 2 * MAP_CHANNELS

#: The directions that the robot may look in, 45 degrees each (Fig. 3).
BINS = 8

#: Heading bin -> row and column of its region, of three by three, north being row 0. The first is east, then turning
#: to the left: north is the paper's third.
_REGIONS = ((1, 2), (0, 2), (0, 1), (0, 0), (1, 0), (2, 0), (2, 1), (2, 2))


class Inputs(NamedTuple):
    """What a network is shown of what is known (section IV-C). Obstacles and explored cells always are.

    Attributes:
      semantics: the channels of semantic classes.
      features: the mid-level features.
    """

    semantics: bool
    features: bool


SEMANTIC_ONLY, MIDLEVEL_ONLY, BOTH = Inputs(True, False), Inputs(False, True), Inputs(True, True)

#: Ablations by name (Table II).
ABLATIONS = {"both": BOTH, "semantic": SEMANTIC_ONLY, "midlevel": MIDLEVEL_ONLY}


@dataclasses.dataclass(frozen=True)
class CostMapArchitecture:
    """What it takes to build a `CostMapNetwork` again. Defaults are made for two cores of a CPU.

    Attributes:
      patch: side of the square of cells that the first layer takes as one, a divisor of the map's sides.
      widths: channels at the resolution of patches, at half of it, and so on down to the bottleneck; at least two.
      embedding: numbers that stand for a target.
      features: length of the vector of mid-level features.
      feature_width: channels in which they come to the bottleneck.
      inputs: what the network is shown.

    Raises:
      InputError: a number makes no sense.
    """

    patch: int = 4
    widths: tuple[int, ...] = (24, 48, 96, 120)
    embedding: int = 64
    features: int = 64
    feature_width: int = 64
    inputs: Inputs = BOTH

    def __post_init__(self) -> None:
        if len(self.widths) < 2 or min(self.widths) < 1:
            raise InputError(f"widths {' '.join(map(str, self.widths))}: give at least two, none below 1")
        for name in ("patch", "embedding", "features", "feature_width"):
            if getattr(self, name) < 1:
                raise InputError(f"{name.replace('_', ' ')} {getattr(self, name)}: give at least 1")


@struct.dataclass
class Prediction:
    """What the network answers.

    Attributes:
      occupancy_logits: log-odds that there is no free floor in a cell.
      cost: navigation cost, in the unit of the labels that the network was trained on.
    """

    occupancy_logits: Float[Array, "*b h w"]
    cost: Float[Array, "*b h w"]

    @property
    def occupancy(self) -> Float[Array, "*b h w"]:
        """Probability that there is no free floor in a cell."""
        return jax.nn.sigmoid(self.occupancy_logits)


def fused_cost(
    occupancy: Float[Array, "*b h w"], cost: Float[Array, "*b h w"], threshold: ArrayLike = 0.5
) -> Float[Array, "*b h w"]:
    """The final cost map: the navigation cost, infinite in cells more likely occupied than a threshold.

    Args:
      occupancy: probability that there is no free floor in a cell.
      cost: navigation cost.
      threshold: of the probability, above 0 and below 1 (the paper's theta_occ).
    """
    return jnp.where(occupancy > threshold, jnp.inf, cost)


def heading_bin(heading: Float[Array, "*b"]) -> Int[Array, "*b"]:
    """The bin of a heading in radians, counter-clockwise from east: 0 is within 22.5 degrees of east, 2 of north."""
    return jnp.round(heading * (BINS / (2 * math.pi))).astype(jnp.int32) % BINS


def bin_regions(height: int, width: int) -> Bool[np.ndarray, "bin h w"]:
    """The region of each heading bin on a map with north above: an outer one of three by three (Fig. 3)."""
    row, column = ((3 * np.arange(size) // size) for size in (height, width))
    return np.stack([(row == above)[:, None] & (column == beside) for above, beside in _REGIONS])


def oriented_features(
    features: Float[Array, "b f"], heading: Float[Array, "b"], height: int, width: int
) -> Float[Array, "b h w f"]:
    """Mid-level features in the region that the robot looks at, 0 elsewhere (Fig. 3)."""
    regions = jnp.asarray(bin_regions(height, width), features.dtype)
    return regions[heading_bin(heading)][..., None] * features[:, None, None, :]


def _patches(grid: Float[Array, "b c h w"], side: int) -> Float[Array, "b h2 w2 c2"]:
    """The squares of the grid as features."""
    batch, channels, height, width = grid.shape
    split = grid.reshape(batch, channels, height // side, side, width // side, side)
    return split.transpose(0, 2, 4, 3, 5, 1).reshape(batch, height // side, width // side, side * side * channels)


def _unpatched(features: Float[Array, "b h2 w2 c"], side: int) -> Float[Array, "b h w"]:
    """A square's features as its cells."""
    batch, rows, columns, _ = features.shape
    split = features.reshape(batch, rows, columns, side, side).transpose(0, 1, 3, 2, 4)
    return split.reshape(batch, side * rows, side * columns)


class _Decoder(nnx.Module):
    """From the bottleneck back to one number a cell: one a patch, smoothly spread, and what its cells differ by."""

    def __init__(self, architecture: CostMapArchitecture, width_in: int, *, rngs: nnx.Rngs):
        widths = architecture.widths
        self.levels, self.patch = len(widths) - 1, architecture.patch
        self.narrow = nnx.Linear(width_in, widths[-1], rngs=rngs)
        self.context = Residual(widths[-1], rngs=rngs)
        for level in range(self.levels):
            setattr(self, f"up{level}", Up(widths[level + 1], widths[level], rngs=rngs))
        self.coarse = nnx.Linear(widths[0], 1, rngs=rngs)
        self.fine = nnx.Linear(widths[0], self.patch**2, kernel_init=nnx.initializers.zeros, rngs=rngs)

    def __call__(
        self, bottleneck: Float[Array, "b h w c"], skipped: list[Float[Array, "b _ _ _"]]
    ) -> Float[Array, "b h2 w2"]:
        features = self.context(self.narrow(bottleneck))
        for level in reversed(range(self.levels)):
            features = getattr(self, f"up{level}")(features, skipped[level])
        fine = _unpatched(self.fine(nnx.relu(features)), self.patch)
        return fine + jax.image.resize(self.coarse(nnx.relu(features))[..., 0], fine.shape, "bilinear")


class CostMapNetwork(nnx.Module):
    """The U-Net of Fig. 2. What the local map shows of a cell goes to the end of the occupancy's decoder as well."""

    def __init__(self, architecture: CostMapArchitecture, *, rngs: nnx.Rngs):
        widths, wide = architecture.widths, architecture.feature_width
        self.architecture = architecture
        self.embed = nnx.Linear(INPUT_CHANNELS * architecture.patch**2, widths[0], rngs=rngs)
        self.first = Residual(widths[0], rngs=rngs)
        for level in range(len(widths) - 1):
            setattr(self, f"down{level}", Down(widths[level], widths[level + 1], rngs=rngs))
        self.target = nnx.Embed(len(GOALS), architecture.embedding, rngs=rngs)
        self.view = nnx.Linear(architecture.features, wide, rngs=rngs)
        joined = widths[-1] + architecture.embedding + wide
        self.occupancy = _Decoder(architecture, joined, rngs=rngs)
        self.cost = _Decoder(architecture, joined, rngs=rngs)
        self.cell = nnx.Param(jnp.zeros(MAP_CHANNELS))

    def __call__(
        self,
        maps: Float[Array, "b 36 h w"],
        target: Integer[Array, "b"],
        heading: Float[Array, "b"],
        features: Float[Array, "b f"],
    ) -> Prediction:
        """Predict for a batch; see `apply`."""
        inputs = self.architecture.inputs
        if not inputs.semantics:
            semantic = np.arange(INPUT_CHANNELS) % MAP_CHANNELS < SEMANTIC_CLASSES
            maps = maps * jnp.asarray(~semantic, maps.dtype)[:, None, None]
        at = self.first(self.embed(_patches(maps, self.architecture.patch)))
        skipped = [at]
        for level in range(len(self.architecture.widths) - 1):
            at = getattr(self, f"down{level}")(at)
            skipped.append(at)
        batch, height, width, _ = at.shape
        goal = jnp.broadcast_to(self.target(target)[:, None, None], (batch, height, width, self.architecture.embedding))
        view = oriented_features(nnx.relu(self.view(features)), heading, height, width)
        bottleneck = jnp.concatenate([nnx.relu(at), goal, view if inputs.features else jnp.zeros_like(view)], axis=-1)
        local = jnp.einsum("bchw,c->bhw", maps[:, :MAP_CHANNELS], self.cell[...])
        return Prediction(
            occupancy_logits=self.occupancy(bottleneck, skipped) + local,
            cost=self.cost(bottleneck, skipped),
        )


def init_weights(architecture: CostMapArchitecture, key: Array) -> dict[str, Any]:
    """Fresh weights: a nested dictionary of float32 arrays."""
    return nnx.to_pure_dict(nnx.split(CostMapNetwork(architecture, rngs=nnx.Rngs(key)))[1])


def weight_shapes(architecture: CostMapArchitecture) -> dict[str, Any]:
    """What `init_weights` would give, as shapes and dtypes only."""
    return jax.eval_shape(functools.partial(init_weights, architecture), jax.random.key(0))


def apply(
    architecture: CostMapArchitecture,
    weights: dict[str, Any],
    maps: Float[Array, "b 36 h w"] | UInt8[Array, "b 36 h w"],
    target: Integer[Array, "b"],
    heading: Float[Array, "b"],
    features: Float[Array, "b f"],
) -> Prediction:
    """Run the network on a batch.

    Args:
      architecture: the network.
      weights: nested dictionary of arrays; computed with in float32.
      maps: north above, the robot in the middle. Shares of a cell from 0 to 1, or bytes of which 255 is 1. Sides are
        multiples of the architecture's patch.
      target: what to look for, an index into `dc2g_jax.objectnav.classes.GOALS`.
      heading: where the camera looks, counter-clockwise from east, radians.
      features: mid-level features of what it sees; what they are does not matter to a network that is shown none.
    """
    if maps.dtype == jnp.uint8:
        maps = maps.astype(jnp.float32) / 255
    graph, state = nnx.split(nnx.eval_shape(lambda: CostMapNetwork(architecture, rngs=nnx.Rngs(0))))
    nnx.replace_by_pure_dict(state, jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), weights))
    return nnx.merge(graph, state)(maps, target, heading, features.astype(jnp.float32))


@struct.dataclass
class CostMapEstimator:
    """A trained network.

    Attributes:
      weights: see `init_weights`; of any width of float.
      architecture: the network.
    """

    weights: Any
    architecture: CostMapArchitecture = struct.field(pytree_node=False)

    def estimate(
        self,
        maps: Float[Array, "36 h w"] | UInt8[Array, "36 h w"],
        target: Integer[Array, ""],
        features: Float[Array, "f"],
        heading: Float[Array, ""],
    ) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
        """Probability of occupancy and navigation cost for one robot; see `apply`."""
        one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (maps, target, heading, features))
        prediction = apply(self.architecture, self.weights, *one)
        return prediction.occupancy[0], prediction.cost[0]


def save_estimator(path: str | Path, estimator: CostMapEstimator, facts: dict[str, Any]) -> None:
    """Write a network to a safetensors file, in half precision, with what it takes to build it again.

    Args:
      path: the file; replaced if there is one.
      estimator: what to save.
      facts: what to know about it, its card; values go into JSON.
    """
    tensors = {name: np.asarray(leaf, np.float16) for name, leaf in flattened(estimator.weights).items()}
    architecture = json.dumps(dataclasses.asdict(estimator.architecture))
    card = json.dumps({"channels": INPUT_CHANNELS, "classes": OBJECT_CLASSES, **facts})
    write_safetensors(path, tensors, {"architecture": architecture, "card": card})


def load_estimator(path: str | Path) -> tuple[CostMapEstimator, dict[str, Any]]:
    """Read a network and its card.

    Raises:
      InputError: the file cannot be read, or holds no such network, or one for other classes.
    """
    tensors, facts = read_safetensors(path)
    remedy = "give a network written by `dc2g objectnav train`"
    try:
        card, known = json.loads(facts["card"]), json.loads(facts["architecture"])
        inputs = Inputs(*(bool(shown) for shown in known.pop("inputs")))
        architecture = CostMapArchitecture(**{**known, "widths": tuple(known["widths"]), "inputs": inputs})
        shapes, classes = weight_shapes(architecture), tuple(card["classes"])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: its metadata describe no network; {remedy}") from None
    if classes != OBJECT_CLASSES:
        raise InputError(f"{path}: the network was trained on another list of classes; train it anew")
    return CostMapEstimator(weights=read_weights(path, shapes, tensors), architecture=architecture), card
