"""Recordings hold what the replay says, and the replay says what the rollout did."""

import numpy as np
import pytest
import rerun as rr

from dc2g_jax.datasets.houses import House
from dc2g_jax.datasets.starts import Start
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.estimators import ExactCostToGo, world_cost_to_go
from dc2g_jax.evaluation import EpisodeResult, extra_steps, make_planner
from dc2g_jax.grid.poses import FORWARD, make_pose
from dc2g_jax.grid.terrain import CLASS_NAMES, TRAVERSABLE
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.inspection import recording
from dc2g_jax.inspection import replay as replaying
from dc2g_jax.inspection.recording import record_episode
from dc2g_jax.inspection.replay import actions_from_letters, replay, running_extra_steps
from dc2g_jax.planning.planners import EXPLORE, MODE_NAMES
from dc2g_jax.planning.rules import SETTINGS

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


# What `dc2g_jax.evaluation.Runner` found from that start, written down: running it takes longer than all the rest.
_ORACLE_STEPS = 28
_ACTIONS = {
    "frontier": "LLFFFFFFFFFFFFFFFFRFFFFLLLLFRFFF",
    "dc2g": "LLFFFFFFFFFFFFFFFFRFFFFFRFFF",
}


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
            world_from_terrain(_TERRAIN),
            make_pose(_START.x, _START.y, _START.heading),
            actions_from_letters(result.actions),
            planner=make_planner(name, _RULES, _ESTIMATOR),
            rules=_RULES,
        )
        for name, result in results.items()
    }


