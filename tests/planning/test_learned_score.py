"""The planner of a learned score against plain NumPy, and what it promises."""

import dataclasses
import functools
import json
import shutil
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import WHOLE_MAP
from dc2g_jax._src.grid import bitboard, gridworld, poses
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.streets import in_town
from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, GRASS, OCCUPIED, ROAD
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore, weights_of
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, MODE_NAMES
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.rollouts.results import action_letters
from dc2g_jax._src.rollouts.rollout import rollout
from tests.oracles import learned_score_oracle, numpy_gridworld as oracle
from tests.oracles.learned_score_oracle import WAY, Chooser, Unclear
from tests.support.exploration import SENSING, STEP_LIMIT, NoNumber, Scattered, belief_of, random_moment, random_worlds
from tests.support.networks import random_network
from tests.support.refusals import refusal

RULES = complete_rules(SENSING)
SHAPE = (19, 27)
MOMENTS = 24


def random_weights(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=len(TERMS)).astype(np.float32)


def named(weights: np.ndarray) -> dict[str, float]:
    return dict(zip(TERMS, weights.tolist(), strict=True))


def scattered(observed: np.ndarray) -> np.ndarray:
    return np.asarray(Scattered().estimate(observed, ()))[0]


@struct.dataclass
class OfClasses(Scattered):
    """One that predicts nothing from free and occupied cells, like a network."""

    needs_classes: ClassVar[bool] = True


#: Estimators, and what each says of a map in plain NumPy.
ESTIMATORS = {"none": (None, None), "scattered": (OfClasses(), scattered)}

with_and_without = pytest.mark.parametrize("estimator", ESTIMATORS)


@functools.cache
def moments():
    """Random maps in which something is left to reveal: classes, cells seen, pose, and a pose that was chosen last."""
    found = []
    for seed in range(MOMENTS):
        terrain, seen, pose = random_moment(seed, SHAPE, 0.8)
        terrain = np.where(terrain == FRONT_DOOR, ROAD, terrain).astype(np.uint8)
        revealing = revealing_poses(np.where(seen, terrain, 0), pose)
        if revealing.any():
            heading, y, x = np.random.default_rng(seed).choice(np.argwhere(revealing)).tolist()
            found.append((terrain, seen, pose, (x, y, heading)))
    assert len(found) > MOMENTS / 2
    return found


def revealing_poses(observed, pose):
    reached = oracle.reachable(np.isin(observed, oracle.TRAVERSABLE_CLASSES), *pose[:2])
    return oracle.frontier_expanding_complete(observed != 0, reached, pose, SENSING)


@functools.partial(jax.jit, static_argnames="shape")
def decided(planner, terrain, seen, pose, kept, *, shape):
    """A decision, its candidates, and the poses of both; poses are `[3 *batch]`."""
    pose, kept = make_pose(*pose), make_pose(*kept)
    belief = gridworld.belief_of(World.from_terrain(terrain), pose, jnp.zeros_like(pose.x), bitboard.pack(seen))
    state = planner.init(World.from_terrain(terrain))._replace(subgoals=poses.only(kept, *belief.seen.shape[:2]))
    assessment, state = planner.assess(belief, state)
    sets = (poses.unpack(these, shape[1]) for these in (assessment.candidates, assessment.plan.subgoals))
    return assessment, state.candidates, *sets


@with_and_without
def test_candidates_terms_and_choice_equal_plain_numpy_alone_and_in_a_batch(estimator):
    """The score is cost, way and penalty, and the subgoal has the lowest."""
    estimator, estimate = ESTIMATORS[estimator]
    weights = random_weights(1)
    planner = LearnedScore(RULES, jnp.asarray(weights), estimator, replan_fraction=0.0)
    terrain, seen, pose, kept = (np.stack(part, axis=-1) for part in zip(*moments(), strict=True))
    together = decided(planner, terrain, seen, pose, kept, shape=SHAPE)
    clear = 0
    for number, moment in enumerate(moments()):
        mine = jax.tree.map(lambda leaf, number=number: leaf[..., number], together)
        if number < 4:
            alone = decided(planner, *moment[:2], *map(np.array, moment[2:]), shape=SHAPE)
            jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-4), alone, mine)
        try:
            check_decision(*mine, *moment, named(weights), estimate)
            clear += 1
        except Unclear:
            pass
    assert clear > len(moments()) - 3


