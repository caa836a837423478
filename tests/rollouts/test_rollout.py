"""Many episodes at once give what each gives alone, whatever the slots and the order."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from jax import Array

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid.poses import LEFT_ACTION, every_heading, make_pose
from dc2g_jax._src.grid.sensing import field_of_view
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.bounded import Bounded
from dc2g_jax._src.planning.planners import DC2G, EXPLORE, GAVE_UP, TO_GOAL, Frontier, Oracle, Plan, Planner, asks
from dc2g_jax._src.planning.rules import complete_rules, reference_rules
from dc2g_jax._src.planning.selection import QuantileCost
from dc2g_jax._src.rollouts import rollout as rollout_module
from dc2g_jax._src.rollouts.evaluation import episodes_from
from dc2g_jax._src.rollouts.results import action_letters
from dc2g_jax._src.rollouts.rollout import NO_ACTION, Trajectories, rollout
from dc2g_jax._src.runtime import devices
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps
from tests.support.compiling import compiled_count
from tests.support.exploration import random_worlds
from tests.support.networks import random_network
from tests.support.refusals import refusal

RULES = complete_rules(3)
SHAPE = (8, 10)
N_WORLDS, N_EPISODES = 6, 29


@pytest.fixture(scope="module")
def terrains(street, island) -> np.ndarray:
    return np.stack([street, island, *(maps.random_terrain(seed, SHAPE, 0.75) for seed in range(N_WORLDS - 2))])


def some_episodes(terrains: np.ndarray, seed: int, count: int = N_EPISODES):
    world = np.random.default_rng(seed).integers(len(terrains), size=count)
    poses = []
    for number, index in enumerate(world):
        ground = np.isin(terrains[index], oracle.TRAVERSABLE_CLASSES) & (terrains[index] != oracle.FRONT_DOOR)
        poses.append(maps.random_pose(1000 * seed + number, ground))
    return jnp.asarray(world, jnp.int32), make_pose(*np.array(poses).T)


def run(terrains, episodes, planner=None, **options) -> Trajectories:
    planner = Frontier(RULES) if planner is None else planner
    options = {"sensing": RULES.sensing, "step_limit": 60, "slots": N_EPISODES, **options}
    return rollout(planner, World.from_terrain(np.moveaxis(terrains, 0, -1)), *episodes, **options)


def assert_equal(one: Trajectories, other: Trajectories) -> None:
    for name in ("actions", "steps", "success", "mode"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_finished_robots_that_wait_for_others_change_nothing(terrains, monkeypatch):
    episodes = some_episodes(terrains, 3)
    at_once = run(terrains, episodes)
    monkeypatch.setattr(rollout_module, "platform", lambda mesh: "gpu")
    monkeypatch.setattr(rollout_module, "_REFILLED_TOGETHER", 0.4)
    assert_equal(run(terrains, episodes, slots=13), at_once)


@pytest.mark.parametrize("slots", [1, 3, 128])
def test_results_do_not_depend_on_the_number_of_slots(terrains, slots):
    world, start = some_episodes(terrains, 0)
    done = run(terrains, (world, start), slots=slots)
    for index in range(N_EPISODES):
        terrain = terrains[int(world[index])]
        pose = tuple(int(part[index]) for part in (start.x, start.y, start.heading))
        success, actions, mode = oracle.run_episode(
            terrain, pose, "frontier", rules="complete", sensing_radius=3, expanding_radius=3, max_steps=60
        )
        letters = "".join("FLR"[action] for action in done.actions[index, : done.steps[index]])
        assert (bool(done.success[index]), letters) == (success, actions)
        assert mode == ("explore", "to_goal", "gave_up")[done.mode[index]]
        assert (done.actions[index, done.steps[index] :] == NO_ACTION).all()


def test_results_do_not_depend_on_the_order(terrains):
    episodes = some_episodes(terrains, 1)
    order = np.random.default_rng(0).permutation(N_EPISODES)
    straight, shuffled = run(terrains, episodes), run(terrains, jax.tree.map(lambda leaf: leaf[order], episodes))
    assert_equal(shuffled, jax.tree.map(lambda leaf: leaf[order], straight))
    assert_equal(straight, run(terrains, episodes))


def test_types_of_the_results(terrains):
    done = run(terrains, some_episodes(terrains, 0))
    assert done.actions.shape == (N_EPISODES, 60)
    assert (done.actions.dtype, done.steps.dtype, done.success.dtype) == (np.int8, np.int32, bool)
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(done))
    assert set(np.unique(done.mode)) <= {EXPLORE, TO_GOAL, GAVE_UP}
    assert set(np.unique(done.actions)) == {-1, 0, 1, 2}


def test_worlds_that_are_not_stacked_along_the_last_axis_are_refused(terrains):
    for worlds in (World.from_terrain(terrains[0]), jax.vmap(World.from_terrain)(terrains)):
        shape = list(worlds.goals.shape)
        refusal(
            lambda worlds=worlds: rollout(Frontier(RULES), worlds, *some_episodes(terrains, 0), sensing=RULES.sensing),
            f"batch axes come last: goals of the stacked worlds are {shape}, expected [1, h, worlds]",
        )


def test_no_episodes(terrains):
    reports: list[int] = []
    done = run(terrains, episodes_from([], {}), on_progress=reports.append)
    assert done.actions.shape == (0, 60)
    assert done.actions.dtype == np.int8
    assert len(done.steps) == len(done.success) == len(done.mode) == 0
    one = run(terrains, some_episodes(terrains, 0), slots=3)
    for name in ("actions", "steps", "success", "mode"):
        assert getattr(done, name).dtype == getattr(one, name).dtype, name


def test_the_step_limit_ends_an_episode(terrains):
    episodes = some_episodes(terrains, 0)
    free = run(terrains, episodes)
    limited = run(terrains, episodes, step_limit=4)
    assert limited.actions.shape == (N_EPISODES, 4)
    np.testing.assert_array_equal(limited.actions, free.actions[:, :4])
    np.testing.assert_array_equal(limited.steps, np.minimum(free.steps, 4))
    np.testing.assert_array_equal(limited.success, free.success & (free.steps <= 4))
    assert (free.steps > 4).any()
    assert limited.success.any()


def test_progress_grows_and_ends_at_the_number_of_episodes(terrains, monkeypatch):
    monkeypatch.setattr(devices, "_SECONDS_PER_CALL", 0)
    reports: list[int] = []
    done = run(terrains, some_episodes(terrains, 2), slots=1, on_progress=reports.append)
    assert len(reports) > 3
    assert reports == sorted(reports)
    assert reports[-1] == N_EPISODES
    assert 0 <= reports[0] < N_EPISODES
    assert_equal(done, run(terrains, some_episodes(terrains, 2)))


def test_an_error_in_the_progress_report_ends_the_rollout(terrains):
    def fail(finished: int) -> None:
        raise RuntimeError(f"{finished} episodes are enough")

    with pytest.raises(RuntimeError, match="are enough"):
        run(terrains, some_episodes(terrains, 2), on_progress=fail)


def test_actions_are_kept_only_if_asked_for(terrains):
    episodes = some_episodes(terrains, 0)
    kept, dropped = run(terrains, episodes), run(terrains, episodes, keep_actions=False)
    assert dropped.actions.shape == (N_EPISODES, 0)
    for name in ("steps", "success", "mode"):
        np.testing.assert_array_equal(getattr(dropped, name), getattr(kept, name))


def compiled_programs() -> list[int]:
    return [compiled_count(program) for program in (rollout_module._first_states, rollout_module._run)]


def test_one_program_serves_all_episodes_of_the_same_shapes(terrains):
    run(terrains, some_episodes(terrains, 3))
    run(terrains, some_episodes(terrains, 3), Oracle())
    before = compiled_programs()
    run(terrains, some_episodes(terrains, 4))
    run(terrains[::-1], some_episodes(terrains[::-1], 5))
    run(terrains, some_episodes(terrains, 6), Frontier(complete_rules(3)), on_progress=lambda _: None)
    run(terrains, some_episodes(terrains, 6), Oracle())
    # Nor does the number of episodes matter, up to the next power of two.
    for count in (N_EPISODES - 1, N_EPISODES + 2):
        run(terrains, some_episodes(terrains, 8, count))
    assert compiled_programs() == before


def network_planner(seed: int) -> DC2G:
    network = random_network(Architecture(widths=(4,) * len(Architecture().widths)), seed)
    return DC2G(network, RULES, QuantileCost(0.7, 0.5))


def test_one_program_serves_all_weights_of_an_architecture(terrains):
    episodes = some_episodes(terrains, 7, count=5)

    def leads(seed: int) -> Trajectories:
        return run(terrains, episodes, network_planner(seed), slots=5)

    first = leads(0)
    before = compiled_programs()
    assert_equal(leads(0), first)
    leads(1)
    assert compiled_programs() == before


def test_a_network_leads_each_robot_as_if_it_were_alone(terrains):
    """Neither the slots nor the devices nor the company in the network's batches change a single action."""
    episodes, planner = some_episodes(terrains, 9), network_planner(0)
    together = run(terrains, episodes, planner, slots=32, devices=jax.devices()[:1])
    for options in ({"slots": 5}, {"slots": 17, "devices": jax.devices()[:2]}, {"slots": 1}):
        assert_equal(run(terrains, episodes, planner, **options), together)
    for number in range(0, N_EPISODES, 7):
        alone = run(terrains, jax.tree.map(lambda leaf, n=number: leaf[n : n + 1], episodes), planner)
        assert_equal(alone, jax.tree.map(lambda leaf, n=number: leaf[n : n + 1], together))


