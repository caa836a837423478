"""Nearest frontier with hysteresis: another frontier must be clearly nearer before the robot turns to it."""

import jax.numpy as jnp
from flax import struct

from dc2g_jax.grid import Belief, poses
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation


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
