"""The score, the maps and the rollouts of the study of one score, against plain NumPy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid import bitboard, gridworld, poses
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import Frontier
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.rollouts.checks import check_planner
from experiments.studies.one_score.__main__ import START, Options, main
from experiments.studies.one_score.learn import Tried, fitted, maps_of, try_candidates, values
from experiments.studies.one_score.maps import KINDS, draw_map
from experiments.studies.one_score.planner import SIDE, TERMS, Scored
from tests.oracles import numpy_gridworld as oracle
from tests.support.exploration import SENSING, random_moment
from tests.support.networks import random_network
from tests.support.refusals import refusal

RULES = complete_rules(SENSING)
WEIGHTS = np.linspace(-1, 1, len(TERMS)).astype(np.float32) / 8
SHAPE = (19, 27)


@pytest.mark.parametrize("kind", KINDS)
def test_a_map_is_one_piece_and_depends_on_its_seed(kind):
    free = draw_map(kind, (3, 1), 60)
    y, x = np.argwhere(free)[0]
    assert free.shape == (60, 60)
    assert (oracle.reachable(free, int(x), int(y)) == free).all()
    assert (draw_map(kind, (3, 1), 60) == free).all()
    assert (draw_map(kind, (3, 2), 60) != free).any()


def share(cells, x, y, radius, per):
    """Cells of a set within a square, clipped to the map, per something."""
    return cells[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1].sum() / per


def terms_of(terrain, seen, pose, there, distance, kept):
    """The terms of a pose on a map without an estimate."""
    x, y, heading = there
    traversable = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
    reached = oracle.reachable(traversable, *pose[:2])
    new = (~seen & oracle.visible(there, SENSING, seen.shape)).sum()
    ahead = oracle.STEPS[heading]
    actions = distance[heading, y, x]
    across, down = x - pose[0], y - pose[1]
    robot = oracle.STEPS[pose[2]]
    middle = (x + 6 * ahead[0], y + 6 * ahead[1])
    return [
        actions, np.log(actions + 1), new / len(oracle.sensing_offsets(SENSING, 0)), np.log(new), 0.0, kept == there,
        *(share(~seen, x, y, radius, (2 * radius + 1) ** 2) for radius in (8, 16, 32)),
        share(traversable, *middle, 4, 81) if min(middle) > -5 else 0.0,
        share(oracle.frontier_complete(seen, reached), x, y, 3, 7),
        across * robot[0] + down * robot[1], actions / (abs(across) + abs(down) + 4),
    ]  # fmt: skip


@functools.cache
def chooser():
    """Chooses from a map, what was seen, a pose and the last choice."""
    planner = Scored(RULES, jnp.asarray(WEIGHTS))

    @jax.jit
    def choose(terrain, seen, pose, kept):
        belief = gridworld.belief_of(World.from_terrain(terrain), pose, jnp.int32(0), bitboard.pack(seen))
        state = planner.init(World.from_terrain(terrain))._replace(subgoal=kept)
        _, (_, reachable, revealing) = planner.look(belief, state)
        return planner.choose((belief, reachable, revealing), state, planner.ask)

    return choose


@pytest.mark.parametrize("seed", range(6))
def test_candidates_and_terms_equal_the_oracle(seed):
    terrain, seen, pose = random_moment(seed, SHAPE, 0.8)
    traversable = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
    reached = oracle.reachable(traversable, *pose[:2])
    revealing = oracle.frontier_expanding_complete(seen, reached, pose, SENSING)
    distance = oracle.distances_from(traversable, pose)
    kept = tuple(np.argwhere(revealing)[0][[2, 1, 0]].tolist()) if revealing.any() else (0, 0, 0)
    chosen = chooser()(terrain, seen, make_pose(*pose), poses.only(make_pose(*kept), 1, SHAPE[0]))
    across = -(-SHAPE[1] // SIDE)
    own = {}
    for heading, y, x in np.argwhere(revealing).tolist():
        terms = terms_of(terrain, seen, pose, (x, y, heading), distance, kept)
        own.setdefault(y // SIDE * across + x // SIDE, []).append(((x, y, heading), np.array(terms, float)))
    assert np.flatnonzero(np.asarray(chosen.present)).tolist() == sorted(own)
    scores = []
    for square, found in own.items():
        least = min(terms[:6] @ WEIGHTS[:6] for _, terms in found)
        among = [terms for _, terms in found if terms[:6] @ WEIGHTS[:6] < least + 1e-4]
        terms = np.asarray(chosen.terms)[:, square]
        assert any(np.allclose(terms, other, atol=1e-4) for other in among)
        scores.append((terms @ WEIGHTS, square))
    if own:
        least = min(scores)[0]
        subgoal = np.argwhere(np.asarray(poses.unpack(chosen.subgoal, SHAPE[1])))
        assert len(subgoal) == 1
        _, y, x = subgoal[0]
        assert {square: score for score, square in scores}[y // SIDE * across + x // SIDE] < least + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("network", [None, random_network(Architecture(widths=(4, 8)))])
def test_it_keeps_the_protocol_of_planners(network):
    weights = jnp.asarray([START.get(term, 0.0) for term in TERMS], jnp.float32)
    check_planner(Scored(RULES, weights, network))


def corridors():
    """Two maps of corridors around blocks."""
    free = np.zeros((2, 20, 20), bool)
    free[0, [2, 9, 17]] = free[0, :, [4, 12]] = True
    free[1, 3:16, 3:17] = True
    free[1, 6:12, 6:14] = False
    return list(free)


def test_values_are_those_of_a_plain_rollout():
    maps = maps_of(corridors(), ["a", "b"], seed=0)
    found = values(Frontier(RULES), maps)
    rng = np.random.default_rng(0)
    cells = [np.argwhere(free) for free in corridors()]
    starts = [own[rng.integers(len(own))][::-1].tolist() for own in cells]
    headings = rng.integers(4, size=2).tolist()
    for free, (x, y), heading, value in zip(corridors(), starts, headings, found, strict=True):
        pose, seen = (x, y, heading), oracle.visible((x, y, heading), SENSING, free.shape)
        when, steps = np.full(free.shape, -1), 0
        while True:
            reached = oracle.reachable(free & seen, *pose[:2])
            when[reached & (when < 0)] = steps
            wanted = oracle.frontier_expanding_complete(seen, reached, pose, SENSING)
            actions = oracle.shortest_actions(free & seen, pose, wanted)
            if actions is None:
                break
            pose = oracle.driven(pose, actions[0], free)
            seen |= oracle.visible(pose, SENSING, free.shape)
            steps += 1
        first = oracle.reachable(free & oracle.visible((x, y, heading), SENSING, free.shape), x, y)
        later = free & (when >= 0)
        assert later.sum() == free.sum()
        # Cells of the first look count with no actions.
        assert value == pytest.approx(np.log(when[later] + 6).sum() / free.sum(), abs=1e-4), first.sum()


def test_a_fit_finds_the_weights_behind_values():
    rng = np.random.default_rng(0)
    terms = rng.normal(size=(200, 6, len(TERMS)))
    hidden = np.where(np.isin(TERMS, ("cost", "kept")), 0, rng.normal(size=len(TERMS)))
    part = Tried(terms, terms @ hidden + rng.normal(size=(200, 1)), np.ones(200))
    before = np.full(len(TERMS), 7.0)
    found = fitted([part], before)
    assert np.allclose(found, np.where(np.isin(TERMS, ("cost", "kept")), 7.0, hidden), atol=1e-4)


def test_options_and_files_that_make_no_sense_are_refused(tmp_path):
    other = tmp_path / "other.npz"
    np.savez(other, names=np.array(["a/b"]))
    text = tmp_path / "text.npz"
    text.write_text("maps")
    out = tmp_path / "out"
    for file in (tmp_path / "none.npz", other, text):
        refusal(lambda: main(Options(out=out, foreign=file)), file.name, "give --foreign")  # noqa: B023
    refusal(lambda: main(Options(out=out, sides=(50, 8))), "--sides 8", "give")
    refusal(lambda: main(Options(out=out, rounds=0)), "--rounds 0", "give")
    assert not out.exists()


@pytest.mark.slow
def test_the_best_candidate_comes_first_and_the_command_reports(tmp_path, capsys):
    scored = Scored(RULES, jnp.asarray(WEIGHTS))
    tried = try_candidates(scored, maps_of(corridors() * 4, ["a"] * 8, seed=1))
    assert tried.terms.shape[1:] == (6, len(TERMS))
    assert ((tried.share > 0) & (tried.share < 1)).all()
    score = tried.terms @ WEIGHTS
    assert (score[:, 0] <= score.min(axis=1) + 1e-3).all()
    main(Options(out=tmp_path / "out", rounds=1, maps=1, judged=1, sides=(50,)))
    assert "Round 1: " in capsys.readouterr().out
    assert (tmp_path / "out" / "weights.json").exists()
    assert "all, 50 cells" in (tmp_path / "out" / "table.md").read_text()
