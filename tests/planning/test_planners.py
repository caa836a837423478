"""Whole episodes on random maps against the plain implementation, action for action."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.estimation.estimators import ExactCostToGo, world_cost_to_go
from dc2g_jax._src.grid import gridworld, poses
from dc2g_jax._src.grid.gridworld import belief_from_map
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.search import EIGHT_CONNECTED, FOUR_CONNECTED
from dc2g_jax._src.grid.sensing import field_of_view, line_of_sight
from dc2g_jax._src.grid.terrain import OPAQUE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.planners import (
    DC2G,
    EXPLORE,
    GAVE_UP,
    MODE_NAMES,
    TO_GOAL,
    Frontier,
    Oracle,
    Planner,
    assess,
)
from dc2g_jax._src.planning.rules import SETTINGS, Settings, complete_rules, named_settings, reference_rules
from dc2g_jax._src.planning.selection import ExpectedCost
from dc2g_jax._src.rollouts.results import action_letters
from dc2g_jax._src.rollouts.rollout import rollout
from dc2g_jax._src.runtime.errors import InputError
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps
from tests.support.exploration import (
    EPISODES,
    EXPANDING,
    SENSING,
    STEP_LIMIT,
    LowestColumn,
    NoNumber,
    Scattered,
    belief_of,
    random_moment,
    random_worlds,
)
from tests.support.refusals import refusal

RULES = {"reference": reference_rules(SENSING, EXPANDING), "complete": complete_rules(SENSING)}

both_rules = pytest.mark.parametrize("rules", RULES)
#: Both, the reference rules in a slow test.
complete_rules_first = pytest.mark.parametrize("rules", ["complete", pytest.param("reference", marks=pytest.mark.slow)])


def run(planner, terrains, starts, sensing=None, step_limit=STEP_LIMIT):
    worlds = World.from_terrain(np.moveaxis(terrains, 0, -1))
    episodes = jnp.arange(len(starts)), make_pose(*np.array(starts).T)
    return rollout(
        planner, worlds, *episodes, sensing=sensing or field_of_view(SENSING), step_limit=step_limit, slots=4
    )


def check_against_oracle(done, terrains, starts, planner: str, rules: str, cost_to_go=lambda index: None):
    for index, (terrain, pose) in enumerate(zip(terrains, starts, strict=True)):
        success, actions, mode = oracle.run_episode(
            terrain,
            pose,
            planner,
            rules=rules,
            sensing_radius=SENSING,
            expanding_radius=EXPANDING,
            max_steps=STEP_LIMIT,
            cost_to_go=cost_to_go(index),
        )
        assert action_letters(done, index) == actions, (index, pose)
        assert (bool(done.success[index]), MODE_NAMES[done.mode[index]]) == (success, mode)
        assert done.steps[index] == len(actions)


@pytest.mark.parametrize("name", ["oracle", "frontier", "true_cost_to_go", "dc2g_bounded", "hysteresis", "right_hand"])
def test_batch_axes_that_come_first_are_refused(name, street):
    """As many robots as rows: without a check, some of these would run."""
    rules, count = complete_rules(SENSING), len(street)
    planner = planner_with(name, rules, ExactCostToGo())
    stack, start = World.from_terrain(np.stack([street] * count, axis=-1)), make_pose(*np.full((3, count), 2))
    belief = gridworld.reset(stack, start, rules.sensing)
    worlds, beliefs = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), (stack, belief))
    for told, state in ((beliefs, stack), (belief, worlds), (beliefs, worlds)):
        decide = functools.partial(planner.plan, told, planner.init(state))
        refusal(decide, "batch axes come last", f"are [{count}, 1, {count}], expected [1, ")


@pytest.mark.parametrize("shape", [(11, 33), (1, 40)], ids="{0[0]}x{0[1]}".format)
def test_oracle_episodes(shape):
    terrains, starts = random_worlds(shape, 100)
    check_against_oracle(run(Oracle(), terrains, starts), terrains, starts, "oracle", "complete")


@both_rules
@pytest.mark.parametrize("shape", [(11, 33), (9, 64)], ids="{0[0]}x{0[1]}".format)
def test_frontier_episodes(shape, rules):
    terrains, starts = random_worlds(shape, 200)
    check_against_oracle(run(Frontier(RULES[rules]), terrains, starts), terrains, starts, "frontier", rules)


@pytest.mark.parametrize(("rules", "moves"), [("reference", EIGHT_CONNECTED), ("complete", FOUR_CONNECTED)])
def test_dc2g_episodes_with_exact_cost_to_go(rules, moves):
    terrains, starts = random_worlds((11, 33), 300)
    planner = DC2G(ExactCostToGo(moves=moves), RULES[rules])
    costs = np.asarray(world_cost_to_go(World.from_terrain(np.moveaxis(terrains, 0, -1)), moves=moves))
    check_against_oracle(
        run(planner, terrains, starts), terrains, starts, "dc2g", rules, cost_to_go=lambda index: costs[..., index]
    )


def scattered(seen, terrain):
    y, x = np.indices(terrain.shape)
    return (7 * x + 5 * y + np.sum(terrain == 0) + terrain) % 11


@both_rules
def test_dc2g_episodes_with_an_estimator_of_what_was_observed(rules):
    terrains, starts = random_worlds((11, 33), 400)
    done = run(DC2G(Scattered(), RULES[rules]), terrains, starts)
    check_against_oracle(done, terrains, starts, "dc2g", rules, cost_to_go=lambda index: scattered)


@functools.cache
def deciding(planner, width: int):
    def decide(terrain, seen, pose):
        plan, _ = planner.plan(belief_of(terrain, seen, pose), planner.init(World.from_terrain(terrain)))
        return plan, poses.unpack(plan.subgoals, width)

    return jax.jit(decide)


@both_rules
def test_dc2g_chooses_the_lowest_cost_to_go_and_of_equals_the_nearest(rules):
    """Algorithm 2, lines 6 to 12, with the default fields."""
    decide, decided, ties = deciding(DC2G(Scattered(), RULES[rules]), 33), 0, 0
    for seed in range(40):
        terrain, seen, pose = random_moment(seed, (7, 33), 0.8)
        terrain = np.where(terrain == oracle.FRONT_DOOR, 3, terrain).astype(np.uint8)
        free = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        reached, radii = oracle.reachable(free, *pose[:2]), {"sensing_radius": SENSING, "expanding_radius": EXPANDING}
        candidates = oracle.explore_poses(seen, reached, pose, rules=rules, **radii)
        candidates = oracle.revealing_poses(candidates, seen, reached, pose, **radii)
        if not candidates.any():
            continue
        cost = scattered(seen, np.where(seen, terrain, 0))
        best = candidates & (cost == min(cost[y, x] for _, y, x in np.argwhere(candidates)))
        plan, subgoals = decide(terrain, seen, pose)
        np.testing.assert_array_equal(subgoals, best)
        distances = oracle.distances_from(free, pose)[best]
        assert (int(plan.mode), int(plan.length)) == (EXPLORE, distances.min())
        decided, ties = decided + 1, ties + int(distances.max() > distances.min())
    assert decided > 20
    assert ties > 10


@both_rules
def test_dc2g_weighs_the_distance_to_a_subgoal(rules):
    shape, decided, weight = (7, 33), 0, 0.5
    decide = deciding(DC2G(Scattered(), RULES[rules], ExpectedCost(weight)), 33)
    for seed in range(40):
        terrain, seen, pose = random_moment(seed, shape, 0.8)
        terrain = np.where(terrain == oracle.FRONT_DOOR, 3, terrain).astype(np.uint8)
        free = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        reached = oracle.reachable(free, *pose[:2])
        candidates = oracle.explore_poses(
            seen, reached, pose, rules=rules, sensing_radius=SENSING, expanding_radius=EXPANDING
        )
        candidates = oracle.revealing_poses(
            candidates, seen, reached, pose, sensing_radius=SENSING, expanding_radius=EXPANDING
        )
        plan, subgoals = decide(terrain, seen, pose)
        if not candidates.any():
            assert int(plan.mode) == GAVE_UP
            continue
        decided += 1
        distance = np.where(candidates, oracle.distances_from(free, pose), np.inf)
        nearest = candidates & (distance == distance.min(axis=0))
        score = scattered(seen, np.where(seen, terrain, 0)) + weight * distance.min(axis=0)
        best = nearest & (score == score[candidates.any(axis=0)].min())
        np.testing.assert_array_equal(subgoals, best)
        actions = oracle.shortest_actions(free, pose, best)
        assert (int(plan.mode), int(plan.action), int(plan.length)) == (EXPLORE, actions[0], len(actions))
    assert decided > 20


@both_rules
def test_once_a_goal_is_reachable_the_plan_goes_there(rules):
    decide = deciding(Frontier(RULES[rules]), 33)
    decided = 0
    for seed in range(60):
        terrain, seen, pose = random_moment(seed, (7, 33), 0.85)
        terrain[(seed * 5) % 7, (seed * 3) % 33] = oracle.FRONT_DOOR
        free = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        goals = oracle.reachable(free, *pose[:2]) & (terrain == oracle.FRONT_DOOR)
        if goals.any() and not goals[pose[1], pose[0]]:
            decided += 1
            plan, _ = decide(terrain, seen, pose)
            actions = oracle.plan_to_goal(free, pose, goals, rules)
            assert (int(plan.mode), int(plan.action), int(plan.length)) == (TO_GOAL, actions[0], len(actions))
    assert decided > 10


# --- exploration ends -----------------------------------------------------------------------------------


def seen_without_occlusion(terrain, pose):
    """Cells seen from a pose."""
    return oracle.visible(pose, SENSING, terrain.shape)


def seen_past_obstacles(terrain, pose):
    """Cells seen from a pose where houses and trees hide what is behind them."""
    return oracle.visible_past(OPAQUE[terrain], pose, SENSING)


#: Planners to explore with, by name. For "learned", far is better than near.
EXPLORERS = {
    "frontier": Frontier,
    "dc2g": lambda rules: DC2G(Scattered(), rules),
    "near": lambda rules: DC2G(Scattered(), rules, ExpectedCost(0.5)),
    "learned": lambda rules: LearnedScore(rules, jnp.linspace(-2, 2, len(TERMS)), Scattered()),
    "learned alone": lambda rules: LearnedScore(rules, jnp.linspace(2, -2, len(TERMS))),
}


@pytest.mark.parametrize(
    ("planner", "rules", "visible"),
    [
        ("frontier", RULES["complete"], seen_without_occlusion),
        ("dc2g", RULES["complete"], seen_without_occlusion),
        pytest.param("near", RULES["complete"], seen_without_occlusion, marks=pytest.mark.slow),
        ("learned", RULES["complete"], seen_without_occlusion),
        ("learned alone", RULES["complete"], seen_without_occlusion),
        ("frontier", complete_rules(SENSING, line_of_sight), seen_past_obstacles),
        ("dc2g", complete_rules(SENSING, line_of_sight), seen_past_obstacles),
        pytest.param("learned", complete_rules(SENSING, line_of_sight), seen_past_obstacles, marks=pytest.mark.slow),
    ],
)
def test_exploration_by_complete_rules_always_ends_with_everything_seen(planner, rules, visible):
    """Without a goal in reach the robot gives up, and by then it has seen all there was to see."""
    shape = (11, 33)
    terrains, starts = random_worlds(shape, 500, doors=0, episodes=40)
    for index in range(0, 40, 2):  # in half of them there is a door, walled in
        row, column = index % 7 + 2, index % 29 + 2
        if abs(starts[index][0] - column) + abs(starts[index][1] - row) > 1:
            terrains[index, row, column - 1 : column + 2] = terrains[index, row - 1 : row + 2, column] = 7
            terrains[index, row, column] = oracle.FRONT_DOOR
    done = run(EXPLORERS[planner](rules), terrains, starts, sensing=rules.sensing, step_limit=2000)
    assert (done.mode == GAVE_UP).all()
    assert not done.success.any()
    for index, (terrain, pose) in enumerate(zip(terrains, starts, strict=True)):
        component = oracle.reachable(np.isin(terrain, oracle.TRAVERSABLE_CLASSES), *pose[:2])
        seen = visible(terrain, pose)
        for action in done.actions[index, : done.steps[index]]:
            pose = oracle.moved(pose, int(action), shape)
            seen |= visible(terrain, pose)
        assert (component <= seen).all()
        assert not oracle.frontier_complete(seen, component).any()


@both_rules
def test_a_robot_never_drives_where_it_cannot(rules):
    terrains, starts = random_worlds((11, 33), 600)
    done = run(Frontier(RULES[rules]), terrains, starts)
    for index, pose in enumerate(starts):
        for action in done.actions[index, : done.steps[index]]:
            pose = oracle.moved(pose, int(action), terrains[index].shape)
            assert terrains[index][pose[1], pose[0]] in oracle.TRAVERSABLE_CLASSES


@complete_rules_first
def test_a_robot_gives_up_where_estimates_are_no_numbers(rules):
    terrains, starts = random_worlds((11, 33), 600)
    worlds = World.from_terrain(np.moveaxis(terrains, 0, -1))
    belief = gridworld.reset(worlds, make_pose(*np.array(starts).T), field_of_view(SENSING))
    for estimator, wanted in ((NoNumber(), GAVE_UP), (ExactCostToGo(), EXPLORE)):
        planner = DC2G(estimator, RULES[rules])
        plan, _ = jax.jit(planner.plan)(belief, planner.init(worlds))
        assert plan.mode.tolist() == [wanted] * EPISODES
    done = run(DC2G(NoNumber(), RULES[rules]), terrains, starts)
    assert done.mode.tolist() == [GAVE_UP] * EPISODES, (done.steps, done.actions[:, :9])
    assert done.steps.tolist() == [0] * EPISODES


def test_an_estimator_without_an_axis_of_outcomes_is_refused():
    @struct.dataclass
    class Flat(ExactCostToGo):
        def estimate(self, terrain, state):
            return super().estimate(terrain, state)[0]

    planner = DC2G(Flat(), RULES["complete"])
    with pytest.raises(InputError, match=r"Flat answers with \[11, 33\] for a map of \[11, 33\]; give \[outcomes"):
        planner.init(World.from_terrain(maps.random_terrain(0, (11, 33), 0.85)))


@pytest.mark.parametrize("kind", [EXPLORERS["dc2g"], EXPLORERS["learned"]])
def test_what_is_left_of_a_state_on_a_map_that_has_changed(kind):
    terrain = maps.random_terrain(600, (11, 33), 0.85, doors=0)
    planner = kind(RULES["complete"])
    pose = maps.random_pose(600, np.isin(terrain, oracle.TRAVERSABLE_CLASSES))
    belief = belief_from_map(terrain, make_pose(*pose))
    _, state = planner.plan(belief, planner.init(World.from_terrain(terrain)))
    nothing = jnp.zeros_like(belief.seen)
    state = state._replace(chosen_from=belief.seen)
    same, other = planner.revised(state, nothing), planner.revised(state, nothing.at[0, 4].set(1))
    jax.tree.map(np.testing.assert_array_equal, same, state)
    assert not other.reachable.any()
    assert not poses.unpack(other.subgoals, belief.width).any()
    assert int(jnp.sum(other.chosen_from != belief.seen)) == 1  # it is time for another choice
    frontier = Frontier(RULES["complete"])
    assert (frontier.revised(state.reachable, nothing) == state.reachable).all()
    assert not frontier.revised(state.reachable, nothing.at[0, 4].set(1)).any()
    known = Oracle().init(World.from_terrain(terrain))
    assert Oracle().revised(known, nothing) is known


def test_a_planner_that_knows_no_changes_says_so():
    class Fixed(Planner):
        pass

    refusal(lambda: Fixed().revised((), jnp.zeros((1, 1), jnp.uint32)), "planner Fixed", "no method revised")


def test_a_planner_is_shown_by_the_method_that_it_overrides(street):
    """A subclass with a plan of its own is run and shown by that, not by the assessment that it inherits."""

    @struct.dataclass
    class Stays(LowestColumn):
        def plan(self, belief, state):
            plan, state = super().plan(belief, state)
            return plan.replace(action=jnp.full_like(plan.action, 1)), state

    rules, pose = RULES["complete"], make_pose(8, 4, 2)
    world = World.from_terrain(street)
    belief = gridworld.reset(world, pose, rules.sensing)
    shown, own = (assess(kind(rules), belief, kind(rules).init(world), rules)[0] for kind in (LowestColumn, Stays))
    assert (int(own.plan.action), own.score) == (1, None)
    assert shown.score is not None


def test_nothing_is_estimated_on_the_way_to_a_goal(street):
    planner, world, pose = DC2G(Scattered(), RULES["complete"]), World.from_terrain(street), make_pose(8, 4, 0)
    before, state = planner.assess(gridworld.reset(world, pose, field_of_view(SENSING)), planner.init(world))
    seen = street.copy()
    seen[4:6, 0] = 0
    after, _ = planner.assess(belief_from_map(seen, pose), state)
    assert (before.plan.mode, after.plan.mode) == (EXPLORE, TO_GOAL)
    np.testing.assert_array_equal(after.cost_to_go, before.cost_to_go)


def test_oracle_gives_up_where_no_way_leads_to_a_goal(island):
    done = run(Oracle(), island[None], [(0, 0, 0)])
    assert (int(done.steps[0]), bool(done.success[0]), int(done.mode[0])) == (0, False, GAVE_UP)


# --- rules ------------------------------------------------------------------------------------------------


def test_named_settings():
    published, reference, paper = (SETTINGS[name] for name in ("published", "reference", "paper"))
    assert (published.rules().sensing, published.rules().expanding_range) == (field_of_view(5), 4)
    assert (reference.rules().sensing, reference.rules().expanding_range) == (field_of_view(8), 8)
    assert (paper.rules().sensing, paper.rules().expanding_range) == (field_of_view(8), None)
    assert published.rules(5) is published.rules()
    # Another range brings its own expanding range; one that names the latter alone keeps the sensing range.
    assert (published.rules(6).sensing, published.rules(6).expanding_range) == (field_of_view(6), 6)
    assert (published.rules(None, 3).sensing, published.rules(None, 3).expanding_range) == (field_of_view(5), 3)
    assert (reference.rules(5, 4).sensing, reference.rules(5, 4).expanding_range) == (field_of_view(5), 4)
    assert paper.rules(6) is complete_rules(6)
    refusal(lambda: paper.rules(6, 4), "expanding range 4", "'paper'", "leave expanding_range out")


NARROW = Settings("narrow", 3, None, lambda sensing_range, _: complete_rules(sensing_range))


def test_settings_with_another_field_of_view():
    for name, view in (("paper", field_of_view), ("occluded", line_of_sight)):
        wide = named_settings(name, 360)
        assert (wide.name, wide.field_of_view, SETTINGS[name].field_of_view) == (name, 360, 90)
        assert wide.rules(4).sensing == view(4, 360)
        assert wide.rules(4) is complete_rules(4, view, 360)
        assert named_settings(name, 90) == SETTINGS[name]
    for name in ("published", "reference", NARROW):
        assert named_settings(name, 90).rules() == named_settings(name).rules()
        refusal(lambda name=name: named_settings(name, 180), "field of view 180", "90 degrees only", "'occluded'")
    for bad in (0, 361, -90, float("nan"), float("inf"), True):
        refusal(lambda bad=bad: named_settings("paper", bad), "field of view", "from 1 to 360 degrees")
        refusal(lambda bad=bad: complete_rules(4, degrees=bad), "field of view", "from 1 to 360 degrees")
    own = Settings("own", 3, None, lambda reach, _, *, degrees: complete_rules(reach, degrees=degrees), 120)
    assert named_settings(own).rules() == complete_rules(3, degrees=120)
    assert named_settings(own, 45).rules(5) == complete_rules(5, degrees=45)


def test_settings_of_the_users_own_go_by_their_name():
    assert named_settings(f"{__name__}:NARROW") is NARROW
    assert named_settings("paper") is SETTINGS["paper"]
    refusal(lambda: named_settings("wide"), "'wide'", "give one of published, reference, paper, occluded", ":Name")
    refusal(lambda: named_settings(f"{__name__}:run"), ":run'", "give an instance of dc2g_jax.planning.Settings")


def test_equal_rules_are_one_value():
    assert reference_rules(5, 4) is reference_rules(5, 4)
    assert hash(Frontier(reference_rules(5, 4))) == hash(Frontier(reference_rules(5, 4)))
    assert EIGHT_CONNECTED[:4] == FOUR_CONNECTED
