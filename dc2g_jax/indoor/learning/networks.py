"""The network that predicts a dense cost map from a partial indoor map (section II-B, Fig. 2).

It is a U-Net with one encoder and two decoders of the same shape, for occupancy and for navigation cost. At the
bottleneck, the encoder's features are joined by the embedding of the target, the same everywhere, and by the mid-level
features of the camera image, in the region of the map that the camera looks at (Fig. 3).

The 36 input channels are those of two maps, see `maps.mapping.network_maps`: the local map, and the
global map around the same center, averaged over 3x3 cells. Each has 16 semantic classes, then obstacle, then explored.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx, struct
from jaxtyping import Array, Bool, Float, Int, Integer, UInt8

from dc2g_jax.estimation import Down, Kind, Residual, Up, local_folder, patches, read_network, unpatched, with_weights
from dc2g_jax.files import resource
from dc2g_jax.indoor.learning.midlevel import TrainedEncoder, load_encoder
from dc2g_jax.indoor.maps.classes import GOALS, OBJECT_CLASSES, SEMANTIC_CLASSES
from dc2g_jax.indoor.maps.mapping import MAP_CHANNELS, IndoorMapSettings
from dc2g_jax.runtime import InputError, check_name, check_number

#: Within the folder of a network, that of the encoder that it was trained with.
ENCODER_FOLDER = "encoder"

#: The shipped network.
_SHIPPED = "weights/cost_maps_indoors"

#: Distance that corresponds to a cost of 1, meters, of networks trained on costs with a fixed scale.
COST_UNIT = 10.0

#: Channels of the network's input: of the local map, then of the global one.
INPUT_CHANNELS = 2 * MAP_CHANNELS

#: Number of heading bins of 45 degrees (Fig. 3).
BINS = 8

#: Heading bin -> row and column of its region among three by three, with north in row 0. Bins count counter-clockwise
#: from east, so north is bin 2.
_REGIONS = ((1, 2), (0, 2), (0, 1), (0, 0), (1, 0), (2, 0), (2, 1), (2, 2))


#: Inputs of a network besides obstacles and explored cells, which it always gets: the channels of semantic classes, the
#: mid-level features, or both (section IV-C, Table II).
Inputs = Literal["both", "semantic", "midlevel"]


@dataclasses.dataclass(frozen=True)
class CostMapArchitecture:
    """Hyperparameters of a `CostMapNetwork`. The defaults suit a CPU with two cores.

    Attributes:
      patch: side of the patches of cells that the first layer reads, a divisor of the map's sides.
      widths: channels at the resolution of patches, at half of it, and so on down to the bottleneck; at least two.
      embedding: length of the embedding of a target.
      features: length of the vector of mid-level features.
      feature_width: channels of the mid-level features at the bottleneck.
      inputs: one of `Inputs`.

    Raises:
      InputError: a number is out of range.
    """

    patch: int = 4
    widths: tuple[int, ...] = (24, 48, 96, 120)
    embedding: int = 64
    features: int = 64
    feature_width: int = 64
    inputs: Inputs = "both"

    def __post_init__(self) -> None:
        if len(self.widths) < 2 or min(self.widths) < 1:
            raise InputError(f"widths {' '.join(map(str, self.widths))}: give at least two, none below 1")
        for name in ("patch", "embedding", "features", "feature_width"):
            check_number(name.replace("_", " "), getattr(self, name), whole=True, least=1)
        check_name("input", self.inputs, get_args(Inputs))


@struct.dataclass
class Prediction:
    """Output of the network.

    Attributes:
      occupancy_logits: log-odds that a cell is not free floor.
      cost: navigation cost, in the unit of the training labels.
    """

    occupancy_logits: Float[Array, "*b h w"]
    cost: Float[Array, "*b h w"]

    @property
    def occupancy(self) -> Float[Array, "*b h w"]:
        """Probability that a cell is not free floor."""
        return jax.nn.sigmoid(self.occupancy_logits)

    @property
    def fused_cost(self) -> Float[Array, "*b h w"]:
        """The final cost map: infinite in cells that are more likely occupied than free (theta_occ is 0.5)."""
        return jnp.where(self.occupancy > 0.5, jnp.inf, self.cost)


def heading_bin(heading: Float[Array, "*b"]) -> Int[Array, "*b"]:
    """The bin of a heading in radians, counter-clockwise from east: 0 is within 22.5 degrees of east, 2 of north."""
    return jnp.round(heading * (BINS / (2 * math.pi))).astype(jnp.int32) % BINS


def bin_regions(height: int, width: int) -> Bool[np.ndarray, "bin h w"]:
    """The region of each heading bin on a map with north up: one of the outer eight of three by three (Fig. 3)."""
    row, column = ((3 * np.arange(size) // size) for size in (height, width))
    return np.stack([(row == above)[:, None] & (column == beside) for above, beside in _REGIONS])


def oriented_features(
    features: Float[Array, "b f"], heading: Float[Array, "b"], height: int, width: int
) -> Float[Array, "b h w f"]:
    """Mid-level features in the region that the camera looks at, 0 elsewhere (Fig. 3)."""
    regions = jnp.asarray(bin_regions(height, width), features.dtype)
    return regions[heading_bin(heading)][..., None] * features[:, None, None, :]


class _Decoder(nnx.Module):
    """From the bottleneck to one number per cell: an interpolated number per patch, and an offset per cell."""

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
        fine = unpatched(self.fine(nnx.relu(features)), self.patch)[..., 0]
        return fine + jax.image.resize(self.coarse(nnx.relu(features))[..., 0], fine.shape, "bilinear")


class CostMapNetwork(nnx.Module):
    """The U-Net of Fig. 2. The channels of each cell of the local map also enter the occupancy directly."""

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
        """Predict for a batch.

        Args:
          maps: maps with north up and the robot in the middle, see `maps.mapping.network_maps`. Sides are multiples of
            the architecture's patch.
          target: the wanted class, an index into `maps.classes.GOALS`.
          heading: direction of the camera, counter-clockwise from east, radians.
          features: mid-level features of the camera image; ignored by a network without this input.
        """
        inputs = self.architecture.inputs
        if inputs == "midlevel":
            semantic = np.arange(INPUT_CHANNELS) % MAP_CHANNELS < SEMANTIC_CLASSES
            maps = maps * jnp.asarray(~semantic, maps.dtype)[:, None, None]
        at = self.first(self.embed(patches(jnp.moveaxis(maps, 1, -1), self.architecture.patch)))
        skipped = [at]
        for level in range(len(self.architecture.widths) - 1):
            at = getattr(self, f"down{level}")(at)
            skipped.append(at)
        batch, height, width, _ = at.shape
        goal = jnp.broadcast_to(self.target(target)[:, None, None], (batch, height, width, self.architecture.embedding))
        view = oriented_features(nnx.relu(self.view(features.astype(jnp.float32))), heading, height, width)
        view = jnp.zeros_like(view) if inputs == "semantic" else view
        bottleneck = jnp.concatenate([nnx.relu(at), goal, view], axis=-1)
        local = jnp.einsum("bchw,c->bhw", maps[:, :MAP_CHANNELS], self.cell[...])
        return Prediction(
            occupancy_logits=self.occupancy(bottleneck, skipped) + local, cost=self.cost(bottleneck, skipped)
        )


def apply(architecture: CostMapArchitecture, weights: dict[str, Any], *inputs: Array) -> Prediction:
    """Run the network on a batch; see `CostMapNetwork`. Weights are converted to float32."""
    weights = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), weights)
    return with_weights(CostMapNetwork, architecture, weights)(*inputs)


@struct.dataclass
class CostMapEstimator:
    """A trained network and the encoder of camera images that it was trained with.

    Attributes:
      weights: weights of `CostMapNetwork`, floats of any precision.
      encoder: computes mid-level features.
      architecture: architecture of the network.
    """

    weights: Any
    encoder: TrainedEncoder
    architecture: CostMapArchitecture = struct.field(pytree_node=False)

    def estimate(
        self,
        maps: Float[Array, "36 h w"],
        target: Integer[Array, ""],
        heading: Float[Array, ""],
        image: UInt8[Array, "48 64 3"],
    ) -> Float[Array, "h w"]:
        """Cost of each cell of the local map relative to the best cell, meters, with arguments as in `CostMapNetwork`.

        Infinite where a cell is predicted to be occupied. A network trained on shares of the longest path
        (the paper's recipe) has no scale and is used as if it had that of the others.
        """
        one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (maps, target, heading))
        prediction = apply(self.architecture, self.weights, *one, self.encoder.encode(image[None]))
        cost = prediction.fused_cost[0]
        return jnp.where(jnp.isinf(cost), cost, COST_UNIT * (cost - jnp.min(cost)))


#: Networks as they are saved.
COST_MAPS = Kind(
    "cost_maps",
    CostMapArchitecture,
    CostMapNetwork,
    "python -m experiments.objectnav_train",
    classes=OBJECT_CLASSES,
    dtype=np.float16,
)


def load_costs(place: str | Path | None = None) -> CostMapEstimator:
    """Read a trained network and its encoder.

    Args:
      place: output folder of `python -m experiments.objectnav_train`, or a place on the Hub, see
        `estimation.local_folder`; `None` for the shipped network.

    Raises:
      InputError: a file is missing or invalid, or the two do not match.
    """
    folder = resource(_SHIPPED) if place is None else local_folder(place)
    _, weights, architecture, card = read_network(folder, COST_MAPS)
    encoder = load_encoder(folder / ENCODER_FOLDER)
    if card.get("cell_size", IndoorMapSettings.cell_size) != IndoorMapSettings.cell_size:
        sizes = f"{card['cell_size']:g} m, maps here have {IndoorMapSettings.cell_size:g} m"
        raise InputError(f"{folder}: the network was trained on cells of {sizes}; train one anew")
    if (size := encoder.architecture.features) != architecture.features:
        both = f"the encoder makes {size} features, the network takes {architecture.features}"
        raise InputError(f"{folder}: {both}; take both from one folder")
    return CostMapEstimator(weights=weights, encoder=encoder, architecture=architecture)
