"""Planners, their rules, and the planner on a robot."""

from dc2g_jax._src.grid.squares import at_cells as at_cells, corner_sums as corner_sums, in_rectangle as in_rectangle
from dc2g_jax._src.planning import frontiers as frontiers
from dc2g_jax._src.planning.bounded import Bounded as Bounded
from dc2g_jax._src.planning.choosing import (
    ChoosingPlanner as ChoosingPlanner,
    Chosen as Chosen,
    PoseValues as PoseValues,
    Situation as Situation,
    exploring_poses as exploring_poses,
    predicted as predicted,
    unknown_share as unknown_share,
)
from dc2g_jax._src.planning.decisions import (
    Decision as Decision,
    RobotPose as RobotPose,
    View as View,
    decide as decide,
)
from dc2g_jax._src.planning.frontiers import unseen as unseen
from dc2g_jax._src.planning.learned_score import LearnedScore as LearnedScore
from dc2g_jax._src.planning.metric import MetricDecision as MetricDecision, MetricPlanner as MetricPlanner
from dc2g_jax._src.planning.metric_map import MetricMap as MetricMap, MetricPose as MetricPose
from dc2g_jax._src.planning.named import (
    NETWORK_PLANNERS as NETWORK_PLANNERS,
    PLANNERS as PLANNERS,
    make_planner as make_planner,
    planner_with as planner_with,
)
from dc2g_jax._src.planning.online import OnlinePlanner as OnlinePlanner, view_of as view_of
from dc2g_jax._src.planning.planners import (
    DC2G as DC2G,
    EXPLORE as EXPLORE,
    GAVE_UP as GAVE_UP,
    MODE_NAMES as MODE_NAMES,
    TO_GOAL as TO_GOAL,
    Assessment as Assessment,
    Frontier as Frontier,
    Oracle as Oracle,
    Plan as Plan,
    Planner as Planner,
    assess as assess,
    explore_or_finish as explore_or_finish,
    reachable_cells as reachable_cells,
)
from dc2g_jax._src.planning.rules import (
    SETTINGS as SETTINGS,
    Rules as Rules,
    Settings as Settings,
    complete_rules as complete_rules,
    first_goal as first_goal,
)
from dc2g_jax._src.planning.selection import ExpectedCost as ExpectedCost, QuantileCost as QuantileCost
from dc2g_jax._src.runtime.programs import jit as jit
