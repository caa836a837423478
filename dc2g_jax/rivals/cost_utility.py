"""Cost and utility of frontiers: how much there may be to see, less a price for the way."""

from flax import struct

from dc2g_jax.grid import Belief
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, unknown_share


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