@pytest.mark.parametrize(
    "planner",
    [
        network_planner(0),
        pytest.param(Bounded(network_planner(0), RULES, factor=1.5, slack=0.5), marks=pytest.mark.slow),
        pytest.param(Bounded(Frontier(RULES), RULES, factor=2.0, slack=1.0), marks=pytest.mark.slow),
    ],
    ids=["DC2G", "bounded", "asks nothing"],
)
def test_robots_that_ask_together_do_what_they_do_side_by_side(terrains, monkeypatch, planner):
    assert asks(planner)
    episodes = some_episodes(terrains, 5)
    one_after_another = run(terrains, episodes, planner, slots=9)
    monkeypatch.setattr(rollout_module, "platform", lambda mesh: "gpu")
    assert_equal(run(terrains, episodes, planner, slots=11), one_after_another)


@struct.dataclass
class Turning(DC2G):
    """Turns to the left, whatever DC2G decides."""

    def plan(self, belief, state):
        plan, state = super().plan(belief, state)
        return dataclasses.replace(plan, action=jnp.full_like(plan.action, LEFT_ACTION)), state


def test_a_planner_with_a_plan_of_its_own_follows_it(terrains):
    inherited = network_planner(0)
    planner = Turning(inherited.estimator, RULES, inherited.selection)
    done = run(terrains, some_episodes(terrains, 6, count=3), planner, slots=3, step_limit=5)
    assert not asks(planner)
    assert (done.steps > 0).all()
    assert np.isin(done.actions, [LEFT_ACTION, NO_ACTION]).all()