@pytest.fixture(scope="module")
def file(results, tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "new" / "toy.rrd"
    return record_episode(path, house=_HOUSE, result_by_planner=results, rules=_RULES, estimator=_ESTIMATOR)


def _read(path):
    """`(entity, component) -> {step, or None for static: values}`."""
    chunks = pytest.importorskip("rerun.chunk", reason="this rerun cannot read recordings chunk by chunk")
    table = {}
    for chunk in chunks.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        steps = batch["step"].to_pylist() if "step" in batch.schema.names else [None] * batch.num_rows
        for name in batch.schema.names:
            if ":" in name:
                values = zip(steps, batch[name].to_pylist(), strict=True)
                table.setdefault((chunk.entity_path, name), {}).update(values)
    return table


@pytest.fixture(scope="module")
def logged(file):
    return _read(file)


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
    exact = np.asarray(world_cost_to_go(world_from_terrain(_TERRAIN)))
    estimated = frames["dc2g"].cost_to_go
    np.testing.assert_array_equal(estimated, np.broadcast_to(exact, estimated.shape))


def test_extra_steps_never_fall_and_end_at_the_result(results, frames):
    for name, result in results.items():
        extra = running_extra_steps(frames[name])
        assert extra[0] == 0
        assert np.all(np.diff(extra) >= 0)
        assert extra[-1] == pytest.approx(result.extra)
    assert results["frontier"].extra > results["dc2g"].extra


def test_length_of_an_episode_changes_nothing_before_its_end():
    arguments = {"planner": make_planner("frontier", _RULES), "rules": _RULES}
    world, start = world_from_terrain(_TERRAIN), make_pose(*_START[1:4])
    actions = actions_from_letters("LFRRFL" * 12)
    compiled = replaying._replay_chunk._cache_size()
    long = replay(world, start, actions, **arguments)
    short = replay(world, start, actions[:5], **arguments)
    none = replay(world, start, actions[:0], **arguments)
    assert replaying._replay_chunk._cache_size() <= compiled + 1
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


def test_recorded_estimate_is_in_cells_on_seen_traversable_ground(logged, frames):
    found = frames["dc2g"]
    classes = _images(logged, "/dc2g/cost_to_go", found.terrain.shape)
    known = found.seen & TRAVERSABLE[_TERRAIN]
    ways = known & np.isfinite(found.cost_to_go)
    np.testing.assert_array_equal(classes[ways] - recording._FIRST_COST, np.rint(found.cost_to_go[ways]))
    assert np.all(classes[known & ~ways] == recording._NO_WAY)
    assert np.all(classes[~known] == recording._NOT_SHOWN)
    assert ("/frontier/cost_to_go", "SegmentationImage:buffer") not in logged


def test_recorded_plans_are_the_replay(logged, frames):
    for name, found in frames.items():
        shape = found.terrain.shape
        subgoals = _cells(logged, f"/{name}/plan/subgoals", shape)
        np.testing.assert_array_equal(subgoals, found.subgoals.any(axis=1))
        candidates = found.candidates.any(axis=1) & (found.mode == EXPLORE)[:, None, None]
        np.testing.assert_array_equal(_cells(logged, f"/{name}/plan/frontier_expanding", shape), candidates)
        words = [line[0] for line in logged[f"/{name}/mode", "TextLog:text"].values()]
        assert words[0] == f"{name}: {MODE_NAMES[EXPLORE]}"
        assert words[-1] == f"{name}: goal reached"
        assert len(words) == 3


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
        ways = logged[f"/{name}/robot/trajectory", "LineStrips2D:strips"]
        for step in steps:
            np.testing.assert_array_equal(ways[step][0][1:], centers[: step + 1])


def test_recorded_numbers_are_the_replay(logged, results, frames):
    for name, found in frames.items():
        extra = logged[f"/{name}/extra_steps", "Scalars:scalars"]
        assert sorted(extra) == list(range(len(found)))
        assert extra[len(found) - 1][0] == pytest.approx(results[name].extra)
        left = logged[f"/{name}/steps_to_goal", "Scalars:scalars"]
        np.testing.assert_array_equal([left[step][0] for step in range(len(found))], found.to_goal)
        status = logged[f"/{name}/status", "TextDocument:text"]
        assert status[len(found) - 1][0].startswith(f"**step {results[name].steps}** of {results[name].steps} · goal")


def test_what_is_hidden_and_the_legend_are_static(logged):
    pixels = logged["/hidden/map", "SegmentationImage:buffer"]
    np.testing.assert_array_equal(np.asarray(pixels[None][0], np.uint8).reshape(_TERRAIN.shape), _TERRAIN)
    assert list(logged["/hidden/cost_to_go", "SegmentationImage:buffer"]) == [None]
    legend = logged["/legend", "TextDocument:text"][None][0]
    assert "dark red: front_door (the goal)" in legend
    assert "mailbox" not in legend


def test_plans_of_another_planner_than_the_recorded_are_told(results, tmp_path):
    result = results["dc2g"]._replace(planner="frontier")
    path = record_episode(tmp_path / "x.rrd", house=_HOUSE, result_by_planner={"a / b": result}, rules=_RULES)
    words = [line for (_, name), lines in _read(path).items() if name == "TextLog:text" for line in lines.values()]
    assert ["a / b: plans shown are made anew, and 2 of their actions are not those taken"] in words


def test_file_has_a_layout_and_nothing_global_is_left(file):
    chunks = pytest.importorskip("rerun.chunk")
    reader = chunks.RrdReader(file)
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    assert rr.get_global_data_recording() is None


def test_costs_beyond_the_classes_share_them():
    exact = np.array([[0.0, 500.0, np.inf]])
    scale = recording._CostScale.of(exact)
    classes = scale.classes(np.array([[0.0, 1e6, np.inf, 3.0]]), np.array([[True, True, True, False]]))
    assert scale.cells == 3
    assert classes.tolist() == [[recording._FIRST_COST, 255, recording._NO_WAY, recording._NOT_SHOWN]]
    assert recording._CostScale.of(np.full((2, 2), np.inf)).cells == 1


def test_episodes_that_do_not_belong_together_are_refused(results, tmp_path):
    frontier = results["frontier"]

    def record(**changes):
        arguments = {"house": _HOUSE, "result_by_planner": {"frontier": frontier}, "rules": _RULES}
        record_episode(tmp_path / "never.rrd", **(arguments | changes))

    with pytest.raises(ValueError, match="at least one planner"):
        record(result_by_planner={})
    with pytest.raises(ValueError, match="an episode in toy, not in other"):
        record(house=House("other", "test", _TERRAIN))
    with pytest.raises(ValueError, match="b: another start"):
        record(result_by_planner={"a": frontier, "b": frontier._replace(x=2)})
    with pytest.raises(ValueError, match="sensing range 3 is not that of the rules, 8"):
        record(rules=SETTINGS["paper"].rules())
    with pytest.raises(ValueError, match="dc2g_uncertain need an estimator"):
        record(result_by_planner={"dc2g": results["dc2g"]})
    with pytest.raises(ValueError, match="do not end as the result says"):
        record(result_by_planner={"frontier": frontier._replace(actions=frontier.actions[:-1])})
    assert not (tmp_path / "never.rrd").exists()


def test_unwritable_path_is_named(results, tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "x.rrd", tmp_path):
        with pytest.raises(InputError, match=r"cannot be written"):
            record_episode(path, house=_HOUSE, result_by_planner={"frontier": results["frontier"]}, rules=_RULES)
