"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .recurrent_policy import (
    PolicyInputs as PolicyInputs,
    RecurrentNetwork as RecurrentNetwork,
    RecurrentPolicy as RecurrentPolicy,
    read_policy as read_policy,
)
from .right_hand import RightHand as RightHand
from .scores import (
    CostUtility as CostUtility,
    FrontierPotential as FrontierPotential,
    Hysteresis as Hysteresis,
    NextBestView as NextBestView,
    RandomFrontier as RandomFrontier,
    VisibleUncertainty as VisibleUncertainty,
)
from .subgoals import LearnedSubgoals as LearnedSubgoals, SampledGoals as SampledGoals