@struct.dataclass
class Blind(Planner):
    """Takes these actions, whatever it sees."""

    actions: Array

    def init(self, world):
        return ()

    def plan(self, belief, state):
        action = self.actions[belief.steps]
        nowhere = every_heading(jnp.zeros_like(belief.seen))
        return Plan(action, jnp.full_like(action, EXPLORE), jnp.ones_like(action), nowhere), state


@pytest.mark.parametrize("slots", [1, 4])
def test_no_robot_drives_through_a_house(slots):
    street = np.stack([maps.drawn("RR#RDR"), maps.drawn("RRRRDR")])
    episodes = jnp.array([0, 1, 0, 0]), make_pose(np.array([0, 0, 3, 2]), *np.zeros((2, 4)))
    done = run(street, episodes, Blind(jnp.zeros(60, jnp.int32)), slots=slots)
    # Of those that start in the west, one has a house in its way. The last starts in the house, and may leave it.
    assert done.success.tolist() == [False, True, True, True]
    assert done.steps.tolist() == [60, 4, 1, 2]


@pytest.mark.parametrize("slots", [1, N_EPISODES])
def test_no_random_walk_beats_the_oracle(terrains, slots):
    arrived = 0
    for seed in range(20):
        episodes = some_episodes(terrains, seed)
        actions = np.random.default_rng(seed).choice([0, 0, 0, 1, 2], 60)
        best, done = (run(terrains, episodes, of, slots=slots) for of in (Oracle(), Blind(jnp.asarray(actions))))
        assert not (done.success & ~best.success).any()
        assert (done.steps >= best.steps)[done.success].all()
        arrived += done.success.sum()
    assert arrived > 20


def test_robots_see_what_the_rules_of_their_planner_say(terrains):
    episodes = some_episodes(terrains, 6, count=3)
    assert_equal(run(terrains, episodes, sensing=None), run(terrains, episodes, sensing=RULES.sensing))
    other = field_of_view(RULES.sensing.radius + 1)
    refusal(lambda: run(terrains, episodes, sensing=other), "planner 'Frontier'", "sensing_range")
    refusal(lambda: run(terrains, episodes, Oracle(), sensing=None), "planner 'Oracle'", "give sensing")


@pytest.mark.release
def test_rollouts_of_random_sizes_and_ranges_are_those_of_the_plain_program():
    """One robot a core, so that each rollout is one operation of the runtime."""
    for seed in range(300):
        rng = np.random.default_rng(seed)
        height, width = (int(2 ** rng.uniform(2, 7)) for _ in range(2))
        reach = int(rng.integers(2, 20))
        settings = ("complete", "reference")[seed % 2]
        rules = complete_rules(reach) if settings == "complete" else reference_rules(reach)
        terrains, starts = random_worlds((height, width), 10 * seed, episodes=3)
        episodes = jnp.arange(3), make_pose(*np.array(starts).T)
        done = run(terrains, episodes, Frontier(rules), sensing=rules.sensing, slots=None)
        for number, start in enumerate(starts):
            success, letters, _ = oracle.run_episode(
                terrains[number], start, "frontier", rules=settings, sensing_radius=reach, expanding_radius=reach,
                max_steps=60,
            )  # fmt: skip
            assert (action_letters(done, number), done.success[number]) == (letters, success), (seed, number)
        jax.clear_caches()
