"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .cost_utility import CostUtility as CostUtility
from .frontier_potential import FrontierPotential as FrontierPotential
from .hysteresis import Hysteresis as Hysteresis
from .learned_subgoals import LearnedSubgoals as LearnedSubgoals
from .next_best_view import NextBestView as NextBestView
from .random_frontier import RandomFrontier as RandomFrontier
from .recurrent_policy import (
    PolicyInputs as PolicyInputs,
    RecurrentNetwork as RecurrentNetwork,
    RecurrentPolicy as RecurrentPolicy,
    read_policy as read_policy,
)
from .right_hand import RightHand as RightHand
from .sampled_goals import SampledGoals as SampledGoals
from .visible_uncertainty import VisibleUncertainty as VisibleUncertainty
