"""The Gymnasium environments: registration, episodes, autoreset, pictures and refusals."""

import pickle
import subprocess
import sys
import textwrap

import jax
import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is absent")

from gymnasium.error import ResetNeeded  # noqa: E402
from gymnasium.utils.env_checker import check_env, data_equivalence  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.wrappers.vector import RecordEpisodeStatistics  # noqa: E402

from dc2g_jax._src.environments.functional import egocentric  # noqa: E402
from dc2g_jax._src.grid.terrain import FIGURE_RGB, FRONT_DOOR, OUTSIDE, ROAD  # noqa: E402
from dc2g_jax._src.readers.houses import House, HouseDataset  # noqa: E402
from dc2g_jax.gymnasium import GYMNASIUM_ID, EgocentricObservation, EgocentricVectorObservation  # noqa: E402
from dc2g_jax.gymnasium.environment import FrontDoorEnv, FrontDoorVectorEnv  # noqa: E402
from tests.oracles import numpy_gridworld as oracle  # noqa: E402
from tests.support.houses import DATASET, STREET, WALLED, YARD, house, save_dataset, start_poses  # noqa: E402
from tests.support.refusals import refusal  # noqa: E402

#: From the yard's road to its door in four steps.
TO_THE_DOOR = {"house": "yard", "x": 5, "y": 4, "heading": 3}
WAY = (0, 1, 0, 0, 2, 0, 0)
SMALL = {"dataset": DATASET, "sensing_range": 4, "step_limit": 25}


def make(**options):
    return gymnasium.make(GYMNASIUM_ID, **{**SMALL, **options})


def make_vec(robots, mode="vector_entry_point", **options):
    kwargs = {"vector_kwargs": {"autoreset_mode": AutoresetMode.SAME_STEP}} if mode == "sync" else {}
    return gymnasium.make_vec(GYMNASIUM_ID, num_envs=robots, vectorization_mode=mode, **kwargs, **{**SMALL, **options})


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux")
def test_processes_that_were_forked_end_with_one_line_where_jax_would_hang():
    script = textwrap.dedent("""
        import multiprocessing, sys
        from tests.gymnasium.test_gymnasium_env import make, make_vec
        make().reset()
        child = multiprocessing.get_context("fork").Process(target=make)
        child.start()
        child.join(60)
        sys.exit(child.exitcode)
    """)
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", script], capture_output=True, text=True, timeout=200)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: JAX hangs in forked processes; give make_vec vectorization_mode=")
    assert line.endswith("or vector_kwargs={'context': 'spawn'}")


@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
def test_gymnasium_s_own_check(render_mode):
    """Warnings are errors here."""
    check_env(make(render_mode=render_mode).unwrapped)