def check_decision(assessment, found, candidates, subgoals, terrain, seen, pose, kept, weights, estimate):
    observed = np.where(seen, terrain, 0).astype(np.uint8)
    asked = estimate is not None and not np.isin(observed, learned_score_oracle.PLAIN_CLASSES).all()
    cost = estimate(observed) if asked else np.zeros(SHAPE)
    wanted = learned_score_oracle.candidates(
        observed, pose, revealing_poses(observed, pose), kept, cost, weights, SENSING
    )
    squares = [x // 8 + y // 8 * -(-SHAPE[1] // 8) for (x, y, _), *_ in wanted]
    assert np.flatnonzero(found.present).tolist() == squares
    assert {(x, y, heading) for heading, y, x in np.argwhere(candidates).tolist()} == {one.pose for one in wanted}
    for square, one in zip(squares, wanted, strict=True):
        close = functools.partial(pytest.approx, rel=1e-4, abs=1e-3)
        assert tuple(part[square] for part in (found.pose.x, found.pose.y, found.pose.heading)) == one.pose
        np.testing.assert_allclose(found.terms[:, square], [one.terms[term] for term in TERMS], atol=1e-4)
        cell = one.pose[1::-1]
        assert assessment.score[cell] == close(one.score) == found.score[square]
        if estimate is not None:
            way = sum(weights[term] * one.terms[term] for term in WAY)
            assert assessment.cost_to_go[cell] == close(one.cost) == found.cost[square]
            assert assessment.score[cell] - assessment.cost_to_go[cell] - assessment.penalty[cell] == close(way)
    if estimate is None:
        assert assessment.cost_to_go is assessment.penalty is None
    best = learned_score_oracle.lowest((one.score, one.pose) for one in wanted)
    assert np.argwhere(subgoals).tolist() == [list(best[::-1])]
    assert int(assessment.plan.mode) == EXPLORE


def without_classes(terrain):
    traversable = np.isin(terrain, oracle.TRAVERSABLE_CLASSES) & (terrain != FRONT_DOOR)
    return np.where(traversable, FREE, np.where(terrain == FRONT_DOOR, terrain, OCCUPIED)).astype(np.uint8)


@with_and_without
def test_episodes_equal_those_of_plain_numpy(estimator):
    """The map and its mirror image are asked about in turn, and the mean of the last two answers counts.

    In half of the maps, one half has no classes, so nothing is asked about it alone.
    """
    estimator, estimate = ESTIMATORS[estimator]
    terrains, starts = random_worlds((11, 33), 2000, episodes=20)
    terrains[::2, :, :16] = without_classes(terrains[::2, :, :16])
    worlds = World.from_terrain(np.moveaxis(terrains, 0, -1))
    weights = random_weights(2)
    done = rollout(
        LearnedScore(RULES, jnp.asarray(weights), estimator), worlds, jnp.arange(len(starts)),
        make_pose(*np.array(starts).T), sensing=RULES.sensing, step_limit=STEP_LIMIT, slots=4,
    )  # fmt: skip

    def compared(estimate):
        """Whether each episode whose choices are clear is that of the oracle."""
        same = []
        for number, (terrain, start) in enumerate(zip(terrains, starts, strict=True)):
            try:
                wanted = learned_score_oracle.run_episode(
                    terrain, start, Chooser(named(weights), SENSING, estimate), STEP_LIMIT
                )
            except Unclear:
                continue
            found = bool(done.success[number]), action_letters(done, number), MODE_NAMES[done.mode[number]]
            same.append(found == wanted)
        assert len(same) > len(starts) / 2
        return same

    assert all(compared(estimate))
    if estimate is not None:
        assert not all(compared(lambda observed: estimate(observed[:, ::-1])[:, ::-1]))


def test_an_estimator_is_not_asked_about_maps_without_classes():
    terrain, seen, pose, _ = moments()[0]
    terrain = without_classes(terrain)
    planner, without = (LearnedScore(RULES, jnp.asarray(random_weights(3)), one) for one in (OfClasses(), None))
    state = planner.init(World.from_terrain(terrain))
    belief = belief_of(terrain, seen, pose)
    asked, (due, *_) = planner.look(belief, state)
    assert (bool(asked), bool(due)) == (False, True)
    assessment, state = planner.assess(belief, state)
    np.testing.assert_array_equal(assessment.cost_to_go, 0)
    other, _ = without.assess(belief, without.init(World.from_terrain(terrain)))
    jax.tree.map(np.testing.assert_array_equal, assessment.plan, other.plan)
    np.testing.assert_allclose(assessment.score, other.score, rtol=1e-5)
    everywhere = dataclasses.replace(planner, estimator=Scattered())  # one that does not need classes
    assert bool(everywhere.look(belief, state._replace(chosen_from=0 * belief.seen))[0])


def test_it_gives_up_where_estimates_are_no_numbers():
    terrain, seen, pose, _ = moments()[0]
    belief, world = belief_of(terrain, seen, pose), World.from_terrain(terrain)
    for estimator, mode in ((NoNumber(), GAVE_UP), (Scattered(), EXPLORE)):
        planner = LearnedScore(RULES, jnp.asarray(random_weights(4)), estimator)
        assert int(planner.plan(belief, planner.init(world))[0].mode) == mode


def test_in_towns_larger_than_its_network_the_surroundings_are_asked_about():
    # Roads of width 2, 20 cells apart, so that every robot is in a town.
    terrain = np.full((60, 60), GRASS, np.uint8)
    terrain[::20] = terrain[1::20] = terrain[:, ::20] = terrain[:, 1::20] = ROAD
    belief = gridworld.belief_from_map(terrain, make_pose(20, 20, 0))
    assert in_town(belief)
    for side in (40, 60):
        planner = LearnedScore(RULES, jnp.zeros(len(TERMS)), random_network(Architecture(widths=(4, 4), side=side)))
        prior = 40 if side == 40 else 0
        np.testing.assert_array_equal(planner.init(World.from_terrain(terrain)).estimates, prior)
        if side == 60:
            assert planner._extent(belief) is WHOLE_MAP
            continue
        state = planner.init(World.from_terrain(terrain))
        answer = planner._extent(belief).merged(planner.ask(belief, state), belief.pose, state.estimates[0])
        inside = np.asarray(answer)[0] != prior
        assert inside[:40, :40].all()
        assert not inside[40:].any()
        assert not inside[:, 40:].any()


def test_weights_of_other_terms_are_refused():
    score = named(random_weights(6))
    for other in (score | {"color": 1.0}, {term: score[term] for term in TERMS[1:]}):
        refusal(lambda other=other: weights_of({"90": other}), ", ".join(TERMS), "train the score anew")


def test_weights_are_those_of_the_nearest_field_of_view():
    narrow, wide = named(random_weights(6)), named(random_weights(7))
    score = {"90": dict(reversed(narrow.items())), "360": wide}
    for degrees, seed in ((None, 6), (1, 6), (90, 6), (180, 6), (181, 7), (360, 7)):
        np.testing.assert_array_equal(weights_of(score, degrees), random_weights(seed))
    np.testing.assert_array_equal(weights_of({"90": narrow}, 360), random_weights(6))


@pytest.mark.parametrize(
    ("score", "words"),
    [
        ([1.0], "is [1.0], not weights by degrees"),
        ({}, "is {}, not weights by degrees"),
        ({"actions": 1.0}, "not weights by degrees"),
        ({"wide": {}}, "field of view of the score 'wide'"),
        ({"90": {"actions": "high"}}, "weight of actions 'high'"),
        ({"90": {"gain": True}}, "weight of gain True"),
    ],
)
def test_a_network_whose_score_has_no_numbers_is_refused(score, words, compact_network, tmp_path):
    shutil.copytree(compact_network, tmp_path / "network")
    card = tmp_path / "network" / "network.json"
    card.write_text(json.dumps(json.loads(card.read_text()) | {"score": score}))
    refusal(lambda: network_in_folder(card.parent), "network.json", words, "train the score anew")
