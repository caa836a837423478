"""What exploring costs: maps, rollouts and fit against plain NumPy."""

import dataclasses
import json
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import network_in_folder, save_network
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, OCCUPIED
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.planners import Frontier
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.training.score import START, ScoreConfig, Tried, fitted, searches_in, try_candidates, values
from dc2g_jax._src.training.train import train
from dc2g_jax.families.drawn import KINDS, draw_map
from tests.oracles import numpy_gridworld as oracle
from tests.support.exploration import SENSING
from tests.support.networks import random_network
from tests.support.refusals import refusal

RULES = complete_rules(SENSING)
WEIGHTS = np.linspace(-1, 1, len(TERMS)).astype(np.float32)
KEPT = TERMS.index("kept")


@pytest.mark.parametrize("kind", KINDS)
def test_a_map_is_one_piece_and_depends_on_its_seed(kind):
    free = draw_map(kind, (3, 1), 60)
    y, x = np.argwhere(free)[0]
    assert free.shape == (60, 60)
    assert (oracle.reachable(free, int(x), int(y)) == free).all()
    assert (draw_map(kind, (3, 1), 60) == free).all()
    assert (draw_map(kind, (3, 2), 60) != free).any()


def corridors(door=None):
    """Two maps of corridors around blocks, with a door in the same cell of each."""
    free = np.zeros((2, 20, 20), bool)
    free[0, [2, 9, 17]] = free[0, :, [4, 12]] = True
    free[1, 3:16, 3:17] = True
    free[1, 6:12, 6:14] = False
    maps = np.where(free, np.uint8(FREE), np.uint8(OCCUPIED))
    if door is not None:
        maps[:, door[1], door[0]] = FRONT_DOOR
    return list(maps)


@pytest.mark.parametrize("door", [None, (12, 15)])
def test_values_are_those_of_a_plain_rollout(door):
    searches = searches_in(corridors(door), 1, seed=0)
    found = values(Frontier(RULES), searches)
    x, y, headings = (np.asarray(part).ravel() for part in (searches.start.x, searches.start.y, searches.start.heading))
    for number, terrain in enumerate(corridors(door)):
        free, pose = terrain != OCCUPIED, (int(x[number]), int(y[number]), int(headings[number]))
        seen, steps = oracle.visible(pose, SENSING, free.shape), 0
        first = reached = oracle.reachable(free & seen, *pose[:2])
        when = np.where(first, 0, -1)
        while True:
            reached = oracle.reachable(free & seen, *pose[:2])
            when[reached & (when < 0)] = steps
            if door is not None and reached[door[::-1]]:
                goal = np.zeros((4, *free.shape), bool)
                goal[:, door[1], door[0]] = True
                to_go = len(oracle.shortest_actions(free & seen, pose, goal))
                assert found[number] == pytest.approx(np.log(steps + to_go), abs=1e-4)
                break
            wanted = oracle.frontier_expanding_complete(seen, reached, pose, SENSING)
            actions = oracle.shortest_actions(free & seen, pose, wanted)
            if actions is None:
                assert door is None
                assert (when[free] >= 0).all()
                assert found[number] == pytest.approx(np.log(when[free] + 6).mean(), abs=1e-4)
                break
            pose = oracle.driven(pose, actions[0], free)
            seen |= oracle.visible(pose, SENSING, free.shape)
            steps += 1


def test_a_fit_finds_the_weights_behind_values():
    rng = np.random.default_rng(0)
    terms, cost = rng.normal(size=(200, 6, len(TERMS))), rng.normal(size=(200, 6))
    hidden = np.where(np.arange(len(TERMS)) == KEPT, 0, rng.normal(size=len(TERMS)))
    own = rng.normal(size=(200, 1))
    plain = Tried(terms, 0 * cost, 0.01 * terms @ hidden + own, np.ones(200))
    houses = Tried(terms, cost, 0.03 * (cost + terms @ hidden) + own, np.ones(200))
    assert np.allclose(fitted([plain], [houses]), np.where(np.arange(len(TERMS)) == KEPT, -2, hidden), atol=1e-3)
    refusal(lambda: fitted([plain], [houses._replace(cost=-cost)]), "the network's cost-to-go does not tell", "train")


@pytest.mark.slow
def test_the_best_candidate_is_tried_first():
    network = random_network(Architecture(widths=(4, 8)))
    for maps, estimator in ((corridors() * 4, None), (corridors((12, 15)) * 4, network)):
        tried = try_candidates(LearnedScore(RULES, jnp.asarray(WEIGHTS), estimator), searches_in(maps, 1, seed=1))
        assert len(tried.value) > 2
        assert tried.terms.shape[1:] == (6, len(TERMS))
        assert ((tried.share > 0) & (tried.share <= 1)).all()
        assert (tried.terms[..., TERMS.index("actions")] > 0).all()  # no candidate is where the robot is
        score = tried.cost + tried.terms @ WEIGHTS
        assert (score[:, 0] <= score.min(axis=1) + 1e-3).all()


SMALL = ScoreConfig(rounds=1, maps=8, houses=4, starts=2, sides=(40,), field_of_view=120)


@pytest.mark.slow
def test_a_score_is_learned_resumed_and_used(tmp_path, capsys):
    out = tmp_path / "out"
    trained = train(out, "procedural", config=SMALL, split=None)
    assert trained.network.score.keys() == load_network(None).score.keys() | {"120"}
    learned = trained.network.score["120"]
    assert {*learned} == {*TERMS}
    assert "on fresh maps" in capsys.readouterr().out
    round_1 = json.loads((out / "round-1.json").read_text())
    assert round_1["weights"] == {term: pytest.approx(float(learned[term])) for term in TERMS}
    rules = complete_rules(8, degrees=120)
    planner = planner_with("dc2g", rules, network_in_folder(save_network(tmp_path / "copy", trained.network)))
    assert np.allclose(planner.weights, list(round_1["weights"].values()))
    before = (out / "round-1-1.npz").stat().st_mtime_ns
    train(out, "procedural", config=SMALL, split=None)
    assert (out / "round-1-1.npz").stat().st_mtime_ns == before
    other = dataclasses.replace(SMALL, maps=9)
    refusal(lambda: train(out, "procedural", config=other, split=None), "maps was 8", "another folder")


def test_what_makes_no_sense_is_refused(tmp_path):
    invalid: list[tuple[dict[str, Any], str]] = [({"rounds": 0}, "--rounds 0"), ({"sides": (8,)}, "--sides 8")]
    invalid += [({"sides": ()}, "sides is empty"), ({"seed": 2**31}, "--seed 2147483648")]
    invalid += [({"field_of_view": 400}, "--field-of-view 400")]
    for options, said in invalid:
        refusal(lambda: train(tmp_path / "out", "procedural", config=ScoreConfig(**options)), said, "give")  # noqa: B023
    refusal(lambda: train(tmp_path / "out", tmp_path / "none", config=SMALL), "none", "give")
    assert not (tmp_path / "out").exists()
    network = random_network(Architecture(widths=(4, 8)))
    folder = save_network(tmp_path / "net", network, {"score": {"90": {"gain": "much"}}})
    refusal(lambda: network_in_folder(folder), "network.json: weight of gain 'much'", "train the score anew")
    save_network(folder, network, {"score": {"90": {"gain": -1}}})
    refusal(lambda: planner_with("dc2g", RULES, network_in_folder(folder)), "has the terms gain", "--target steps")
    assert [START[term] for term in ("actions", "log_gain", "kept")] == [1.0, -10.0, -2.0]
