"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .learned_subgoals import LearnedSubgoals as LearnedSubgoals
from .recurrent_policy import (
    PolicyInputs as PolicyInputs,
    RecurrentNetwork as RecurrentNetwork,
    RecurrentPolicy as RecurrentPolicy,
    read_policy as read_policy,
)
from .right_hand import RightHand as RightHand
from .sampled_goals import SampledGoals as SampledGoals
from .scores import (
    CostUtility as CostUtility,
    FrontierPotential as FrontierPotential,
    Hysteresis as Hysteresis,
    NextBestView as NextBestView,
    RandomFrontier as RandomFrontier,
    VisibleUncertainty as VisibleUncertainty,
)
