"""The interface planners see: a partial map in, costs-to-go of every cell out, lower is better."""

import functools
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, UInt8

from dc2g_jax.estimation import compact_unet, images, pix2pix
from dc2g_jax.estimation.compact_unet import Architecture
from dc2g_jax.estimation.pix2pix import TranslatorArchitecture
from dc2g_jax.grid import bitboard, search
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import Pose
from dc2g_jax.grid.sampling import resize_nearest
from dc2g_jax.grid.terrain import OUTSIDE
from dc2g_jax.grid.world import World

#: Estimates as a planner keeps them.
Estimates = Float[Array, "kept h w *batch"]


class Estimator(Protocol):
    """Estimates the cost-to-go everywhere from a partial map (Algorithm 2, lines 9 and 10).

    What lies beyond the sensing horizon is uncertain, so an estimate is a number of equally likely outcomes: evenly
    spaced quantiles, or the members of an ensemble. An estimator that is sure of itself gives one.
    """

    def init(self, world: World) -> Any:
        """State for an episode in `world`. Only a privileged estimator may read the world."""
        ...

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Float[Array, "outcomes h w *batch"]:
        """Costs-to-go of every cell given the observed class indices (0 = not observed). Finite, lower is better.

        Quantiles come in ascending order of their levels; a network's may cross by a little.
        """
        ...


class Extent:
    """Which part of the map an estimator is asked about: all of it (the paper's planner), or what a subclass says.

    An estimator may have one as its attribute `extent`; a planner that knows where its robot is then asks through it.
    Hashable, so a static value under `jit`.
    """

    @property
    def prior(self) -> float:
        """What a cell costs of which no estimate has ever been made."""
        return 0.0

    def part(self, terrain: UInt8[Array, "h w *batch"], pose: Pose) -> UInt8[Array, "h2 w2 *batch"]:
        """The part of the observed class indices (0 = not observed) to ask about, where the robot is in this pose."""
        del pose
        return terrain

    def merged(self, answer: Float[Array, "kept h2 w2 *batch"], pose: Pose, before: Estimates) -> Estimates:
        """The new estimates of every cell: the answer to the part, and the old estimates elsewhere."""
        del pose, before
        return answer


WHOLE_MAP = Extent()


def extent_of(estimator: Estimator) -> Extent:
    """The part of the map that an estimator is to be asked about."""
    return getattr(estimator, "extent", WHOLE_MAP)


def answers_in_cells(estimator: Estimator | None) -> bool:
    """Are its costs in cells, so that a distance can be added? They are, unless it says otherwise."""
    return getattr(estimator, "in_cells", True)


def _call_sizes(n_robots: int, fewest: int) -> list[int]:
    """Numbers of maps that an estimator is given at a time: the four largest powers of two up to half the robots."""
    largest = max(fewest, 1 << n_robots.bit_length() >> 2)
    return [largest >> halvings for halvings in range(4) if largest >> halvings >= fewest]


