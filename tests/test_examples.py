"""The examples run, and do what they say."""

import csv
import importlib.util
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.environments.functional import front_door
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.rollouts.rollout import Episodes
from tests.support.houses import YARD, house
from tests.support.refusals import refusal

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
CURVE = ["curve.csv", "curve.png", "curve.svg", "curve.pdf"]
PLANNERS = ["random", "PPO", "frontier", "oracle"]


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
        return {row["planner"]: (float(row["mean_steps"]), float(row["success"])) for row in csv.DictReader(file)}


@pytest.mark.slow
def test_ppo_sets_what_it_learned_beside_the_others(ppo, tmp_path, capsys):
    out = tmp_path / "run"
    options = ppo.Options(
        steps=800, maps=12, held_out_maps=8, robots=16, steps_per_update=16, batch=100, passes=2, width=16, view=3,
        starts_per_map=2, step_limit=40, out=out,
    )  # fmt: skip
    ppo.main(options)
    rows = table(out / "table.csv")
    assert list(rows) == PLANNERS
    *_, random, policy, frontier, oracle, kept = capsys.readouterr().out.splitlines()
    assert str(out) in kept
    printed = [random, policy, frontier, oracle]
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
    # The policy that was saved acts.
    logits, values = ppo.read_policy(out / "policy.safetensors", options)(jnp.zeros((5, 7, 7), jnp.uint8))
    assert (logits.shape, values.shape) == ((5, 3), (5,))
    assert np.isfinite(logits).all()


def test_ppo_counts_the_steps_to_the_door(ppo):
    """Always forward: from the yard's road to the door in two steps, and into a wall for ever."""
    environment, params = front_door([house("yard", YARD)], sensing_range=4)
    episodes = Episodes(world=jnp.zeros(2, jnp.int32), start=make_pose(*np.array([[3, 5], [3, 3], [3, 0]])))
    forward = lambda key, observations: jnp.zeros_like(observations.pose.x)  # noqa: E731
    steps, success = ppo.play(forward, environment, 7, params, episodes, jax.random.key(0))
    assert (steps.tolist(), success.tolist()) == ([2, 7], [True, False])


def test_ppo_s_advantages_against_their_definition(ppo):
    """The discounted sum of the surprises to come, up to the end of the episode."""
    rng = np.random.default_rng(0)
    steps, robots = 12, 3
    value, reward = rng.normal(size=(2, steps, robots)).astype(np.float32)
    done, last = rng.random((steps, robots)) < 0.25, rng.normal(size=robots).astype(np.float32)
    unused = jnp.zeros((steps, robots))
    lived = ppo.Lived(*[unused] * 3, value, reward, jnp.asarray(done), unused, unused)
    following = np.vstack([value[1:], last])
    expected = np.zeros((steps, robots))
    for step, robot in np.ndindex(steps, robots):
        weight = 1.0
        for later in range(step, steps):
            gone_on = 0.0 if done[later, robot] else 1.0
            expected[step, robot] += weight * (
                reward[later, robot] + ppo.DISCOUNT * following[later, robot] * gone_on - value[later, robot]
            )
            weight *= ppo.DISCOUNT * ppo.GAE_DECAY * gone_on
    np.testing.assert_allclose(ppo.advantages(lived, jnp.asarray(last)), expected, rtol=1e-4, atol=1e-5)


def test_ppo_refuses_bad_options_before_it_learns(ppo, tmp_path):
    refusal(lambda: ppo.main(ppo.Options(robots=0)), "--robots is 0", "at least 1")
    refusal(lambda: ppo.main(ppo.Options(seed=-1)), "--seed is -1")
    refusal(lambda: ppo.main(ppo.Options(out=tmp_path / "no" / "run")), "no/run", "folder")
    refusal(lambda: ppo.main(ppo.Options(out=tmp_path)), tmp_path, "new folder")


@pytest.mark.slow
def test_ppo_learns(ppo, tmp_path):
    """In maps never seen it reaches the door far sooner than by chance, after two or three minutes on two cores."""
    out = tmp_path / "run"
    ppo.main(ppo.Options(steps=1_000_000, maps=300, held_out_maps=60, out=out))
    rows = table(out / "table.csv")
    assert rows["PPO"][0] < 0.5 * rows["random"][0]
    assert rows["PPO"][1] > 0.75 > 0.4 > rows["random"][1]
    assert rows["frontier"][1] == rows["oracle"][1] == 1.0


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
