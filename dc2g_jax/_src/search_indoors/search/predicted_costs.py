"""Predicted costs of a robot: inputs of the network, and its output in meters."""

import hashlib
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.search_indoors.learning.midlevel import ImageEncoder, load_encoder, vector_size
from dc2g_jax._src.search_indoors.learning.networks import CostMapEstimator, fused_cost, load_estimator, save_estimator
from dc2g_jax._src.search_indoors.maps.mapping import IndoorMapSettings, network_input
from dc2g_jax._src.search_indoors.search.agent import Agent, Observation

#: The files of a trained network and of the encoder that it was trained with, in one folder.
NETWORK_FILE, ENCODER_FILE = "network.safetensors", "encoder.safetensors"


class _CostEstimator(Protocol):
    """Predicts costs from a partial map. Implementations are pytrees."""

    def estimate(
        self,
        maps: Float[Array, "36 n n"],
        target: Int[Array, ""],
        features: Float[Array, " feature"],
        heading: Float[Array, ""],
    ) -> tuple[Float[Array, "n n"], Float[Array, "n n"]]:
        """Predict for one robot.

        Args:
          maps: maps of the robot, see `maps.mapping.network_maps`.
          target: the wanted class, an index into `GOALS`.
          features: mid-level features of the camera image.
          heading: direction of the camera, counter-clockwise from +x, radians.

        Returns:
          For each cell of the local map, the probability that it is not free floor, and the navigation cost.
        """
        ...


_Estimator = TypeVar("_Estimator", bound=_CostEstimator)


@struct.dataclass
class PredictedCosts(Generic[_Estimator]):
    """Navigation costs predicted from the map and the camera image of a robot.

    Attributes:
      estimator: predicts costs.
      encoder: computes mid-level features of the camera image.
      meters: distance that corresponds to a cost of 1. A network trained on shares of the longest path
        (`--recipe paper`) has no such scale and is used as if it had.
      threshold: cells with a higher probability of being occupied are blocked (the paper's theta_occ).
    """

    estimator: _Estimator
    encoder: ImageEncoder
    meters: float = 10.0
    threshold: float = 0.5

    def of(self, seen: Observation, agent: Agent) -> Float[Array, "n n"]:
        """Cost of each cell of the local map relative to the best cell, meters.

        Infinite where a cell is predicted to be occupied.

        Raises:
          InputError: the camera's picture is missing.
        """
        if seen.image is None:
            raise InputError("predicted costs need the camera's picture, but there is none; give one with each frame")
        maps = network_input(seen.map, seen.vehicle.position, agent.mapping)
        features = self.encoder.encode(seen.image[None])[0]
        occupied, cost = self.estimator.estimate(maps, seen.target, features, seen.vehicle.yaw)
        fused = fused_cost(occupied, cost, self.threshold)
        return jnp.where(jnp.isinf(fused), fused, self.meters * (fused - jnp.min(fused)))


def save_costs(folder: Path, estimator: CostMapEstimator, card: dict[str, Any]) -> None:
    """Save a network beside its encoder, and its card as `network.json` with the SHA-256 of both files.

    Args:
      folder: folder that the encoder was saved to.
      estimator: the network.
      card: further facts about it, as JSON values.
    """
    save_estimator(folder / NETWORK_FILE, estimator, card)
    digests = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in (NETWORK_FILE, ENCODER_FILE)}
    write_json(folder / "network.json", {**card, "sha256": digests})


def load_costs(folder: Path) -> PredictedCosts[CostMapEstimator]:
    """Read a trained network and its encoder.

    Args:
      folder: output folder of `dc2g objectnav train`.

    Raises:
      InputError: a file is missing or invalid, or the two do not match.
    """
    for name in (NETWORK_FILE, ENCODER_FILE):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: has no {name}; give a folder that `dc2g objectnav train` has written")
    (estimator, card), encoder = load_estimator(folder / NETWORK_FILE), load_encoder(folder / ENCODER_FILE)
    if card.get("cell_size", IndoorMapSettings.cell_size) != IndoorMapSettings.cell_size:
        raise InputError(
            f"{folder}: the network was trained on cells of {card['cell_size']:g} m, maps here have "
            f"{IndoorMapSettings.cell_size:g} m; train one anew"
        )
    if (size := vector_size(encoder)) != estimator.architecture.features:
        raise InputError(
            f"{folder}: {ENCODER_FILE} makes {size} features, {NETWORK_FILE} takes "
            f"{estimator.architecture.features}; take both from one folder"
        )
    return PredictedCosts(estimator, encoder)
