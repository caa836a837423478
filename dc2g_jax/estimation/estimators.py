"""The interface planners see: a partial map in, a cost-to-go grid out, lower is better."""

from typing import Any, Protocol

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, UInt8

from dc2g_jax.estimation import networks
from dc2g_jax.estimation.networks import Architecture
from dc2g_jax.grid import bitboard, search
from dc2g_jax.grid.world import World


class Estimator(Protocol):
    """Estimates the cost-to-go everywhere from a partial map (Algorithm 2, lines 9 and 10)."""

    def init(self, world: World) -> Any:
        """State for an episode in `world`. Only a privileged estimator may read the world."""
        ...

    def estimate(self, terrain: UInt8[Array, "h w"], state: Any) -> Float[Array, "h w"]:
        """Cost-to-go of every cell given the observed class indices (0 = not observed). Finite, lower is better."""
        ...


@struct.dataclass
class NetworkCostToGo:
    """A trained network's estimate.

    Attributes:
      weights: the network's weights.
      architecture: the network.
    """

    weights: Any
    architecture: Architecture = struct.field(pytree_node=False)

    def init(self, world: World) -> tuple[()]:
        """Nothing is kept between steps."""
        del world
        return ()

    def estimate(self, terrain: UInt8[Array, "h w"], state: tuple[()]) -> Float[Array, "h w"]:
        """The network's answer to a partial map, in cells."""
        del state
        return networks.apply(self.architecture, self.weights, terrain[None])[0]


@struct.dataclass
class ExactCostToGo:
    """The exact cost-to-go of the hidden map in the network's place: the ceiling of what any estimator can reach.

    Attributes:
      log_error: natural logarithm of a factor by which each cell's value is wrong; 0 for the exact values. A field of
        it stands in for an imperfect network.
      moves: steps between cells; those the robot can make by default, see `dc2g_jax.grid.search.cost_to_go`.
    """

    log_error: Float[Array, "h w"] | float = 0.0
    moves: tuple[tuple[int, int], ...] = struct.field(pytree_node=False, default=search.FOUR_CONNECTED)

    def init(self, world: World) -> Float[Array, "h w"]:
        """Solve the whole map."""
        return world_cost_to_go(world, moves=self.moves)

    def estimate(self, terrain: UInt8[Array, "h w"], state: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """The values of the whole map, whatever has been observed."""
        del terrain
        return state * jnp.exp(self.log_error)


def world_cost_to_go(
    world: World, *, moves: tuple[tuple[int, int], ...] = search.FOUR_CONNECTED
) -> Float[Array, "h w"]:
    """Exact cost-to-go of a world, in cells; infinity where a robot cannot drive or cannot reach a goal."""
    width = world.terrain.shape[-1]
    return search.cost_to_go(
        bitboard.unpack(world.traversable, width), bitboard.unpack(world.goals, width), moves=moves
    )
