"""Whatever a planner decides, the bound holds; checked by replaying the actions in plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import line_of_sight
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.bounded import Bounded
from dc2g_jax._src.planning.planners import DC2G, GAVE_UP, Frontier
from dc2g_jax._src.planning.rules import complete_rules, reference_rules
from dc2g_jax._src.rollouts.rollout import rollout
from tests.oracles import numpy_gridworld as oracle
from tests.support.exploration import EXPANDING, SENSING, LowestColumn, Scattered
from tests.support.hostile import KINDS, Hostile, misleading_worlds

SHAPE = (14, 33)
SIDES = sum(SHAPE)
STEP_LIMIT = 1000
EPISODES = 64
COMPLETE = complete_rules(SENSING)

pytestmark = pytest.mark.usefixtures("optimized")

#: Pairs of factor and slack, the slack as a multiple of the sides.
BOUNDS = ((1.0, 0.2), (1.0, 1.0), (1.5, 0.0), (2.0, 0.5), (3.0, 2.0))


def run(planner, terrains, starts, step_limit=STEP_LIMIT):
    worlds = World.from_terrain(np.moveaxis(terrains, 0, -1))
    episodes = jnp.arange(len(starts)), make_pose(*np.array(starts).T)
    sensing = planner.rules.sensing
    return rollout(planner, worlds, *episodes, sensing=sensing, step_limit=step_limit, slots=64)


def steps_to_the_door(terrain, pose, actions):
    """Replay actions in plain NumPy: the number of them that lead over traversable ground to the door."""
    for number, action in enumerate(actions, 1):
        pose = oracle.moved(pose, int(action), terrain.shape)
        assert terrain[pose[1], pose[0]] in oracle.TRAVERSABLE_CLASSES
        if terrain[pose[1], pose[0]] == oracle.FRONT_DOOR:
            return number
    return None


def largest_ratio(done, terrains, starts, frontier_steps, factor, slack):
    """Check the bound in every episode, and return the largest ratio of the steps beyond the slack to frontier's."""
    ratios = []
    for number, (terrain, pose) in enumerate(zip(terrains, starts, strict=True)):
        steps = steps_to_the_door(terrain, pose, done.actions[number, : done.steps[number]])
        assert steps == done.steps[number], number
        assert steps <= factor * frontier_steps[number] + slack, (number, steps, frontier_steps[number])
        ratios.append((steps - slack) / frontier_steps[number])
    return max(ratios)


def plain_frontier_steps(terrains, starts, rules):
    """The actions of frontier exploration, by the plain implementation."""
    found = []
    for terrain, pose in zip(terrains, starts, strict=True):
        radii = {"sensing_radius": SENSING, "expanding_radius": EXPANDING}
        success, actions, _ = oracle.run_episode(terrain, pose, "frontier", rules=rules, max_steps=STEP_LIMIT, **radii)
        assert success
        found.append(len(actions))
    return found


@pytest.mark.slow
def test_no_planner_breaks_the_bound():
    terrains, starts = misleading_worlds(SHAPE, 100, EPISODES)
    frontier_steps = plain_frontier_steps(terrains, starts, "complete")
    tight = []
    for factor, slack in BOUNDS:
        planner = Bounded(Hostile(COMPLETE), COMPLETE, factor, slack)
        done = run(planner, terrains, starts)
        tight.append(largest_ratio(done, terrains, starts, frontier_steps, factor, slack * SIDES) / factor)
    # The bound is not out of reach: hostile planners come close to it.
    assert max(tight) > 0.9


@pytest.mark.slow
def test_the_bound_holds_where_walls_hide_what_is_behind_them():
    rules = complete_rules(SENSING, line_of_sight)
    terrains, starts = misleading_worlds(SHAPE, 500, EPISODES)
    alone = run(Frontier(rules), terrains, starts)
    assert alone.success.all()
    done = run(Bounded(Hostile(rules), rules, 1.0, 0.4, virtual_steps=1), terrains, starts)
    largest_ratio(done, terrains, starts, alone.steps, 1.0, 0.4 * SIDES)


@pytest.mark.slow
def test_the_bound_holds_under_the_reference_rules_where_frontier_exploration_ends():
    rules = reference_rules(SENSING, EXPANDING)
    terrains, starts = misleading_worlds(SHAPE, 600, EPISODES)
    alone = run(Frontier(rules), terrains, starts)
    ends = np.flatnonzero(alone.success)
    assert len(ends) > EPISODES / 2
    done = run(Bounded(Hostile(rules), rules, 2.0, 0.3), terrains[ends], [starts[number] for number in ends])
    largest_ratio(done, terrains[ends], [starts[number] for number in ends], alone.steps[ends], 2.0, 0.3 * SIDES)


