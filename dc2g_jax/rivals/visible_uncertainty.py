"""Uncertainty in view: the pose that sees the cells of which an ensemble of predictions is least sure."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from dc2g_jax.estimation import Estimator
from dc2g_jax.grid import Belief, bitboard
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, predicted, unseen

#: Bits of the whole numbers that uncertainties are rounded to, so that they can be added over fields of view.
_BITS = 4


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
