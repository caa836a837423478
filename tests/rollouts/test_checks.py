"""What the checks of a user's planner or estimator notice, each in one that breaks a single rule."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import pytest
from flax import struct

import dc2g_jax as dc2g
from dc2g_jax._src.estimation.estimators import ExactCostToGo
from dc2g_jax._src.planning.planners import DC2G, EXPLORE, TO_GOAL, Frontier, Planner
from dc2g_jax._src.planning.rules import Rules, complete_rules
from dc2g_jax._src.rollouts.checks import _differing, check_estimator, check_planner
from tests.support.exploration import Scattered
from tests.support.refusals import refusal

RULES = complete_rules(5)

#: The planners whose check is no slow test.
QUICK = ("oracle", "frontier", "true_cost_to_go", "right_hand")

traces = itertools.count()


def name_of(tested: Any) -> str:
    """The name of a planner's or an estimator's class; none for the expected lines."""
    if isinstance(tested, str):
        return ""
    return tested.__name__ if isinstance(tested, type) else type(tested).__name__


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in dc2g.PLANNERS]
)
def test_shipped_planners_pass(name):
    check_planner(dc2g.make_planner(name))


def test_the_authors_rules_do_not_always_end_an_exploration():
    """A robot can turn back and forth between two poses that reveal nothing, as the authors' robots did."""
    refusal(
        lambda: check_planner(dc2g.make_planner("frontier", settings="published")),
        "planner Frontier: episode 2, decision 361: the last 357 actions explored and revealed nothing; expected "
        "something new within 356, or giving up",
    )


@struct.dataclass
class Fair:
    """Frontier exploration. The planners below break one rule each."""

    def init(self, world) -> Any:
        return Frontier(RULES).init(world)

    def plan(self, belief, state):
        return Frontier(RULES).plan(belief, state)


def test_planners_and_estimators_of_a_users_own_pass():
    check_planner(Fair())
    check_estimator(Scattered())
    check_estimator(ExactCostToGo())


class Undecorated(Fair):
    pass


@struct.dataclass
class NoPlan:
    def init(self, world):
        return ()


@struct.dataclass
class NoDecision(Planner):
    def init(self, world):
        return ()


@struct.dataclass
class OpenRules(Fair):
    rules: Rules = RULES


@struct.dataclass
class NoCount(Fair):
    batch_per_core = 0


@struct.dataclass
class BarePlan(Fair):
    def plan(self, belief, state):
        return super().plan(belief, state)[0]


@struct.dataclass
class ShortMode(Fair):
    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan.replace(mode=plan.mode.astype(jnp.int8)), state


@struct.dataclass
class OneStateForAll(Fair):
    def init(self, world):
        return {"reachable": super().init(world), "visits": jnp.zeros(3)}


@struct.dataclass
class Counting(Fair):
    """The count is a Python number at first, and a strongly typed one after a step."""

    def init(self, world):
        return super().init(world), jnp.zeros(world.goals.shape[2:], jnp.int32) if world.goals.ndim > 2 else 0

    def plan(self, belief, state):
        plan, reachable = super().plan(belief, state[0])
        return plan, (reachable, state[1] + belief.steps)


@struct.dataclass
class Grows(Fair):
    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan, jnp.concatenate([state, state])


@struct.dataclass
class Restructures(Fair):
    def init(self, world):
        return super().init(world), ()

    def plan(self, belief, state):
        plan, reachable = super().plan(belief, state[0])
        return plan, (reachable, None)


@struct.dataclass
class Single(Fair):
    """Knows of no batch."""

    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan.replace(mode=plan.mode.reshape(())), state


@struct.dataclass
class Branches(Fair):
    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return (plan, state) if plan.mode == EXPLORE else (plan, belief.seen)


@struct.dataclass
class InPlace(Fair):
    def init(self, world):
        return {"reachable": super().init(world)}

    def plan(self, belief, state):
        plan, state["reachable"] = super().plan(belief, state["reachable"])
        return plan, state


@struct.dataclass
class Moody(Fair):
    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan.replace(length=plan.length + next(traces)), state


@struct.dataclass
class OtherMode(Fair):
    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan.replace(mode=jnp.full_like(plan.mode, 7)), state


@struct.dataclass
class OtherAction(Fair):
    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan.replace(action=jnp.full_like(plan.action, 3)), state


@struct.dataclass
class Spins(Fair):
    """Turns left forever."""

    mode: int = struct.field(pytree_node=False, default=EXPLORE)

    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan.replace(action=jnp.ones_like(plan.action), mode=jnp.full_like(plan.mode, self.mode)), state


@struct.dataclass
class Follows(Fair):
    """All robots of a batch do as the first one."""

    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return plan.replace(action=jnp.full_like(plan.action, jnp.ravel(plan.action)[0])), state


