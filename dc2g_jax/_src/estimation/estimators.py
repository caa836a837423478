"""Estimators map a partial map to the cost-to-go of every cell; lower is better."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, UInt8

from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.estimation.compact_unet import COMPACT_UNET, Architecture
from dc2g_jax._src.grid import bitboard, search
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.sampling import resize_nearest
from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, NOTHING, OCCUPIED, OUTSIDE, UNKNOWN
from dc2g_jax._src.grid.world import World

#: Estimates as stored by a planner.
Estimates = Float[Array, "kept h w *batch"]


class Extent:
    """The part of the map that an estimator is given: all of it, as in the paper, or a part defined by a subclass.

    Planners that know the robot's pose use the `extent` of an estimator. Hashable, so that it can be a static argument
    of `jit`.
    """

    #: Cost of cells that have never been estimated.
    prior: float = 0.0

    def part(self, terrain: UInt8[Array, "h w *batch"], pose: Pose) -> UInt8[Array, "h2 w2 *batch"]:
        """The part of the observed class indices (0 = not observed) for a robot in this pose."""
        del pose
        return terrain

    def merged(self, answer: Float[Array, "kept h2 w2 *batch"], pose: Pose, before: Estimates) -> Estimates:
        """The new estimates of every cell: the answer in the part, and the old estimates elsewhere."""
        del pose, before
        return answer


WHOLE_MAP = Extent()


class Estimator(Protocol):
    """Estimates the cost-to-go of every cell from a partial map (Algorithm 2, lines 9 and 10).

    Unobserved ground is uncertain, so an estimate is a set of equally likely outcomes, such as evenly spaced
    quantiles. A deterministic estimator gives one outcome.

    An estimator that does not derive from this class has the defaults of the attributes, too.

    Attributes:
      in_cells: whether costs are in cells, so that a distance can be added.
      knows_outside: whether it takes maps anywhere in a larger grid of `OUTSIDE` cells, as `OnlinePlanner` pads them.
      extent: the part of the map that it is given.
      side: longer side of the maps that it was trained on, in cells; `None` if it knows maps of any size.
      is_compact: whether it is a network whose layers are those of `CompactUNet`.
      needs_classes: whether it predicts nothing from free and occupied cells alone; `LearnedScore` then does without.
      score: weights of the terms of `planning.learned_score.LearnedScore` that were learned with it: the width of the
        robots' field of view in degrees -> name -> weight; `None` for those of the shipped network.
    """

    in_cells: ClassVar[bool] = True
    knows_outside: ClassVar[bool] = False
    extent: Extent = WHOLE_MAP
    side: int | None = None
    is_compact: bool = False
    needs_classes: ClassVar[bool] = False
    score: Mapping[str, Mapping[str, Float[Array, ""]]] | None = None

    def init(self, world: World) -> Any:
        """The state for an episode in `world`. Only a privileged estimator may read the world.

        Empty unless a subclass defines it.
        """
        del world
        return ()

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Float[Array, "outcomes h w *batch"]:
        """The cost-to-go of every cell given the observed class indices (0 = not observed). Finite, lower is better.

        Quantiles are in ascending order of their levels; those of a network may cross slightly.
        """
        ...


def trait(estimator: Estimator | None, name: str) -> Any:
    """An attribute of an estimator, or its default in `Estimator`."""
    return getattr(estimator, name, getattr(Estimator, name))


def answers_in_cells(estimator: Estimator | None) -> bool:
    """Whether an estimator's costs are `in_cells`."""
    return trait(estimator, "in_cells")


#: Smallest and largest batch of an estimator. In tiny batches the last bits of a convolution may depend on the size.
_FEWEST_MAPS, _MOST_MAPS = compact_unet.LEAST_MAPS, 4096

#: With more robots than this, an estimator has only two batch sizes: more would save little, and each is compiled.
_MANY_ROBOTS = 256


def _call_sizes(n_robots: int) -> list[int]:
    """Batch sizes for an estimator, descending powers of two: at most half the number of robots, within the limits."""
    largest = min(_MOST_MAPS, max(_FEWEST_MAPS, 1 << n_robots.bit_length() >> 2))
    halvings = (0, 3) if n_robots > _MANY_ROBOTS else range(4)
    return [largest >> times for times in halvings if largest >> times >= _FEWEST_MAPS]