@pytest.mark.parametrize(
    ("imports", "name"),
    [
        ("import gymnasium", f"dc2g_jax.gymnasium:{GYMNASIUM_ID}"),
        ("import gymnasium, dc2g_jax.gymnasium", GYMNASIUM_ID),
        ("import dc2g_jax.gymnasium, gymnasium", GYMNASIUM_ID),
        ("import dc2g_jax.gymnasium, gymnasium", f"dc2g_jax.gymnasium:{GYMNASIUM_ID}"),
    ],
)
def test_registration_whichever_is_imported_first(imports, name):
    """Warnings, as of a second registration, are errors."""
    script = f"""
{imports}
spec = gymnasium.envs.registration._find_spec("{name}")
print(spec.entry_point, spec.vector_entry_point)
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=True)
    module = "dc2g_jax.gymnasium.environment"
    assert done.stdout == f"{module}:FrontDoorEnv {module}:FrontDoorVectorEnv\n"


@pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
def test_robots_side_by_side_by_the_name_with_its_module(mode):
    name = f"dc2g_jax.gymnasium:{GYMNASIUM_ID}"
    robots = gymnasium.make_vec(name, num_envs=2, vectorization_mode=mode, **SMALL)
    assert robots.reset(seed=0)[0]["pose"].shape == (2, 3)


def test_a_folder_of_houses_by_name(tmp_path):
    squares = np.kron(np.pad(STREET, ((0, 2), (0, 0)), mode="edge"), np.ones((3, 3), np.uint8))
    options = {"dataset": save_dataset([("street", "train", squares)], tmp_path / "houses"), "cells": 10}
    assert isinstance(make(**options).unwrapped, FrontDoorEnv)
    assert make_vec(3, **options).reset(seed=0)[0]["terrain"].shape == (3, 10, 10)


def test_an_episode_from_a_given_start_to_the_door():
    env = make()
    observation, info = env.reset(options=TO_THE_DOOR)
    pose, seen = (5, 4, 3), np.zeros(YARD.shape, bool)
    for number, action in enumerate((None, *WAY)):
        if action is not None:
            observation, reward, terminated, truncated, info = env.step(action)
            pose = oracle.moved(pose, action, YARD.shape)
            assert (reward, terminated, truncated) == (-1.0, number == len(WAY), False)
        seen |= oracle.visible(pose, 4, YARD.shape)
        assert tuple(observation["pose"]) == pose
        np.testing.assert_array_equal(observation["terrain"], np.where(seen, YARD, 0))
        assert observation in env.observation_space
        assert info == {"house": "yard"}
    assert YARD[pose[1], pose[0]] == oracle.FRONT_DOOR
    with pytest.raises(ResetNeeded):
        env.step(0)


def test_used_up_steps_truncate():
    env = make(step_limit=3)
    env.reset(options=TO_THE_DOOR)
    ends = [env.step(1)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_the_same_seed_gives_the_same_series_of_episodes():
    def series(seed) -> list[tuple]:
        env = make()
        firsts = [env.reset(seed=seed), *(env.reset() for _ in range(7))]
        return [(info["house"], *observation["pose"].tolist()) for observation, info in firsts]

    first = series(8)
    assert series(8) == first
    assert series(9) != first
    assert len(set(first)) > 1
    assert all(
        pose in start_poses({"street": STREET, "yard": YARD}[name]) for name, *rest in first for pose in [tuple(rest)]
    )
    assert len(set(map(tuple, [series(None)[0] for _ in range(8)]))) > 1


def test_only_houses_of_the_split_with_an_episode_in_them():
    assert {info["house"] for _, info in (make(split="val").reset(seed=seed) for seed in range(3))} == {"lane"}
    refusal(lambda: make(split="test"), "small", "its 0 test houses", "use another split")
    walled = HouseDataset("walls", "folder", (house("a", WALLED), house("b", WALLED)))
    refusal(lambda: make(dataset=walled), "walls: ", "its 2 train houses", "raise cells")


def test_vector_equals_single_environments_with_the_same_seeds_and_actions():
    robots = 6
    together, apart = make_vec(robots), make_vec(robots, "sync")
    for name in ("single_observation_space", "single_action_space", "observation_space", "action_space"):
        assert getattr(together, name) == getattr(apart, name)
    assert together.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    actions = np.random.default_rng(1).choice([0, 0, 1, 2], (120, robots))
    ended = {True: 0, False: 0}
    assert data_equivalence(together.reset(seed=11), apart.reset(seed=11), exact=True)
    for number, action in enumerate(actions):
        ours, theirs = together.step(action), apart.step(action)
        assert data_equivalence(ours, theirs, exact=True), number
        assert ours[0] in together.observation_space
        ended[True] += int(ours[2].sum())
        ended[False] += int(ours[3].sum())
    assert min(ended.values()) > 0
    # The series goes on, and a given start does not use it up.
    starts = {"house": "yard", "x": 5, "y": 4, "heading": 3}
    for options in (None, starts, None):
        assert data_equivalence(together.reset(options=options), apart.reset(options=options), exact=True)


def test_vector_starts_may_differ_and_the_last_observation_is_kept():
    envs = make_vec(2)
    starts = {"house": ["yard", "street"], "x": [5, 0], "y": 4, "heading": [3, 0]}
    observations, infos = envs.reset(seed=0, options=starts)
    assert observations["pose"].tolist() == [[5, 4, 3], [0, 4, 0]]
    assert infos["house"].tolist() == ["yard", "street"]
    for action in WAY:
        observations, rewards, terminated, truncated, infos = envs.step(np.array([action, 1]))
        assert rewards.tolist() == [-1, -1]
    assert (terminated.tolist(), truncated.tolist()) == ([True, False], [False, False])
    last = infos["final_obs"][0]
    assert last["pose"].tolist()[:2] == [3, 1]
    assert last["terrain"][1, 3] == oracle.FRONT_DOOR
    assert infos["final_obs"][1] is None
    assert infos["final_info"]["house"].tolist() == ["yard", None]
    assert infos["_final_obs"].tolist() == [True, False]
    # The observation is the first of the next episode.
    pose = tuple(observations["pose"][0].tolist())
    terrain = {"street": STREET, "yard": YARD}[infos["house"][0]]
    assert pose in start_poses(terrain)
    np.testing.assert_array_equal(
        observations["terrain"][0], np.where(oracle.visible(pose, 4, terrain.shape), terrain, 0)
    )


def test_what_was_returned_stays_as_it_was():
    envs = make_vec(3)
    before, _ = envs.reset(seed=2)
    kept = {name: values.copy() for name, values in before.items()}
    after, *_ = envs.step(np.array([1, 1, 1]))
    assert data_equivalence(before, kept, exact=True)
    after["terrain"][:] = 0


def test_a_wrapper_counts_the_episodes():
    envs = RecordEpisodeStatistics(make_vec(2, step_limit=5))
    envs.reset(seed=0)
    for _ in range(5):
        *_, infos = envs.step(np.array([1, 1]))
    assert infos["episode"]["l"].tolist() == [5, 5]
    assert infos["episode"]["r"].tolist() == [-5, -5]


def test_pictures_show_what_is_observed_and_the_robot():
    env = make(render_mode="rgb_array")
    observation, _ = env.reset(options=TO_THE_DOOR)
    picture = env.render()
    scale = 400 // max(YARD.shape)
    assert picture.shape == (YARD.shape[0] * scale, YARD.shape[1] * scale, 3)
    assert picture.dtype == np.uint8
    cells = picture.reshape(YARD.shape[0], scale, YARD.shape[1], scale, 3)
    for y, x in np.ndindex(YARD.shape):
        if (x, y) != (5, 4):
            assert np.all(cells[y, :, x] == FIGURE_RGB[observation["terrain"][y, x]])
    middle = cells[4, scale // 2, 5, scale // 2]
    assert tuple(middle) == (0, 0, 0)
    # The robot looks up: its color reaches further up in the middle column than at the sides, below only there.
    colored = np.all(cells[4, :, 5] == 0, axis=-1)
    assert colored[: scale // 4].sum() < colored[-scale // 2 :].sum()
    silent = make()
    silent.reset()
    assert silent.render() is None
    pictures = make_vec(2, render_mode="rgb_array")
    pictures.reset(options=TO_THE_DOOR)
    for one in pictures.render():
        np.testing.assert_array_equal(one, picture)


def test_pictures_of_large_maps_keep_cells_and_robot_visible():
    terrain = np.full((150, 200), ROAD, np.uint8)
    terrain[0, 0] = FRONT_DOOR
    env = make(dataset=HouseDataset("large", "folder", (House("large", "train", terrain),)), render_mode="rgb_array")
    env.reset(options={"house": "large", "x": 100, "y": 75, "heading": 0})
    picture = env.render()
    assert picture.shape == (4 * 150, 4 * 200, 3)
    robot = np.argwhere(np.all(picture == 0, axis=-1))
    # Its tip, nine pixels ahead of the middle of its cell, is less than a pixel wide.
    assert robot[:, 1].max() == 4 * 100 + 2 + 7
    assert FrontDoorEnv.metadata["render_fps"] == 10


def test_episodes_start_in_every_corner_of_a_map():
    terrain = np.full((8, 10), ROAD, np.uint8)
    terrain[4, 5] = oracle.FRONT_DOOR
    env = make(dataset=HouseDataset("square", "folder", (house("square", terrain),)))
    for x, y in ((0, 0), (9, 0), (0, 7), (9, 7)):
        observation, _ = env.reset(options={"house": "square", "x": x, "y": y, "heading": 0})
        assert observation["pose"].tolist() == [x, y, 0]


def test_egocentric_observations():
    """They are what a robot sees of its own episode: alone, among others, and in the last step."""
    env, envs = EgocentricObservation(make(), radius=3), EgocentricVectorObservation(make_vec(2), radius=3)
    assert env.observation_space == envs.single_observation_space
    assert env.observation_space.shape == (OUTSIDE + 1, 7, 7)
    views, views_of_both = [env.reset(options=TO_THE_DOOR)[0]], [envs.reset(options=TO_THE_DOOR)[0]]
    for action in WAY:
        views.append(env.step(action)[0])
        seen, *_, infos = envs.step(np.array([action, 1]))
        views_of_both.append(seen)
        if action != WAY[-1]:
            plain = jax.tree.map(lambda leaf: leaf[0], env.unwrapped._robots._observations)
            expected = egocentric(plain, 3)
            np.testing.assert_array_equal(views[-1].argmax(axis=0), expected)
    assert seen in envs.observation_space
    np.testing.assert_array_equal([both[0] for both in views_of_both[:-1]], views[:-1])
    np.testing.assert_array_equal(infos["final_obs"][0], views[-1])
    assert infos["final_obs"][1] is None
    views[-1][:] = 0  # the caller's own
    refusal(lambda: EgocentricObservation(make(), radius=0), "radius 0:", "at least 1")


@pytest.mark.parametrize(
    ("options", "mentions"),
    [
        ({"color": 3}, ["'color'", "give one of house, x, y, heading"]),
        ({"house": "yrad"}, ["yrad", "yard"]),
        ({"house": "lane"}, ["lane", "'val'", "split='val'"]),
        ({"house": "walled"}, ["house walled: ", "no front door can be reached"]),
        ({"x": 3, "y": 1}, ["house yard: column 3, row 1 is a goal already", "nearest cell to start from"]),
        ({"x": 0, "y": 0}, ["'grass'", "nearest cell to start from"]),
        ({"x": 10}, ["column 10", "off the map of 10 x 8 cells"]),
        ({"y": 2.5}, ["y 2.5:", "a whole number"]),
        ({"heading": True}, ["heading True:", "a whole number"]),
        ({"heading": -1}, ["no heading -1", "0 (right)"]),
    ],
    ids=str,
)
def test_refused_starts(options, mentions):
    refusal(lambda: make().unwrapped.reset(options={**TO_THE_DOOR, **options}), *mentions)


def test_refused_tables_of_starts():
    refusal(lambda: make().reset(options={"house": "yard", "x": 5, "y": 4}), "no 'heading'")
    refusal(lambda: make_vec(3).reset(options={**TO_THE_DOOR, "x": [5, 5]}), "'x' has 2 values", "one for each of 3")


@pytest.mark.parametrize(
    ("options", "mentions"),
    [
        ({"dataset": "/nowhere"}, ["/nowhere", "not a folder"]),
        ({"split": "training"}, ["'training'", "train, val, test"]),
        ({"sensing_range": 0}, ["sensing_range 0:"]),
        ({"sensing_range": -1}, ["sensing_range -1:"]),
        ({"field_of_view": 0}, ["field of view 0:", "from 1 to 360 degrees"]),
        ({"step_limit": 0}, ["step_limit 0:", "from 1 to 2147483647"]),
        ({"dataset": "procedural", "cells": -1}, ["cells -1:", "at least 1"]),
        ({"dataset": "procedural", "cells": 1}, ["no episode can be run", "raise cells"]),
        ({"render_mode": "human"}, ["'human'", "rgb_array or None"]),
    ],
    ids=str,
)
def test_refused_options(options, mentions):
    refusal(lambda: FrontDoorEnv(**{**SMALL, **options}), *mentions)


def test_refused_robots_and_actions():
    refusal(lambda: FrontDoorVectorEnv(0, **SMALL), "num_envs 0:")
    other = HouseDataset("two", "folder", (house("street", STREET), house("narrow", STREET[:, :9])))
    refusal(lambda: FrontDoorEnv(dataset=other), "street has 10 x 8", "narrow has 9 x 8")
    env = FrontDoorEnv(**SMALL)
    with pytest.raises(ResetNeeded):
        env.step(0)
    env.reset()
    refusal(lambda: env.step(3), "action is 3", "1 (turn left)")
    envs = FrontDoorVectorEnv(2, **SMALL)
    with pytest.raises(ResetNeeded):
        envs.step(np.array([0, 0]))
    envs.reset()
    refusal(lambda: envs.step(np.array([0, 1, 2])), "(3,)", "2 whole numbers")
    refusal(lambda: envs.step(np.array([0.0, 1.0])), "float64")
    refusal(lambda: envs.step(np.array([0, -1])), "action is -1")


def test_environments_can_be_pickled():
    for env, action in ((make(), 0), (make_vec(2), np.array([0, 1]))):
        env.reset(seed=3)
        copy = pickle.loads(pickle.dumps(env.unwrapped))
        assert data_equivalence(copy.step(action), env.unwrapped.step(action), exact=True)


def test_without_gymnasium_the_extra_is_named():
    script = textwrap.dedent("""
        import sys
        sys.modules["gymnasium"] = None
        import dc2g_jax.environments
        try:
            import dc2g_jax.gymnasium
        except dc2g_jax.InputError as error:
            print(error)
    """)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == 'gymnasium: not installed; run: pip install "dc2g_jax[gym]"\n'
