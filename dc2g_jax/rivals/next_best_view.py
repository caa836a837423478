"""Next best view: the pose that would reveal most, discounted by the way there."""

import jax.numpy as jnp
from flax import struct

from dc2g_jax.grid import Belief
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, unseen


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