def update_where(function: Callable[[Any, Any], Any], wanted: Bool[Array, "*batch"], inputs: Any, before: Any) -> Any:
    """Apply a function to some of the robots, a few at a time, and keep the old values of the others.

    Args:
      function: `(inputs, old values) -> new values`, for a batch of robots.
      wanted: whether each robot needs new values.
      inputs: pytree of arrays whose last axes are those of `wanted`.
      before: old values, likewise.
    """
    if wanted.size == 1:
        return jax.lax.cond(
            wanted.reshape(()),
            lambda: jax.tree.map(lambda new, old: new.astype(old.dtype), function(inputs, before), before),
            lambda: before,
        )
    batch_axes = wanted.ndim

    def flat(leaf: Array) -> Array:
        return leaf.reshape(*leaf.shape[: leaf.ndim - batch_axes], -1)

    flat_wanted, inputs, old = jax.tree.map(flat, (wanted, inputs, before))
    n_robots = flat_wanted.shape[0]
    sizes = _call_sizes(n_robots)
    # Indices of the wanted robots come first; the rest are out of bounds, where nothing is written.
    queue = jnp.nonzero(flat_wanted, size=n_robots + sizes[-1], fill_value=n_robots)[0]
    n_wanted = jnp.sum(flat_wanted, dtype=jnp.int32)

    def run_batch(batch_size: int, carry: tuple[Array, Any]) -> tuple[Array, Any]:
        done, values = carry
        robots = jax.lax.dynamic_slice_in_dim(queue, done, batch_size)
        own = jax.tree.map(lambda leaf: leaf.at[..., robots].get(mode="clip"), (inputs, values))
        new = function(*own)
        values = jax.tree.map(
            lambda leaf, own: leaf.at[..., robots].set(own.astype(leaf.dtype), mode="drop"), values, new
        )
        return done + batch_size, values

    def run_batches(batch_size: int, carry: tuple[Array, Any]) -> tuple[Array, Any]:
        """Run full batches while there are enough robots; the smallest size also takes the rest."""
        least = 1 if batch_size == sizes[-1] else batch_size
        return jax.lax.while_loop(
            lambda carry: carry[0] + least <= n_wanted, functools.partial(run_batch, batch_size), carry
        )

    carry = (jnp.int32(0), old)
    for batch_size in sizes:
        carry = run_batches(batch_size, carry)
    return jax.tree.map(lambda leaf, own: own.reshape(leaf.shape), before, carry[1])


#: Classes of maps without semantics: occupancy maps, their doors, and cells set aside.
PLAIN_CLASSES = (UNKNOWN, FREE, OCCUPIED, FRONT_DOOR, NOTHING, OUTSIDE)


def zero_without_classes(
    terrain: UInt8[Array, "h w *batch"], costs: Float[Array, "outcomes h w *batch"]
) -> Float[Array, "outcomes h w *batch"]:
    """A network's costs; 0 everywhere for a map without semantics, from which nothing can be predicted."""
    plain = functools.reduce(jnp.logical_or, [terrain == kind for kind in PLAIN_CLASSES])
    return jnp.where(jnp.all(plain, axis=(0, 1)), 0.0, costs)


