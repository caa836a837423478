"""A recurrent policy, learned by PPO: which part of the map around the robot to explore next."""

from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx, struct
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.estimation import read_weights, shapes_of_weights, with_weights
from dc2g_jax.files import resource
from dc2g_jax.grid import (
    CLASS_NAMES,
    DRIVEWAY,
    FORWARD,
    HEADINGS,
    HOUSE,
    PATH,
    Belief,
    Board,
    Kernel,
    Pose,
    World,
    bitboard,
    poses,
)
from dc2g_jax.planning import (
    Assessment,
    ChoosingPlanner,
    Chosen,
    PoseValues,
    Situation,
    at_cells,
    corner_sums,
    frontiers,
    in_rectangle,
)

#: Blocks around the robot: nine at each scale, three by three, of 3, 9, 27 and 81 cells a side. Those of a scale fill
#: the middle one of the next.
_SCALES = 4
BLOCKS = 9 * _SCALES
_SIDES = np.repeat(3 ** np.arange(1, _SCALES + 1), 9)
#: Cells from the robot to the middle of each block: ahead and to the right.
_OFFSETS = _SIDES * np.tile([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)], (_SCALES, 1)).T

#: Sets of cells whose shares the policy sees, see `_planes`; radii of squares around a subgoal; further numbers of one.
_PLANES, _RADII, _NUMBERS = 9, (1, 4), 4

#: Units of the layer that rates a subgoal.
_RATING_UNITS = 48

_SHIPPED = resource("weights/recurrent_policy.safetensors")

_GARAGE_DOOR = CLASS_NAMES.index("garage door")


class PolicyInputs(NamedTuple):
    """What the policy sees.

    Attributes:
      shares: share of each block's cells that is in each set of `_planes`; nothing is beyond the map.
      subgoals: about the nearest candidate of each block: the shares in squares around it, the distance (as it is and
        as a logarithm) and the cells it would reveal.
      present: whether the block has a candidate.
    """

    shares: Float[Array, "block plane *batch"]
    subgoals: Float[Array, "block number *batch"]
    present: Bool[Array, "block *batch"]

    @classmethod
    def none(cls, batch: tuple[int, ...]) -> "PolicyInputs":
        """Before the first look, for a batch of robots."""
        numbers = _PLANES, _PLANES * len(_RADII) + _NUMBERS
        shares, subgoals = (jnp.zeros((BLOCKS, size, *batch), jnp.float32) for size in numbers)
        return cls(shares, subgoals, jnp.zeros((BLOCKS, *batch), bool))


class Memory(NamedTuple):
    """What the policy remembers.

    Attributes:
      visited: cells where the robot has been.
      hidden: state of the recurrent layer.
      logits: preference for each block at the last choice.
      notes: what a learner keeps.
    """

    visited: Board
    hidden: Float[Array, "unit *batch"]
    logits: Float[Array, "block *batch"]
    notes: Any = ()


class RecurrentNetwork(nnx.Module):
    """A gated recurrent unit on the inputs; its state and each subgoal's numbers rate the subgoal."""

    #: Units of the recurrent layer.
    UNITS: ClassVar[int] = 64

    def __init__(self, units: int, rngs: nnx.Rngs):
        numbers = _PLANES * (1 + len(_RADII)) + _NUMBERS + BLOCKS
        self.look = nnx.Linear(BLOCKS * _PLANES, units, rngs=rngs)
        self.memory = nnx.GRUCell(units, units, rngs=rngs)
        self.context = nnx.Linear(units, _RATING_UNITS, rngs=rngs)
        self.subgoal = nnx.Linear(numbers, _RATING_UNITS, use_bias=False, rngs=rngs)
        self.direct = nnx.Linear(numbers, 1, use_bias=False, kernel_init=nnx.initializers.normal(0.01), rngs=rngs)
        self.rating = nnx.Linear(_RATING_UNITS, 1, kernel_init=nnx.initializers.normal(0.01), rngs=rngs)

    def remember(self, hidden: Float[Array, "... unit"], shares: Float[Array, "... block plane"]) -> Array:
        """The next state of the recurrent layer."""
        seen = jax.nn.relu(self.look(shares.reshape(*shares.shape[:-2], -1)))
        return self.memory(hidden, seen)[0]

    def rate(self, hidden: Float[Array, "... unit"], seen: PolicyInputs) -> Float[Array, "... block"]:
        """Logit of each block, very low for those without a candidate. Axes of the batch come first."""
        block = jnp.broadcast_to(jnp.eye(BLOCKS), (*seen.present.shape, BLOCKS))
        numbers = jnp.concatenate([seen.shares, seen.subgoals, block], axis=-1)
        rated = jax.nn.relu(self.subgoal(numbers) + self.context(hidden)[..., None, :])
        return jnp.where(seen.present, (self.rating(rated) + self.direct(numbers))[..., 0], -1e9)


