"""Recordings hold what the replay says, and the replay says what the rollout did."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rerun as rr
from flax import struct

from dc2g_jax._src.estimation.estimators import ExactCostToGo, world_cost_to_go
from dc2g_jax._src.figures import replay as replaying
from dc2g_jax._src.figures.replay import actions_from_letters, replay, replay_result, running_extra_steps
from dc2g_jax._src.figures.results_figures import PLANNER_STYLES
from dc2g_jax._src.grid.poses import FORWARD, make_pose
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, GRASS, ROAD, TRAVERSABLE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore, weights_of
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.planners import DC2G, EXPLORE, MODE_NAMES
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.rollouts.statistics import extra_steps
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.viewer import legend
from dc2g_jax._src.viewer.recording import record_episode
from tests.oracles import numpy_gridworld as oracle
from tests.oracles.learned_score_oracle import Chooser
from tests.support import toy
from tests.support.compiling import compiled_count
from tests.support.exploration import LowestColumn, PlanAlone
from tests.support.recordings import read

_LETTERS = {"r": "road", "g": "grass", "d": "driveway", "F": "front_door", "h": "house"}
_MAP = """
rrrrrrrrrrrrrrrrrrrr
rrrrrrrrrrrrrrrrrrrr
gggggggdgggggggggdgg
gggggggdgggggggggdgg
gggggggdgggggggggdgg
gggggggggghhhhhggdgg
gggggggggghhhhFddddg
gggggggggghhhhhggggg
"""
_TERRAIN = np.array([[CLASS_NAMES.index(_LETTERS[letter]) for letter in line] for line in _MAP.split()], dtype=np.uint8)
_HOUSE = House("toy", "test", _TERRAIN)
_START = Start("toy", 1, 1, 2)
_RULES = SETTINGS["paper"].make_rules(3, None)
_ESTIMATOR = ExactCostToGo()


# What `rollouts.evaluation.Runner` found from that start, written down: running it takes longer than all the
# rest.
_ORACLE_STEPS = 28
_ACTIONS = {"frontier": "LLFFFFFFFFFFFFFFFFRFFFFLLLLFRFFF", "true_cost_to_go": "LLFFFFFFFFFFFFFFFFRFFFFFRFFF"}


def _result(planner, actions):
    return EpisodeResult(
        *_START[:4],
        range=3,
        expanding_range=None,
        planner=planner,
        success=True,
        steps=len(actions),
        oracle_steps=_ORACLE_STEPS,
        extra=extra_steps(len(actions), _ORACLE_STEPS),
        mode="to_goal",
        actions=actions,
    )


@pytest.fixture(scope="module")
def results():
    return {planner: _result(planner, actions) for planner, actions in _ACTIONS.items()}


@pytest.fixture(scope="module")
def frames(results):
    return {
        name: replay(
            World.from_terrain(_TERRAIN),
            make_pose(_START.x, _START.y, _START.heading),
            actions_from_letters(result.actions),
            planner=planner_with(name, _RULES, _ESTIMATOR),
            rules=_RULES,
        )
        for name, result in results.items()
    }


def record(path, results, house=_HOUSE, rules=_RULES):
    frames = {planner: replay_result(result, house, rules, _ESTIMATOR) for planner, result in results.items()}
    return record_episode(path, house=house, result_by_planner=results, frames_by_planner=frames)


@pytest.fixture(scope="module")
def file(results, tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "new" / "toy.rrd"
    return record(path, results)


@pytest.fixture(scope="module")
def logged(file):
    return read(file)


def _images(logged, entity, shape):
    pixels = logged[entity, "SegmentationImage:buffer"]
    assert sorted(pixels) == list(range(shape[0]))
    return np.array([np.asarray(pixels[step][0], np.uint8) for step in range(shape[0])]).reshape(shape)


def _cells(logged, entity, shape):
    cells = np.zeros(shape, bool)
    for step, centers in logged[entity, "Points2D:positions"].items():
        for x, y in centers:
            cells[step, int(y - 0.5), int(x - 0.5)] = True
    return cells


def test_planners_have_the_colors_of_figures(logged, results):
    for name in results:
        red, green, blue = (int(PLANNER_STYLES[name].color[place : place + 2], 16) for place in (1, 3, 5))
        (color,) = logged[f"/{name}/extra_steps", "SeriesLines:colors"][None]
        assert color == red << 24 | green << 16 | blue << 8 | 255


def test_replay_decides_what_was_done(results, frames):
    for name, result in results.items():
        assert len(frames[name]) == result.steps + 1
        assert frames[name].to_goal[0] == _ORACLE_STEPS
        np.testing.assert_array_equal(frames[name].action[:-1], actions_from_letters(result.actions))


def test_replay_moves_as_the_actions_say(results, frames):
    for name, result in results.items():
        x, y, heading = _START.x, _START.y, _START.heading
        height, width = _TERRAIN.shape
        for step, letter in enumerate(result.actions + "F"):
            pose = frames[name].pose
            assert (pose.x[step], pose.y[step], pose.heading[step]) == (x, y, heading)
            if letter == "F":
                x = min(max(x + FORWARD[heading][0], 0), width - 1)
                y = min(max(y + FORWARD[heading][1], 0), height - 1)
            heading = (heading + {"F": 0, "L": -1, "R": 1}[letter]) % 4


def test_frames_fit_together(frames):
    for found in frames.values():
        n_frames = len(found)
        assert found.terrain.shape == found.seen.shape == (n_frames, *_TERRAIN.shape)
        assert found.candidates.shape == found.subgoals.shape == (n_frames, 4, *_TERRAIN.shape)
        assert found.terrain.dtype == np.uint8
        np.testing.assert_array_equal(found.terrain, np.where(found.seen, _TERRAIN, 0))
        np.testing.assert_array_equal(found.seen, np.logical_or.accumulate(found.field_of_view))
        assert not np.any(found.reachable & ~(found.seen & TRAVERSABLE[_TERRAIN]))
        assert not np.any(found.candidates & ~found.reachable[:, None])
        exploring = found.mode == EXPLORE
        assert np.any(exploring)
        assert not np.all(exploring)
        assert not np.any(found.subgoals[exploring] & ~found.candidates[exploring])
        assert np.all(found.subgoals.any(axis=(1, 2, 3)))


def test_estimates_are_those_of_the_planner(frames):
    assert frames["frontier"].cost_to_go is None
    exact = np.asarray(world_cost_to_go(World.from_terrain(_TERRAIN)))
    estimated = frames["true_cost_to_go"].cost_to_go
    np.testing.assert_array_equal(estimated, np.broadcast_to(exact, estimated.shape))


def test_frontier_candidates_and_plans_are_those_of_the_plain_oracle(frames):
    exact = np.asarray(world_cost_to_go(World.from_terrain(_TERRAIN)))
    for name, found in frames.items():
        for step in range(len(found)):
            pose = tuple(int(part[step]) for part in (found.pose.x, found.pose.y, found.pose.heading))
            free = found.seen[step] & TRAVERSABLE[_TERRAIN]
            reached = oracle.reachable(free, *pose[:2])
            np.testing.assert_array_equal(found.frontier[step], oracle.frontier_complete(found.seen[step], reached))

            path = [tuple(part) for part in found.path[step].tolist()]
            plan = oracle.shortest_actions(free, pose, found.subgoals[step])
            passed = [pose]
            for action in plan:
                passed.append(oracle.moved(passed[-1], action, _TERRAIN.shape))
            assert path == passed
            assert len(plan) == found.length[step]

            if found.mode[step] != EXPLORE:
                assert np.all(np.isnan(found.score[step]))
                continue
            poses = found.candidates[step]
            cells = poses.any(axis=0)
            nearest = np.where(poses, oracle.distances_from(free, pose), 10**6).min(axis=0)
            score = exact if name == "true_cost_to_go" else nearest
            np.testing.assert_array_equal(found.score[step], np.where(cells, score, np.nan))
            assert np.all(found.score[step][found.subgoals[step].any(axis=0)] == score[cells].min())


@struct.dataclass
class _Slope:
    """Two outcomes, `x + seen cells` and `x + 3`: something that mirroring the map changes."""

    def init(self, world):
        return ()

    def estimate(self, terrain, state):
        x = jnp.arange(terrain.shape[1], dtype=jnp.float32).reshape(1, -1, *(1 for _ in terrain.shape[2:]))
        nothing = jnp.zeros(terrain.shape, jnp.float32)
        return jnp.stack([x + nothing + jnp.sum(terrain > 0, axis=(0, 1)), x + nothing + 3])


def test_scores_are_those_the_planner_goes_by():
    """The map and its mirror image are asked about in turn, and scores are those of the last choice."""
    weights = dict(zip(TERMS, np.random.default_rng(0).normal(size=len(TERMS)).round(2).tolist(), strict=True))
    planner = LearnedScore(_RULES, weights_of({"90": weights}), _Slope())
    actions = actions_from_letters("LLFFFFFLRFFFFFFFFFFFFF")
    world = World.from_terrain(_TERRAIN)
    found = replay(world, make_pose(*_START[1:4]), actions, planner=planner, rules=_RULES)

    def estimate(observed):
        return np.indices(observed.shape)[1] + ((observed != 0).sum() + 3) / 2

    chooser = Chooser(weights, 3, estimate)
    for step in range(len(found)):
        pose = tuple(int(part[step]) for part in (found.pose.x, found.pose.y, found.pose.heading))
        mode, plan = chooser.plan(found.terrain[step], pose)
        assert (MODE_NAMES[found.mode[step]], found.action[step], found.length[step]) == (mode, plan[0], len(plan))
        np.testing.assert_allclose(found.cost_to_go[step], chooser.cost(found.terrain[step]), atol=1e-4)
        score = np.full(_TERRAIN.shape, np.nan)
        for each in chooser.candidates:
            if found.candidates[step][each.pose[::-1]]:  # it still reveals something
                score[each.pose[1::-1]] = each.score
        np.testing.assert_allclose(found.score[step], score, atol=1e-3)
        assert np.argwhere(found.subgoals[step]).tolist() == [list(chooser.subgoal[::-1])]
    assert 3 < chooser.choices < len(found)


def test_estimates_stand_once_the_planner_no_longer_explores():
    world, planner = World.from_terrain(_TERRAIN), DC2G(_Slope(), _RULES)
    actions = actions_from_letters(_ACTIONS["true_cost_to_go"])
    found = replay(world, make_pose(*_START[1:4]), actions, planner=planner, rules=_RULES)
    last = np.flatnonzero(found.mode == EXPLORE)[-1]
    assert np.any(found.seen[last + 1 :] != found.seen[last])
    for cost_to_go in found.cost_to_go[last + 1 :]:
        np.testing.assert_array_equal(cost_to_go, found.cost_to_go[last])
    at_the_door = replay(world, make_pose(16, 6, 2), actions_from_letters("FF"), planner=planner, rules=_RULES)
    assert at_the_door.cost_to_go is None


def test_a_planner_of_ones_own_is_shown_with_its_own_scores(results, frames):
    wanted, result = frames["frontier"], results["frontier"]
    world, start, actions = World.from_terrain(_TERRAIN), make_pose(*_START[1:4]), actions_from_letters(result.actions)
    alone = replay(world, start, actions, planner=PlanAlone(_RULES), rules=_RULES)
    jax.tree.map(np.testing.assert_array_equal, alone, wanted)
    lowest = replay(world, start, actions, planner=LowestColumn(_RULES), rules=_RULES)
    columns = np.broadcast_to(np.arange(_TERRAIN.shape[1]), lowest.score.shape)
    np.testing.assert_array_equal(lowest.score, np.where(np.isnan(wanted.score), np.nan, columns))


def test_plans_of_the_oracle_lead_over_ground_that_nobody_has_seen(results):
    start = make_pose(*_START[1:4])
    found = replay(
        World.from_terrain(_TERRAIN), start, np.zeros(0, np.int8), planner=planner_with("oracle", _RULES), rules=_RULES
    )
    goals = np.stack([_TERRAIN == FRONT_DOOR] * 4)
    plan = oracle.shortest_actions(TRAVERSABLE[_TERRAIN], tuple(_START[1:4]), goals)
    assert len(found.path[0]) == len(plan) + 1 == _ORACLE_STEPS + 1
    assert tuple(found.path[0][-1][:2]) == (14, 6)
    assert found.subgoals[0].sum() == 1
    assert np.all(np.isnan(found.score))


def test_a_planner_that_gives_up_has_no_path(tmp_path):
    terrain = np.full_like(_TERRAIN, GRASS)
    terrain[1, 1], terrain[6, 14] = ROAD, FRONT_DOOR  # one cell to stand on, and a look around it
    result = EpisodeResult("closed", 1, 1, 2, 3, None, "frontier", False, 3, None, None, "gave_up", "LLL")
    house = House("closed", "test", terrain)
    found = replay_result(result, house, _RULES)
    assert [MODE_NAMES[mode] for mode in found.mode] == ["explore"] * 3 + ["gave_up"]
    assert [len(path) for path in found.path] == [2, 2, 2, 0]
    assert np.all(np.isnan(found.score[3]))
    logged = read(record(tmp_path / "x.rrd", {"a": result}, house))
    assert logged["/a/status", "TextDocument:text"][3] == ["**step 3** of 3 · gave up"]
    assert logged["/a/mode", "TextLog:text"][3] == ["a: gave up"]
    assert logged["/hidden/about", "TextDocument:text"][None][0].endswith("no door can be reached")
    assert not any(logged["/a/plan/subgoals", "Points2D:positions"][3])
    assert ("/a/extra_steps", "Scalars:scalars") not in logged


def test_an_episode_without_exploration_is_recorded(tmp_path):
    start, letters = (17, 6, 2), "FFF"
    result = EpisodeResult("toy", *start, 3, None, "frontier", True, 3, 3, 0.0, "to_goal", letters)
    logged = read(record(tmp_path / "x.rrd", {"a": result}))
    assert not any(logged["/a/plan/candidates", "Points2D:positions"].values())
    assert logged["/a/plan/path", "LineStrips2D:strips"][0] == [[[x + 0.5, 6.5] for x in (17, 16, 15, 14)]]
    assert [status[0] for status in logged["/a/status", "TextDocument:text"].values()] == [
        "**step 0** of 3 · +0 % extra · to goal: door in 3",
        "**step 1** of 3 · +0 % extra · to goal: door in 2",
        "**step 2** of 3 · +0 % extra · to goal: door in 1",
        "**step 3** of 3 · +0 % extra · at the goal",
    ]


def test_extra_steps_never_fall_and_end_at_the_result(results, frames):
    for name, result in results.items():
        extra = running_extra_steps(frames[name])
        assert extra[0] == 0
        assert np.all(np.diff(extra) >= 0)
        assert extra[-1] == pytest.approx(result.extra)
    assert results["frontier"].extra > results["true_cost_to_go"].extra


def test_length_of_an_episode_changes_nothing_before_its_end():
    arguments = {"planner": planner_with("frontier", _RULES), "rules": _RULES}
    world, start = World.from_terrain(_TERRAIN), make_pose(*_START[1:4])
    actions = actions_from_letters("LFRRFL" * 12)
    compiled = compiled_count(replaying._replay_chunk)
    long = replay(world, start, actions, **arguments)
    short = replay(world, start, actions[:5], **arguments)
    none = replay(world, start, actions[:0], **arguments)
    assert compiled_count(replaying._replay_chunk) <= compiled + 1
    assert (len(long), len(short), len(none)) == (73, 6, 1)
    for name in ("terrain", "reachable", "candidates", "subgoals", "mode", "length", "to_goal"):
        np.testing.assert_array_equal(getattr(long, name)[:6], getattr(short, name))
        np.testing.assert_array_equal(getattr(long, name)[:1], getattr(none, name))


def test_unknown_letters_are_refused():
    with pytest.raises(ValueError, match="substring not found"):
        actions_from_letters("FXL")


def test_recorded_images_are_the_replay(logged, frames):
    for name, found in frames.items():
        shape = found.terrain.shape
        np.testing.assert_array_equal(_images(logged, f"/{name}/map", shape), found.terrain)
        np.testing.assert_array_equal(_images(logged, f"/{name}/map/reachable", shape), found.reachable)
        np.testing.assert_array_equal(_images(logged, f"/{name}/map/field_of_view", shape), found.field_of_view)
        np.testing.assert_array_equal(_images(logged, f"/{name}/map/frontier", shape), found.frontier)


def test_recorded_estimate_is_in_cells_on_seen_traversable_ground(logged, frames):
    found = frames["true_cost_to_go"]
    classes = _images(logged, "/true_cost_to_go/cost_to_go", found.terrain.shape)
    known = found.seen & TRAVERSABLE[_TERRAIN]
    ways = known & np.isfinite(found.cost_to_go)
    np.testing.assert_array_equal(classes[ways] - legend.FIRST_COST, np.rint(found.cost_to_go[ways]))
    assert np.all(classes[known & ~ways] == legend.NO_WAY)
    assert np.all(classes[~known] == legend.NOT_SHOWN)
    assert ("/frontier/cost_to_go", "SegmentationImage:buffer") not in logged


def test_recorded_plans_are_the_replay(logged, frames):
    for name, found in frames.items():
        shape = found.terrain.shape
        subgoals = _cells(logged, f"/{name}/plan/subgoals", shape)
        np.testing.assert_array_equal(subgoals, found.subgoals.any(axis=1))
        candidates = found.candidates.any(axis=1) & (found.mode == EXPLORE)[:, None, None]
        np.testing.assert_array_equal(_cells(logged, f"/{name}/plan/frontier_expanding", shape), candidates)
        lines = logged[f"/{name}/plan/path", "LineStrips2D:strips"]
        for step, path in enumerate(found.path):
            cells = [tuple(cell) for cell in path[:, :2].tolist()]
            cells = [cell for cell, before in zip(cells, [None, *cells], strict=False) if cell != before]
            drawn = [[(x - 0.5, y - 0.5) for x, y in line] for line in lines[step]]
            assert drawn == ([cells] if len(cells) > 1 else [])
        words = [line[0] for line in logged[f"/{name}/mode", "TextLog:text"].values()]
        assert words[0] == f"{name}: {MODE_NAMES[EXPLORE]}"
        assert words[-1] == f"{name}: at the goal"
        assert len(words) == 3


def test_recorded_candidates_have_the_scores_of_the_replay(logged, frames):
    for name, found in frames.items():
        entity = f"/{name}/plan/candidates"
        scores, places = logged[entity, "score"], logged[entity, "Points2D:positions"]
        colors = logged[entity, "Points2D:colors"]
        for step in range(len(found)):
            drawn = np.full(_TERRAIN.shape, np.nan, np.float32)
            for score, (x, y) in zip(scores[step], places[step], strict=True):
                drawn[int(y - 0.5), int(x - 0.5)] = score
            np.testing.assert_array_equal(drawn, found.score[step])
            brightest = [score for score, color in zip(scores[step], colors[step], strict=True) if color == 2**32 - 1]
            assert set(brightest) == {min(scores[step])} if scores[step] else not brightest


def test_recorded_robot_is_the_replay(logged, frames):
    for name, found in frames.items():
        centers = np.stack([found.pose.x, found.pose.y], axis=-1) + 0.5
        steps = range(len(found))
        positions = logged[f"/{name}/robot", "Points2D:positions"]
        np.testing.assert_array_equal([positions[step][0] for step in steps], centers)
        arrows = logged[f"/{name}/robot/heading", "Arrows2D:vectors"]
        np.testing.assert_array_equal(
            np.sign([arrows[step][0] for step in steps]), np.asarray(FORWARD)[found.pose.heading]
        )
        # A piece of the way at each step that moves the robot: together they are the way, and none is sent twice.
        pieces = logged[f"/{name}/robot/path", "LineStrips2D:strips"]
        moving = [step for step in steps if step and np.any(centers[step] != centers[step - 1])]
        assert sorted(pieces) == moving
        for step, strips in pieces.items():
            np.testing.assert_array_equal(strips, [centers[step - 1 : step + 1]])


def test_recorded_numbers_are_the_replay(logged, results, frames):
    for name, found in frames.items():
        extra = logged[f"/{name}/extra_steps", "Scalars:scalars"]
        assert sorted(extra) == list(range(len(found)))
        assert extra[len(found) - 1][0] == pytest.approx(results[name].extra)
        left = logged[f"/{name}/steps_to_goal", "Scalars:scalars"]
        np.testing.assert_array_equal([left[step][0] for step in range(len(found))], found.to_goal)
        status = logged[f"/{name}/status", "TextDocument:text"]
        last = f"**step {results[name].steps}** of {results[name].steps}"
        assert status[len(found) - 1][0] == f"{last} · {results[name].extra:+.0f} % extra · at the goal"
        least = np.nanmin(found.score[0])
        count = np.sum(~np.isnan(found.score[0]))
        first = f"explore: subgoal in {found.length[0]}, score {least:.1f}, best of {count}"
        assert status[0][0] == f"**step 0** of {results[name].steps} · +0 % extra · {first}"


def test_what_is_hidden_and_the_legend_are_static(logged):
    pixels = logged["/hidden/map", "SegmentationImage:buffer"]
    np.testing.assert_array_equal(np.asarray(pixels[None][0], np.uint8).reshape(_TERRAIN.shape), _TERRAIN)
    assert list(logged["/hidden/cost_to_go", "SegmentationImage:buffer"]) == [None]
    legend = logged["/legend", "TextDocument:text"][None][0]
    assert "orange-red: front door" in legend
    assert logged["/hidden/about", "TextDocument:text"][None][0].startswith("**toy** from (1, 1) facing west")
    assert "mailbox" not in legend


def test_plans_of_another_planner_than_the_recorded_are_told(results, tmp_path):
    result = results["true_cost_to_go"]._replace(planner="frontier")
    path = record(tmp_path / "x.rrd", {"a / b": result})
    words = [line for (_, name), lines in read(path).items() if name == "TextLog:text" for line in lines.values()]
    assert ["a / b: plans shown are made anew, and 2 of their actions are not those taken"] in words


def test_file_has_a_layout_and_nothing_global_is_left(file):
    chunks = pytest.importorskip("rerun.chunk")
    reader = chunks.RrdReader(file)
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    assert rr.get_global_data_recording() is None


def test_costs_beyond_the_classes_share_them():
    exact = np.array([[0.0, 500.0, np.inf]])
    scale = legend.CostScale.of(exact)
    classes = scale.classes(np.array([[0.0, 1e6, np.inf, 3.0]]), np.array([[True, True, True, False]]))
    assert scale.step == 3
    assert classes.tolist() == [[legend.FIRST_COST, 255, legend.NO_WAY, legend.NOT_SHOWN]]
    assert legend.CostScale.of(np.full((2, 2), np.inf)).step == 1


def test_costs_that_are_not_in_cells_have_classes_of_their_own():
    classes = legend.RELATIVE.classes(np.array([[0.0, 0.25, 1.0]]), np.ones((1, 3), bool))[0]
    assert classes.tolist() == [legend.FIRST_COST, legend.FIRST_COST + 63, legend.LAST_COST]
    assert legend.RELATIVE.words.format(0.5) == "50% of the highest cost"


def test_episodes_that_do_not_belong_together_are_refused(results, tmp_path):
    frontier, path = results["frontier"], tmp_path / "never.rrd"
    with pytest.raises(ValueError, match="at least one planner"):
        record(path, {})
    with pytest.raises(ValueError, match="an episode in toy, not in other"):
        record(path, {"frontier": frontier}, House("other", "test", _TERRAIN))
    another = {"a": frontier, "b": frontier._replace(x=2)}
    frames = dict.fromkeys(another, toy.replayed()["frontier"])
    with pytest.raises(ValueError, match="b: another start"):
        record_episode(path, house=_HOUSE, result_by_planner=another, frames_by_planner=frames)
    assert not path.exists()


def test_results_of_other_episodes_are_not_replayed(results):
    frontier = results["frontier"]
    with pytest.raises(ValueError, match="sensing range 3 is not that of the rules, 8"):
        replay_result(frontier, _HOUSE, SETTINGS["paper"].rules())
    with pytest.raises(ValueError, match="'dc2g' needs an estimator"):
        replay_result(frontier._replace(planner="dc2g"), _HOUSE, _RULES)
    with pytest.raises(ValueError, match="do not end as the result says"):
        replay_result(frontier._replace(actions=frontier.actions[:-1]), _HOUSE, _RULES)


def test_unwritable_path_is_named(results, tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "x.rrd", tmp_path):
        with pytest.raises(InputError, match=r"cannot be written"):
            record(path, {"frontier": results["frontier"]})


def test_where_nothing_is_predicted_the_recording_says_so(tmp_path):
    label = "dc2g"
    frames = dataclasses.replace(
        toy.replayed()[label], cost_to_go=np.zeros(toy.replayed()[label].seen.shape, np.float32)
    )
    path = record_episode(
        tmp_path / "none.rrd", house=toy.HOUSE, result_by_planner={label: toy.RESULTS[label]},
        frames_by_planner={label: frames},
    )  # fmt: skip
    classes = _images(read(path), "/dc2g/cost_to_go", frames.seen.shape)
    known = frames.seen & TRAVERSABLE[toy.HOUSE.terrain]
    np.testing.assert_array_equal(classes, np.where(known, legend.NO_PREDICTION, legend.NOT_SHOWN))
    assert "no prediction" in legend.episode_legend(toy.HOUSE.terrain, legend.RELATIVE)