@struct.dataclass
class NetworkCostToGo(Estimator):
    """The estimate of a trained network, the compact one or one of the user's own.

    Attributes:
      weights: the network's weights.
      architecture: the network's architecture.
      summary: applied to the outcomes of a network of the user's own, see `summarized`; `None` for the outcomes.
      score: see `Estimator`.
    """

    weights: Any
    architecture: Architecture = struct.field(pytree_node=False)
    summary: Callable[[Array], Array] | None = struct.field(pytree_node=False, default=None)
    needs_classes: ClassVar[bool] = True
    score: Mapping[str, Mapping[str, Float[Array, ""]]] | None = None

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: tuple[()]) -> Float[Array, "outcomes h w *batch"]:
        """The network's estimate for partial maps, in cells, with one outcome per quantile.

        Maps that are larger than those of the training are resampled to their size, so that a house looks to the
        network as it did in training, however small the cells are.

        While nothing but free and occupied cells and doors has been observed, as in an occupancy map, there is nothing
        to predict from, and the estimate is 0 everywhere. A planner then goes by distance and by what it would see.
        """
        del state
        height, width, *batch = terrain.shape
        longest = max(height, width, self.architecture.side)
        rows, columns = (-(-size * self.architecture.side // longest) for size in (height, width))
        shrunk = resize_nearest(terrain, rows, columns).reshape(rows, columns, -1)
        answers = compact_unet.apply(self.architecture, self.weights, jnp.moveaxis(shrunk, -1, 0))
        cells = jnp.moveaxis(answers, (-1, 0), (2, -1)).reshape(rows, columns, -1, *batch)
        costs = longest / self.architecture.side * jnp.moveaxis(resize_nearest(cells, height, width), 2, 0)
        costs = zero_without_classes(terrain, costs)
        return costs if self.summary is None else self.summary(costs)

    @property
    def side(self) -> int:  # type: ignore[override]
        """See `Estimator`."""
        return self.architecture.side

    @property
    def is_compact(self) -> bool:  # type: ignore[override]
        """See `Estimator`."""
        return self.architecture.network == COMPACT_UNET

    def summarized(self, summary: Callable[[Array], Array]) -> "NetworkCostToGo":
        """An estimator that computes only a weighted sum of this one's outcomes, such as their mean.

        The last layer of the compact network computes the sum, which is faster, since outcomes are linear in the
        weights of that layer. It is for planners. Its architecture still lists the quantiles of this network.

        Args:
          summary: the sum, see `planning.selection.linear`.
        """
        if not self.is_compact:
            return dataclasses.replace(self, summary=summary)
        area, quantiles = self.architecture.patch**2, len(self.architecture.quantiles)

        def summed(leaf: Array) -> Array:
            sums = summary(jnp.moveaxis(leaf.reshape(-1, area, quantiles), -1, 0))
            return jnp.moveaxis(sums, 0, -1).reshape(*leaf.shape[:-1], -1)

        head = jax.tree.map(jnp.asarray, self.weights["head"])
        # The network adds 1 to the layer's outputs.
        head = {"kernel": summed(head["kernel"]), "bias": summed(head["bias"] + 1) - 1}
        return NetworkCostToGo(self.weights | {"head": head}, self.architecture)


def _trait_of_first(name: str) -> Any:
    """A trait of an ensemble: that of its first member."""
    return property(lambda ensemble: trait(ensemble.members[0], name), doc="See `Estimator`.")


@struct.dataclass
class Ensemble(Estimator):
    """The mean of networks that differ in their weights alone, outcome by outcome.

    How much the networks differ does not widen the quantiles.

    Attributes:
      members: the networks, of one class and architecture. The first one's score and other traits are used.
    """

    members: tuple[Any, ...]

    in_cells = _trait_of_first("in_cells")
    knows_outside = _trait_of_first("knows_outside")
    extent = _trait_of_first("extent")
    side = _trait_of_first("side")
    needs_classes = _trait_of_first("needs_classes")
    score = _trait_of_first("score")

    def init(self, world: World) -> tuple[Any, ...]:
        """The states of the members."""
        return tuple(member.init(world) for member in self.members)

    def estimate(
        self, terrain: UInt8[Array, "h w *batch"], state: tuple[Any, ...]
    ) -> Float[Array, "outcomes h w *batch"]:
        """The mean of the members' costs."""
        costs = [member.estimate(terrain, own) for member, own in zip(self.members, state, strict=True)]
        return functools.reduce(jnp.add, costs) / len(costs)


@struct.dataclass
class ExactCostToGo(Estimator):
    """The exact cost-to-go of the hidden map: a perfect, privileged estimator.

    Attributes:
      log_error: natural logarithm of a factor that multiplies each cell's value; 0 for exact values. A random field
        simulates an imperfect network.
      moves: moves between cells; by default those of the robot, see `grid.search.cost_to_go`.
    """

    log_error: Float[Array, "h w"] | float = 0.0
    moves: tuple[tuple[int, int], ...] = struct.field(pytree_node=False, default=search.FOUR_CONNECTED)

    def init(self, world: World) -> Float[Array, "h w *batch"]:
        """The cost-to-go of the whole map."""
        return world_cost_to_go(world, moves=self.moves)

    def estimate(
        self, terrain: UInt8[Array, "h w *batch"], state: Float[Array, "h w *batch"]
    ) -> Float[Array, "1 h w *batch"]:
        """The values of the whole map, independent of the observed cells."""
        factor = jnp.exp(jnp.asarray(self.log_error, jnp.float32))
        return (state * factor.reshape(*factor.shape, *(1 for _ in terrain.shape[factor.ndim :])))[None]


def world_cost_to_go(
    world: World, *, moves: tuple[tuple[int, int], ...] = search.FOUR_CONNECTED
) -> Float[Array, "h w *batch"]:
    """Exact cost-to-go of a world, in cells; infinity for cells that are not traversable or cannot reach a goal."""
    return search.cost_to_go(
        bitboard.unpack(world.traversable, world.width), bitboard.unpack(world.goals, world.width), moves=moves
    )