def update_estimates(
    estimate: Callable[[UInt8[Array, "h w some"], Pose, Estimates, Any], Estimates],
    wanted: Bool[Array, "*batch"],
    belief: Belief,
    state: Any,
    estimates: Float[Array, "kept h w *batch"],
    *,
    fewest: int = 4,
) -> Float[Array, "kept h w *batch"]:
    """Make new estimates for the wanted robots alone, a few at a time, and keep the other robots' old estimates.

    Args:
      estimate: `(observed class indices, poses, old estimates, states) ->` new estimates.
      wanted: which robots need a new estimate.
      belief: what the robots know.
      state: the estimator's state.
      estimates: the old estimates.
      fewest: the least number of maps at a time; the last bits of a convolution may depend on it where it is tiny.
    """
    batch_axes = wanted.ndim

    def flat(leaf: Array) -> Array:
        return leaf.reshape(*leaf.shape[: leaf.ndim - batch_axes], -1)

    terrain = belief.terrain
    if belief.outside is not None:
        terrain = jnp.where(bitboard.unpack(belief.outside, belief.width), jnp.uint8(OUTSIDE), terrain)
    wanted, terrain, pose, old, state = jax.tree.map(flat, (wanted, terrain, belief.pose, estimates, state))
    n_robots = wanted.shape[0]
    sizes = _call_sizes(n_robots, fewest)
    # Indices of the wanted robots first; the rest lie beyond the batch, where nothing is written.
    queue = jnp.nonzero(wanted, size=n_robots + sizes[-1], fill_value=n_robots)[0]
    n_wanted = jnp.sum(wanted, dtype=jnp.int32)
    # Unpacked before the loop: inside it XLA would unpack every cell again for each of a network's one-hot inputs.
    terrain = jnp.moveaxis(terrain, -1, 0)

    def ask(at_a_time: int, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        asked, answers = carry
        robots = jax.lax.dynamic_slice_in_dim(queue, asked, at_a_time)
        # Where the queue has run out the map is unknown throughout.
        own_terrain = jnp.moveaxis(terrain.at[robots].get(mode="fill", fill_value=0), 0, -1)
        own_pose, own_state = jax.tree.map(lambda leaf: leaf.at[..., robots].get(mode="clip"), (pose, state))
        before = jnp.moveaxis(answers.at[robots].get(mode="clip"), 0, -1)
        answer = estimate(own_terrain, own_pose, before, own_state)
        answer = jnp.moveaxis(answer, -1, 0).astype(answers.dtype)
        return asked + at_a_time, answers.at[robots].set(answer, mode="drop")

    def asked_for_all(at_a_time: int, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        """Full calls as long as there are; the smallest size also takes what is left."""
        least = 1 if at_a_time == sizes[-1] else at_a_time
        return jax.lax.while_loop(lambda carry: carry[0] + least <= n_wanted, functools.partial(ask, at_a_time), carry)

    # Robots first for the while, so that each answer is written in one piece.
    carry = (jnp.int32(0), jnp.moveaxis(old, -1, 0))
    for at_a_time in sizes:
        carry = asked_for_all(at_a_time, carry)
    answers = jnp.moveaxis(carry[1], 0, -1)
    return answers.reshape(estimates.shape)


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

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: tuple[()]) -> Float[Array, "outcomes h w *batch"]:
        """The network's answer to partial maps, in cells: an outcome for each of its quantiles."""
        del state
        height, width, *batch = terrain.shape
        maps = jnp.moveaxis(terrain.reshape(height, width, -1), -1, 0)
        answers = compact_unet.apply(self.architecture, self.weights, maps)
        return jnp.moveaxis(answers, (-1, 0), (0, -1)).reshape(-1, height, width, *batch)


@struct.dataclass
class TranslatorCostToGo:
    """The paper's image-to-image translator: the map goes in as a picture, the cost-to-go is read off its answer.

    Attributes:
      weights: the generator's weights.
      architecture: the networks.
    """

    weights: Any
    architecture: TranslatorArchitecture = struct.field(pytree_node=False)
    #: Brightness is relative to the brightest cell.
    in_cells: ClassVar[bool] = False

    def init(self, world: World) -> tuple[()]:
        """Nothing is kept between steps."""
        del world
        return ()

    def translate(self, terrain: UInt8[Array, "b h w"]) -> Float[Array, "b s s 3"]:
        """Pictures of the cost-to-go of partial maps, which are resized to the network's own size first."""
        size = self.architecture.size
        return self.answer(jax.vmap(lambda one: images.semantic_image(resize_nearest(one, size, size)))(terrain))

    def answer(self, pictures: Float[Array, "b s s 3"]) -> Float[Array, "b s s 3"]:
        """Pictures of the cost-to-go, in 8 bits, of pictures of partial maps in the network's own size."""
        return jax.vmap(images.in_eight_bits)(pix2pix.translate(self.architecture, self.weights, pictures))

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: tuple[()]) -> Float[Array, "1 h w *batch"]:
        """1 - brightness in the network's picture; 1 where it shows ground that cannot be driven on."""
        del state
        height, width, *batch = terrain.shape
        answers = self.translate(jnp.moveaxis(terrain.reshape(height, width, -1), -1, 0))
        costs = jax.vmap(lambda one: images.read_cost_to_go(one, height, width))(answers)
        return jnp.moveaxis(costs, 0, -1).reshape(1, height, width, *batch)


@struct.dataclass
class ExactCostToGo:
    """The exact cost-to-go of the hidden map in the network's place: an estimator that leaves nothing to gain.

    Attributes:
      log_error: natural logarithm of a factor by which each cell's value is wrong; 0 for the exact values. A field of
        it stands in for an imperfect network.
      moves: steps between cells; those the robot can make by default, see `dc2g_jax.grid.search.cost_to_go`.
    """

    log_error: Float[Array, "h w"] | float = 0.0
    moves: tuple[tuple[int, int], ...] = struct.field(pytree_node=False, default=search.FOUR_CONNECTED)

    def init(self, world: World) -> Float[Array, "h w *batch"]:
        """Solve the whole map."""
        return world_cost_to_go(world, moves=self.moves)

    def estimate(
        self, terrain: UInt8[Array, "h w *batch"], state: Float[Array, "h w *batch"]
    ) -> Float[Array, "1 h w *batch"]:
        """The values of the whole map, whatever has been observed."""
        factor = jnp.exp(jnp.asarray(self.log_error, jnp.float32))
        return (state * factor.reshape(*factor.shape, *(1 for _ in terrain.shape[factor.ndim :])))[None]


def world_cost_to_go(
    world: World, *, moves: tuple[tuple[int, int], ...] = search.FOUR_CONNECTED
) -> Float[Array, "h w *batch"]:
    """Exact cost-to-go of a world, in cells; infinity where a robot cannot drive or cannot reach a goal."""
    return search.cost_to_go(
        bitboard.unpack(world.traversable, world.width), bitboard.unpack(world.goals, world.width), moves=moves
    )