@pytest.mark.release
@pytest.mark.parametrize("number", range(len(BOUNDS)))
def test_no_planner_breaks_the_bound_in_thousands_of_episodes(number):
    factor, slack = BOUNDS[number]
    terrains, starts = misleading_worlds((20, 40), 10_000 + 2000 * number, 2000)
    alone = run(Frontier(COMPLETE), terrains, starts, step_limit=4000)
    assert alone.success.all()
    done = run(Bounded(Hostile(COMPLETE), COMPLETE, factor, slack), terrains, starts, step_limit=4000)
    ratio = largest_ratio(done, terrains, starts, alone.steps, factor, slack * 60)
    print(f"factor {factor}, slack {slack} x 60: largest (T - slack) / F {ratio:.3f}")


@pytest.mark.slow
def test_with_infinite_slack_the_actions_are_the_wrapped_planners():
    terrains, starts = misleading_worlds(SHAPE, 700, EPISODES)
    alone = run(Hostile(COMPLETE), terrains, starts)
    done = run(Bounded(Hostile(COMPLETE), COMPLETE, 1.0, np.inf), terrains, starts)
    # Where a planner gives up or may drive into a wall, which none is allowed to, the robot goes with the shadow.
    allowed = np.arange(EPISODES) % KINDS < 5
    np.testing.assert_array_equal(done.actions[allowed], alone.actions[allowed])


@pytest.mark.slow
def test_without_slack_the_actions_are_those_of_frontier_exploration():
    terrains, starts = misleading_worlds(SHAPE, 800, EPISODES)
    alone = run(Frontier(COMPLETE), terrains, starts)
    done = run(Bounded(Hostile(COMPLETE), COMPLETE, 1.0, 0.0), terrains, starts)
    np.testing.assert_array_equal(done.actions, alone.actions)


def test_a_robot_that_cannot_reach_the_door_is_left_to_the_wrapped_planner(island):
    done = run(Bounded(Frontier(COMPLETE), COMPLETE, 1.0, 0.0), island[None], [(0, 0, 0)])
    assert not done.success[0]
    assert done.mode[0] == GAVE_UP


def test_the_shadow_explores_as_frontier_does_by_so_many_actions_a_decision(street):
    virtual_steps = 3
    world, start = World.from_terrain(street), make_pose(8, 4, 2)
    alone = gridworld.reset(world, start, COMPLETE.sensing)
    reachable, at = Frontier(COMPLETE).init(world), [start]
    planner = Bounded(Frontier(COMPLETE), COMPLETE, 1.0, np.inf, virtual_steps)
    state, everything = planner.init(world), gridworld.belief_from_map(street, start)
    decide, explore = jax.jit(planner.plan), jax.jit(Frontier(COMPLETE).plan)
    for number in range(1, 3):
        _, state = decide(everything, state)
        assert int(state.shadow.steps) == number * virtual_steps - 1
        while len(at) < number * virtual_steps:
            plan, reachable = explore(alone, reachable)
            alone = gridworld.step(world, alone, plan.action, COMPLETE.sensing)
            at.append(alone.pose)
        jax.tree.map(np.testing.assert_array_equal, state.shadow.pose, at[-1])


def test_the_assessment_describes_the_plan_that_is_carried_out(street):
    planner = Bounded(LowestColumn(COMPLETE), COMPLETE, 1.0, 0.0)
    world = World.from_terrain(street)
    belief = gridworld.reset(world, make_pose(8, 4, 0), COMPLETE.sensing)
    state = planner.init(world)
    wrapped, _ = planner.planner.assess(belief, state.planner)
    assessment, _ = planner.assess(belief, state)
    plan, later = planner.plan(belief, state)
    jax.tree.map(np.testing.assert_array_equal, assessment.plan, plan)
    np.testing.assert_array_equal(assessment.score, wrapped.score)
    np.testing.assert_array_equal(assessment.candidates, wrapped.candidates)
    assert bool(later.led)
    assert int(plan.length) == 1


def test_no_bound_is_left_on_a_map_whose_cells_changed(street):
    planner = Bounded(DC2G(Scattered(), COMPLETE), COMPLETE, 1.0, 0.0)
    world = World.from_terrain(street)
    belief = gridworld.reset(world, make_pose(8, 4, 2), COMPLETE.sensing)
    _, state = planner.plan(belief, planner.init(world))
    nothing = jnp.zeros_like(state.shadow.seen)
    same, other = planner.revised(state, nothing), planner.revised(state, nothing.at[0, 4].set(1))
    jax.tree.map(np.testing.assert_array_equal, same, state)
    for revised, is_free in ((same, False), (other, True)):
        wrapped, _ = planner.planner.plan(belief, revised.planner)
        plan, _ = planner.plan(belief, revised)
        assert np.array_equal(plan.subgoals, wrapped.subgoals) == is_free
