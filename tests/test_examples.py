"""The examples run, and do what they say."""

import csv
import importlib.util
import itertools
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.rivals.recurrent_policy import read_policy
from tests.support.refusals import refusal

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
CURVE = ["curve.csv", "curve.png", "curve.svg", "curve.pdf"]
PLANNERS = ["untrained", "PPO", "frontier", "oracle"]


def example(name: str):
    """An example as a module."""
    specification = importlib.util.spec_from_file_location(f"{name}_example", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    # A dataclass looks its module up by name.
    sys.modules[module.__name__] = module
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def ppo():
    return example("ppo")


def table(path: Path) -> dict[str, tuple[float, float]]:
    with path.open(newline="") as file:
        return {row["planner"]: (float(row["steps"]), float(row["success"])) for row in csv.DictReader(file)}


@pytest.mark.slow
def test_ppo_sets_what_it_learned_beside_the_others(ppo, tmp_path, capsys):
    out = tmp_path / "run"
    options = ppo.Options(
        steps=800, maps=12, robots=16, steps_per_update=16, passes=2, batches=2, step_limit=40, val_maps=2, out=out
    )
    ppo.main(options)
    rows = table(out / "table.csv")
    assert list(rows) == PLANNERS
    *_, untrained, policy, frontier, oracle, kept = capsys.readouterr().out.splitlines()
    assert str(out) in kept
    printed = [untrained, policy, frontier, oracle]
    assert [line.split()[0] for line in printed] == PLANNERS
    for line, (steps, success) in zip(printed, rows.values(), strict=True):
        assert line.split()[1:] == [f"{steps:.1f}", f"{success:.1%}"]
        assert 0 < steps <= 40
        assert 0 <= success <= 1
    # Nobody beats the oracle.
    assert all(rows["oracle"][0] <= steps and rows["oracle"][1] >= success for steps, success in rows.values())
    refusal(lambda: ppo.main(options), out, "give --out a new folder")
    assert {path.name for path in out.iterdir()} == {"table.csv", "policy.safetensors", *CURVE}
    curve = np.loadtxt(out / "curve.csv", delimiter=",", skiprows=1)
    assert curve[:, 0].tolist() == [256, 512, 768]
    # By the end of 40 steps every robot has ended an episode, and not before.
    assert np.isnan(curve[:2, 1:]).all()
    assert 0 < curve[2, 1] <= 40
    assert 0 <= curve[2, 2] <= 1
    # The policy that was saved is not the first one.
    saved, first = (read_policy(out / "policy.safetensors"), ppo.PPO(options, None, None, None).first_weights["policy"])
    changes = jax.tree.map(lambda one, other: float(jnp.abs(one - other).max()), saved, first)
    assert max(jax.tree.leaves(changes)) > 1e-3


def test_ppo_learns_from_decisions_until_the_next_or_the_end(ppo):
    rng = np.random.default_rng(0)
    steps, robots = 24, 5
    decided, done = rng.random((2, steps, robots)) < [[[0.2]], [[0.1]]]
    reward = rng.normal(size=(steps, robots)).astype(np.float32)
    number = np.arange(steps * robots).reshape(steps, robots)
    noted = ppo.Decided((), number, (), np.stack([number, -number], axis=1), number)
    lived = ppo.Step(decided, noted, number, reward, done, done)
    decision, before, found, ended, valid = ppo.decisions(jax.tree.map(jnp.asarray, lived))
    assert before.shape == (robots, 8)
    assert decision.hidden.shape == (robots, 8, 2)
    for robot in range(robots):
        when = np.flatnonzero(decided[:, robot])[:8]
        assert valid[robot].tolist() == [True] * (len(when) - 1) + [False] * (9 - len(when))
        for place, (start, end) in enumerate(itertools.pairwise(when)):
            assert before[robot, place] == decision.block[robot, place] == -decision.hidden[robot, place, 1]
            assert before[robot, place] == number[start, robot]
            np.testing.assert_allclose(found[robot, place], reward[start:end, robot].sum(), rtol=1e-4, atol=1e-5)
            assert ended[robot, place] == done[start:end, robot].any()


def test_ppo_s_advantages_against_their_definition(ppo):
    """The sum of the surprises to come, each counted less, up to the end of the episode or of what is known."""
    rng = np.random.default_rng(0)
    robots, count = 3, 12
    reward, value = rng.normal(size=(2, robots, count)).astype(np.float32)
    done = rng.random((robots, count)) < 0.25
    valid = np.arange(count) < np.array([[11], [7], [0]])
    expected = np.zeros((robots, count))
    for robot, place in zip(*np.nonzero(valid), strict=True):
        weight = 1.0
        for later in range(place, count):
            if not valid[robot, later] or not weight:
                break
            following = 0 if done[robot, later] else value[robot, later + 1]
            expected[robot, place] += weight * (reward[robot, later] + following - value[robot, later])
            weight *= 0 if done[robot, later] else ppo.GAE_DECAY
    found = ppo.advantages(*map(jnp.asarray, (reward, value, done, valid)))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_ppo_refuses_bad_options_before_it_learns(ppo, tmp_path):
    refusal(lambda: ppo.main(ppo.Options(robots=0)), "--robots is 0", "at least 1")
    refusal(lambda: ppo.main(ppo.Options(batches=3)), "--batches is 3", "divisor of --robots 64")
    refusal(lambda: ppo.main(ppo.Options(seed=-1)), "--seed is -1")
    refusal(lambda: ppo.main(ppo.Options(out=tmp_path / "no" / "run")), "no/run", "folder")
    refusal(lambda: ppo.main(ppo.Options(out=tmp_path)), tmp_path, "new folder")


@pytest.mark.release
def test_ppo_learns(ppo, tmp_path):
    """In maps never seen it needs far fewer steps than untrained, after some minutes on two cores."""
    out = tmp_path / "run"
    ppo.main(ppo.Options(steps=200_000, maps=200, val_maps=8, out=out))
    rows = table(out / "table.csv")
    assert rows["PPO"][0] < 0.85 * rows["untrained"][0]
    assert rows["PPO"][1] > 0.9


@pytest.mark.slow
def test_stable_baselines_saves_a_policy_that_acts_and_its_curve(tmp_path, capsys):
    stable_baselines3 = pytest.importorskip("stable_baselines3", reason="the extra sb3 is absent")
    sb3_ppo = example("sb3_ppo")
    out = tmp_path / "run"
    sb3_ppo.main(sb3_ppo.Options(out=out, steps=2048, robots=4))
    assert {path.name for path in out.iterdir()} == {"policy.zip", *CURVE}
    curve = np.loadtxt(out / "curve.csv", delimiter=",", skiprows=1)
    assert curve[:, 0].tolist() == [512, 1024, 1536, 2048]
    # Episodes end after 200 steps, and every robot has taken 128 steps at the first point, 256 at the second.
    assert np.isnan(curve[:, 1:]).any(axis=1).tolist() == [True, False, False, False]
    assert capsys.readouterr().out.startswith(f"{curve[-1, 1]:.1f} steps per episode")
    refusal(lambda: sb3_ppo.main(sb3_ppo.Options(out=out)), out, "give --out a new folder")
    envs = sb3_ppo.environments(2)
    actions, _ = stable_baselines3.PPO.load(out / "policy.zip").predict(envs.reset())
    assert all(envs.action_space.contains(action) for action in actions)