def read_policy(path: str | Path = _SHIPPED) -> dict[str, Any]:
    """The weights of a `RecurrentNetwork` in a file, as float32; by default the shipped ones.

    Raises:
      InputError: the file cannot be read or holds no such network.
    """
    return read_weights(path, shapes_of_weights(RecurrentNetwork, RecurrentNetwork.UNITS))


def _turned(pose: Pose) -> tuple[Array, Array, Array, Array]:
    """The cell ahead and the cell to the right of a robot, relative to it: dx and dy of each."""
    ahead, right = (jnp.asarray(FORWARD, jnp.int32)[(pose.heading + turn) % HEADINGS] for turn in (0, 1))
    return ahead[..., 0], ahead[..., 1], right[..., 0], right[..., 1]


def block_of_cells(pose: Pose, height: int, width: int) -> Int[Array, "h w *batch"]:
    """The block of every cell, for a robot in this pose: a smaller one wins."""
    batch = (1,) * pose.x.ndim
    dx = jnp.arange(width).reshape(1, -1, *batch) - pose.x
    dy = jnp.arange(height).reshape(-1, 1, *batch) - pose.y
    ahead_x, ahead_y, right_x, right_y = _turned(pose)
    ahead, right = dx * ahead_x + dy * ahead_y, dx * right_x + dy * right_y
    far = jnp.maximum(jnp.abs(ahead), jnp.abs(right))
    block = jnp.zeros_like(far)
    for scale, side in enumerate(_SIDES[::9].tolist()):
        row, column = (jnp.clip((way + side // 2) // side, -1, 1) for way in (ahead, right))
        block = jnp.where(far > side // 2, 9 * scale + 3 * row + column + 4, block)
    return jnp.where(far <= 1, 4, block)


def _planes(belief: Belief, situation: Situation) -> Bool[Array, "plane h w *batch"]:
    """Unknown; observed: obstacles, houses, driveways, paths, other ground, goals; visited; candidates."""
    houses = belief.of_class(HOUSE) | belief.of_class(_GARAGE_DOOR)
    driveways, paths = belief.of_class(DRIVEWAY), belief.of_class(PATH)
    boards = (
        frontiers.unseen(belief), belief.seen & ~belief.traversable & ~houses, houses, driveways, paths,
        belief.traversable & ~driveways & ~paths & ~belief.goals, belief.goals, situation.estimator.visited,
        poses.occupied(situation.candidates),
    )  # fmt: skip
    return jnp.stack([bitboard.unpack(board, belief.width) for board in boards])


def policy_inputs(belief: Belief, situation: Situation, sensing: Kernel) -> PolicyInputs:
    """What the policy sees.

    Args:
      belief: belief of the robot.
      situation: what the planner chooses from; its estimator's state is a `Memory`.
      sensing: the robot's field of view.
    """
    height, width, batch = belief.height, belief.width, belief.pose.x.ndim
    sums = corner_sums(_planes(belief, situation), lead=1)

    def shares(x: Array, y: Array, radius: Int[np.ndarray, "block"]) -> Float[Array, "block plane *batch"]:
        """Shares in squares around cells."""
        radius = radius.reshape(-1, *(1,) * batch)
        counts = in_rectangle(sums, x - radius, y - radius, x + radius + 1, y + radius + 1)
        return jnp.moveaxis(counts / (2 * radius + 1) ** 2, 0, 1).astype(jnp.float32)

    ahead_x, ahead_y, right_x, right_y = _turned(belief.pose)
    ahead, right = (way.reshape(-1, *(1,) * batch) for way in _OFFSETS)
    x = belief.pose.x + ahead * ahead_x + right * right_x
    y = belief.pose.y + ahead * ahead_y + right * right_y

    # The nearest candidate of each block: of equal ones, the first.
    none = jnp.iinfo(jnp.int32).max
    eligible = poses.unpack(situation.candidates, width) & (situation.distance >= 0)
    actions = jnp.where(eligible, situation.distance, none)
    nearest, block = jnp.min(actions, axis=0), block_of_cells(belief.pose, height, width)
    cell = jnp.arange(height * width, dtype=jnp.int32).reshape(height, width, *(1,) * batch)

    def first_of_nearest(number: Array) -> tuple[Array, Array]:
        """Actions to the nearest candidate of a block, and its cell."""
        inside = jnp.where(block == number, nearest, none)
        least = jnp.min(inside, axis=(0, 1))
        return least, jnp.min(jnp.where(inside == least, cell, none), axis=(0, 1))

    # A loop: fused, the block of each cell would be computed again for each of the blocks.
    distance, there = jax.lax.map(first_of_nearest, jnp.arange(BLOCKS))
    present, (there_y, there_x) = distance < none, jnp.divmod(there, width)
    gain = sensing.count_seen(frontiers.unseen(belief), belief.opaque, width)
    heading = jnp.argmin(at_cells(actions, there_x, there_y), axis=0)
    revealed = jnp.take_along_axis(at_cells(gain, there_x, there_y), heading[None], axis=0)[0]
    numbers = present, distance / 100, jnp.log1p(distance) / 5, revealed.astype(jnp.int32) / 50
    around = [shares(there_x, there_y, np.full(BLOCKS, radius)) for radius in _RADII]
    subgoals = jnp.concatenate([*around, jnp.stack(numbers, axis=1).astype(jnp.float32)], axis=1)
    return PolicyInputs(shares(x, y, _SIDES // 2), jnp.where(present[:, None], subgoals, 0), present)


def _visiting(belief: Belief, memory: Memory) -> Memory:
    """The memory of a robot that has visited the cell where it is."""
    here = bitboard.single(belief.pose.x, belief.pose.y, *memory.visited.shape[:2])
    return memory._replace(visited=memory.visited | here)


@struct.dataclass
class RecurrentPolicy(ChoosingPlanner):
    """The block of the map around the robot that a recurrent policy prefers: the nearest pose there is the subgoal.

    The policy is learned by proximal policy optimization (Schulman, Wolski, Dhariwal, Radford and Klimov 2017, arXiv
    1707.06347) with a recurrent layer, as those of Mirowski et al., "Learning to navigate in complex environments"
    (ICLR 2017) and Wijmans et al., "DD-PPO" (ICLR 2020). These choose motions from images, after millions to billions
    of steps. Here, as in Niroui, Zhang, Kashino and Nejat, "Deep reinforcement learning robot for search and rescue
    applications" (RA-L 2019) and Chaplot et al., "Learning to explore using active neural SLAM" (ICLR 2020), the policy
    chooses where to go from the map so far, and a search finds the way. It sees an egocentric crop, coarser farther
    away: at four scales, nine blocks and what share of each is unknown, blocked, house, driveway, path, other ground,
    goal, visited, or worth a visit; and the same around the nearest candidate of each block, with its distance and what
    it reveals. `examples/ppo.py` learns the weights.

    Attributes:
      weights: weights of a `RecurrentNetwork`; by default the shipped ones.
    """

    replan_fraction: float = struct.field(pytree_node=False, default=0.5)
    weights: dict[str, Any] = struct.field(default_factory=read_policy, repr=False)

    def init(self, world: World) -> Chosen:
        """Nothing is reachable, visited or remembered before the first observation."""
        nothing, zero = jnp.zeros_like(world.goals), jnp.zeros(world.goals.shape[2:], jnp.int32)
        hidden, logits = (jnp.zeros((size, *zero.shape), jnp.float32) for size in (RecurrentNetwork.UNITS, BLOCKS))
        return super().init(world)._replace(estimator=Memory(nothing, hidden, logits))

    def prefer(self, seen: PolicyInputs, memory: Memory) -> Memory:
        """The memory after a look at the inputs, with the preference for each block."""
        network = with_weights(RecurrentNetwork, RecurrentNetwork.UNITS, self.weights)
        count = seen.present.ndim - 1

        def first(leaf: Array) -> Array:
            """Axes of the batch come first."""
            return jnp.moveaxis(leaf, range(-count, 0), range(count))

        seen, hidden = jax.tree.map(first, (seen, memory.hidden))
        hidden = network.remember(hidden, seen.shares)
        logits = network.rate(hidden, seen)
        return memory._replace(hidden=jnp.moveaxis(hidden, -1, 0), logits=jnp.moveaxis(logits, -1, 0))

    def prepare(self, belief: Belief, situation: Situation) -> Memory:
        """Look around before a choice."""
        memory = _visiting(belief, situation.estimator)
        seen = policy_inputs(belief, situation._replace(estimator=memory), self.rules.sensing)
        return self.prefer(seen, memory)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """The negative of the preference for the pose's block."""
        block = block_of_cells(belief.pose, belief.height, belief.width)
        flat = jnp.take_along_axis(situation.estimator.logits, block.reshape(-1, *block.shape[2:]), axis=0)
        return -jnp.broadcast_to(flat.reshape(block.shape), (HEADINGS, *block.shape))

    def conclude(self, belief: Belief, state: Chosen, looked: Any, ask: Any) -> tuple[Assessment, Chosen]:
        """See `ChoosingPlanner.conclude`. The robot's cell has been visited."""
        assessment, state = super().conclude(belief, state, looked, ask)
        return assessment, state._replace(estimator=_visiting(belief, state.estimator))