@pytest.mark.parametrize(
    ("planner", "line"),
    [
        (Fair, "is a class; expected an instance of it, such as Fair(...)"),
        (Undecorated(), "is no pytree; expected a class decorated with flax.struct.dataclass"),
        (NoPlan(), "has no method plan; expected the methods init and plan"),
        (NoDecision(), "plan for one robot raises NotImplementedError: a planner needs a method plan"),
        (OpenRules(), "expected an array, or a static field: struct.field(pytree_node=False)"),
        (NoCount(), "batch_per_core is 0; expected a number of robots, 1 or more"),
        (BarePlan(), "plan returns 'Plan'; expected a tuple of a Plan and a state"),
        (ShortMode(), "plan of one robot, .mode is int8[]; expected int32[]"),
        (OneStateForAll(), "state of a batch, ['visits'] is float32[3]; expected float32[3, 9]"),
        (Counting(), "state of one robot after a step, [1] is int32[]; expected int32[] (weakly typed)"),
        (Grows(), "state of one robot after a step, the value is uint32[4, 12]; expected uint32[2, 12]"),
        (Restructures(), "the state of one robot has another structure after a step; expected that of init"),
        (Single(), "plan for a batch of 9 raises TypeError: cannot reshape array of shape (9,)"),
        (Branches(), "plan for one robot raises TracerBoolConversionError: Attempted boolean conversion"),
        (Branches(), "use jnp.where or jax.lax.cond instead of if"),
        (InPlace(), "plan changes its arguments or itself; expected a pure function"),
        (Moody(), "episode 0, decision 1: [0].length differs between two calls with the same inputs"),
        (OtherMode(), "episode 0, decision 1: mode is 7; expected 0 to 2"),
        (OtherAction(), "episode 0, decision 1: action is 3; expected 0 to 2"),
        (Spins(), "the last 357 actions explored and revealed nothing; expected something new within 356"),
        (Spins(TO_GOAL), "episode 0 has not ended after 500 actions (mode to_goal); expected a goal or giving up"),
        (Follows(), "episode 1, decision 17: in a batch of 9 the robot's action is F; expected L, as alone"),
    ],
    ids=name_of,
)
def test_a_planner_that_breaks_a_rule(planner, line):
    refusal(lambda: check_planner(planner), f"planner {name_of(planner)}: ", line)


# --- estimators ---------------------------------------------------------------------------------------


@struct.dataclass
class Flat(ExactCostToGo):
    def estimate(self, terrain, state):
        return super().estimate(terrain, state)[0]


@struct.dataclass
class NoOutcome(ExactCostToGo):
    def estimate(self, terrain, state):
        return super().estimate(terrain, state)[:0]


@struct.dataclass
class WholeNumbers(ExactCostToGo):
    def estimate(self, terrain, state):
        return super().estimate(terrain, state).astype(jnp.int32)


@struct.dataclass
class KeepsNoBatch(ExactCostToGo):
    def init(self, world):
        return jnp.zeros(2)


@struct.dataclass
class NoNumber(ExactCostToGo):
    """Divides by zero where nothing has been seen."""

    def estimate(self, terrain, state):
        return super().estimate(terrain, jnp.zeros_like(state)) + (terrain / terrain)[None]


@struct.dataclass
class Infinite(ExactCostToGo):
    """Divides by the number of front doors that have been seen."""

    def estimate(self, terrain, state):
        return jnp.ones_like(state)[None] / jnp.sum(terrain == 1, axis=(0, 1))


@struct.dataclass
class Normalized(Scattered):
    """By the mean of the whole batch."""

    def estimate(self, terrain, state):
        costs = super().estimate(terrain, state)
        return costs / jnp.mean(costs)


@struct.dataclass
class Drifts(Scattered):
    def estimate(self, terrain, state):
        return super().estimate(terrain, state) + next(traces)


@pytest.mark.parametrize(
    ("estimator", "line"),
    [
        (ExactCostToGo, "is a class; expected an instance of it, such as ExactCostToGo(...)"),
        (Frontier(RULES), "has no method estimate; expected the methods init and estimate"),
        (
            Flat(),
            "the estimate of one map is float32[12, 40]; expected floating-point numbers [outcomes, 12, 40], with one "
            "outcome at least",
        ),
        (NoOutcome(), "the estimate of one map is float32[0, 12, 40]; expected floating-point numbers [outcomes, 12"),
        (WholeNumbers(), "the estimate of one map is int32[1, 12, 40]; expected floating-point numbers [outcomes, 12"),
        (KeepsNoBatch(), "state of a batch, the value is float32[2]; expected float32[2, 9]"),
        (NoNumber(), "first view of episode 0: the estimate of cell (0, 0), outcome 0, is nan; expected a finite"),
        (Infinite(), "first view of episode 0: the estimate of cell (4, 6), outcome 0, is inf; expected a finite"),
        (Normalized(), "in a batch of 9 the estimate differs by 0.00465; expected that of the map alone"),
        (Drifts(), "estimates of the first view differ between two calls with the same inputs"),
    ],
    ids=name_of,
)
def test_an_estimator_that_breaks_a_rule(estimator, line):
    refusal(lambda: check_estimator(estimator), f"estimator {name_of(estimator)}: ", line)


def test_the_estimator_of_a_planner_is_checked_too():
    refusal(lambda: check_planner(DC2G(Flat(), RULES)), "estimator Flat: the estimate of one map")


def test_states_are_compared_with_the_random_keys_in_them():
    state = {"count": jnp.int32(1), "key": jax.random.key(0)}
    assert _differing(state, dict(state)) is None
    assert "key" in str(_differing(state, state | {"key": jax.random.key(1)}))
    assert "count" in str(_differing(state, state | {"count": jnp.int32(2)}))
