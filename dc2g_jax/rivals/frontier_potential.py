"""Potential of frontiers: what a network promises there, and how much is unknown there."""

import jax.numpy as jnp
from flax import struct

from dc2g_jax.estimation import Estimator
from dc2g_jax.grid import Belief
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, predicted, unknown_share


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
