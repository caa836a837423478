"""Planners that are one score of the frontier-expanding poses each, most of them after other papers."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, UInt32

from dc2g_jax.estimation import Estimator
from dc2g_jax.grid import Belief, bitboard, poses
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, predicted, unknown_share, unseen

#: Bits of the whole numbers that uncertainties are rounded to, so that they can be added over fields of view.
_BITS = 4


def _mixed(number: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
    """A number whose bits all depend on all bits of another one (the last steps of MurmurHash3, Appleby 2011)."""
    number = (number ^ (number >> 16)) * jnp.uint32(0x85EBCA6B)
    number = (number ^ (number >> 13)) * jnp.uint32(0xC2B2AE35)
    return number ^ (number >> 16)


@struct.dataclass
class RandomFrontier(ChoosingPlanner):
    """Goes to a frontier-expanding cell at random, all alike, and chooses again when it reveals nothing more.

    It is the yardstick: a planner below it has learned nothing from the map. Random numbers are a hash of the robot's
    pose and of how much it has seen. So the planner is a pure function, and an episode can be repeated.
    """

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """A random number of every cell."""
        salt = jnp.zeros_like(belief.pose.x).astype(jnp.uint32)
        for number in (belief.pose.x, belief.pose.y, belief.pose.heading, bitboard.count(belief.seen)):
            salt = _mixed(salt + number.astype(jnp.uint32) + jnp.uint32(1))
        shape = (belief.height, belief.width, *(1 for _ in salt.shape))
        cell = jnp.arange(belief.height * belief.width, dtype=jnp.uint32).reshape(shape)
        numbers = _mixed(cell ^ salt) >> 8  # a float holds 24 bits exactly
        return jnp.broadcast_to(numbers.astype(jnp.float32), situation.distance.shape)


@struct.dataclass
class Hysteresis(ChoosingPlanner):
    """The nearest frontier-expanding pose, but the last choice wins unless another is nearer by a margin.

    After Holz, Basilico, Amigoni and Behnke, "Evaluating the efficiency of frontier-based exploration strategies" (ISR
    2010): choosing anew at every step makes a robot turn back and forth, keeping to a frontier until it is reached
    leads past others. This is in between.

    Attributes:
      margin: actions by which another pose has to be nearer.
    """

    replan_fraction: float = struct.field(pytree_node=False, default=0.0)
    margin: float = struct.field(pytree_node=False, default=3.0)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """Actions to the pose, less the margin for the last choice."""
        kept = poses.unpack(situation.kept, belief.width)
        return situation.distance.astype(jnp.float32) - self.margin * kept


@struct.dataclass
class CostUtility(ChoosingPlanner):
    """The frontier with the largest utility less cost.

    After Burgard, Moors, Stachniss and Schneider, "Coordinated multi-robot exploration" (T-RO 2005): utility - beta
    cost. There, a frontier's utility is 1, less what other robots are about to see. With one robot nothing is taken
    off, and all frontiers would be alike. So here the utility is the share of the square within sensing range that has
    not been observed; the cost is the number of actions on the way, not weighted by occupancy, in sensing ranges.

    Attributes:
      beta: weight of the cost.
    """

    beta: float = struct.field(pytree_node=False, default=0.03)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """Weighted cost less utility."""
        radius = self.rules.sensing.radius
        return self.beta / radius * situation.distance - unknown_share(belief, radius)


@struct.dataclass
class NextBestView(ChoosingPlanner):
    """The pose of the largest gain A exp(-lambda L).

    After Gonzalez-Banos and Latombe, "Navigation strategies for exploring indoor environments" (IJRR 2002). A is the
    number of unobserved cells in the field of view at the pose, with what is known to hide others; L is the number of
    actions on the way. Candidates are the frontier-expanding poses instead of a random sample of free space.

    Attributes:
      discount: lambda, for each action.
    """

    discount: float = struct.field(pytree_node=False, default=0.1)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """Minus the logarithm of the gain."""
        gain = self.rules.sensing.count_seen(unseen(belief), belief.opaque, belief.width)
        return self.discount * situation.distance - jnp.log(gain.astype(jnp.float32))


@struct.dataclass
class FrontierPotential(ChoosingPlanner):
    """The frontier of the largest potential: alpha times that of the area, and the rest that of the goal.

    After Ramakrishnan, Chaplot, Al-Halah, Malik and Grauman, "PONI: Potential functions for object goal navigation
    with interaction-free learning" (CVPR 2022). The potential of the goal is 1 less its distance over a largest
    distance, 0 at least, as there. There, a network learned both potentials of every frontier. Here the distance to the
    goal is the mean cost-to-go of the estimator, and the potential of the area is the unobserved share of the square
    of twice the sensing range around the cell. As there, the distance to the frontier does not count.

    Attributes:
      estimator: predicts costs-to-go in cells.
      alpha: weight of the area.
      farthest: distance to the goal from which on the potential is 0, in cells.
    """

    estimator: Estimator = struct.field(kw_only=True)
    replan_fraction: float = struct.field(pytree_node=False, default=1.0)
    alpha: float = struct.field(pytree_node=False, default=0.5)
    farthest: float = struct.field(pytree_node=False, default=50.0)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """Minus the potential of the cell; of its poses, the nearest wins."""
        cost = jnp.mean(predicted(self.estimator, belief, situation.estimator), axis=0)
        area = unknown_share(belief, 2 * self.rules.sensing.radius)
        goal = jnp.maximum(0.0, 1 - cost / self.farthest)
        return jnp.broadcast_to(-(self.alpha * area + (1 - self.alpha) * goal), situation.distance.shape)


@struct.dataclass
class VisibleUncertainty(ChoosingPlanner):
    """The pose of the largest uncertainty in view, over the number of actions on the way.

    After Ho, Kim, Moon, Parandekar, Harutyunyan, Wang, Sycara, Best and Scherer, "MapEx: Indoor structure exploration
    with probabilistic information gain from global map predictions" (ICRA 2025). There, an ensemble of networks
    completes the map; an information gain is the variance among its members, added over the cells that would be seen,
    with walls of the mean prediction to hide others; it is divided by the distance. Here the members are the outcomes
    of the estimator, which predict costs-to-go, not walls: what is known hides others, where the rules say so. So the
    robot goes where the way to the goal is least certain.

    Attributes:
      estimator: predicts costs-to-go, with several outcomes.
    """

    estimator: Estimator = struct.field(kw_only=True)

    def _in_view(self, belief: Belief, values: Float[Array, "h w *batch"]) -> PoseValues:
        """Sum over the unobserved cells that are seen from every pose of values from 0 to 1, in `_BITS` bits."""
        steps = 2**_BITS - 1
        whole = jnp.round(jnp.clip(values, 0, 1) * steps).astype(jnp.int32)
        total = jnp.float32(0)
        for bit in range(_BITS):
            cells = unseen(belief) & bitboard.pack((whole >> bit) & 1 == 1)
            total += 2**bit * self.rules.sensing.count_seen(cells, belief.opaque, belief.width).astype(jnp.float32)
        return jnp.asarray(total / steps)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """Minus the uncertainty in view over the distance."""
        spread = jnp.std(predicted(self.estimator, belief, situation.estimator), axis=0)
        largest = jnp.max(spread, axis=(0, 1))
        relative = jnp.where(largest > 0, spread / jnp.where(largest > 0, largest, 1), 1.0)
        return -self._in_view(belief, relative) / jnp.maximum(situation.distance, 1)
