"""Learn to find the front door with Stable-Baselines3's PPO and a small convolutional network.

`python examples/sb3_ppo.py --out OUT` takes some minutes on two cores and needs the extra `sb3`. The robots learn in
the procedural houses of the split `train`, drawn small. `ppo.py` also evaluates the policy on unseen maps.
"""

import collections
import dataclasses
import sys
from pathlib import Path

try:
    import gymnasium
    import numpy as np
    import torch
    import tyro
    from gymnasium.wrappers import TransformReward
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import DummyVecEnv
    from torch import nn
except ModuleNotFoundError as error:
    if __name__ != "__main__":
        raise
    sys.exit(f'error: {error.name} is not installed; run: pip install -e ".[sb3]"')

import dc2g_jax as dc2g
from dc2g_jax import InputError
from dc2g_jax.gymnasium import EgocentricObservation
from dc2g_jax.inspection import save_learning_curve

REWARD_SCALE = 0.05  # Scales a step's reward of -1, so that values stay around one.
CELLS, TASK = 16, {"sensing_range": 4, "step_limit": 200}
RADIUS = 6  # Cells that the network sees in each direction.


@dataclasses.dataclass(frozen=True)
class Options:
    """Learn to find the front door with Stable-Baselines3's PPO.

    Attributes:
      out: new folder for the policy and the learning curve.
      steps: steps to learn from, of all robots together.
      robots: robots that learn side by side.
      seed: random seed.
    """

    out: Path
    steps: int = 300_000
    robots: int = 16
    seed: int = 0


class Convolutions(BaseFeaturesExtractor):
    """Features of a view: two convolutions and a layer."""

    def __init__(self, observation_space: gymnasium.spaces.Box, features: int = 128):
        super().__init__(observation_space, features)
        planes, side, _ = observation_space.shape
        reduced = (side - 3) // 2  # a convolution of 3 cells, then one with stride 2
        self.layers = nn.Sequential(
            nn.Conv2d(planes, 32, 3), nn.ReLU(), nn.Conv2d(32, 32, 3, stride=2), nn.ReLU(),
            nn.Flatten(), nn.Linear(32 * reduced**2, features), nn.ReLU(),
        )  # fmt: skip

    def forward(self, views: torch.Tensor) -> torch.Tensor:
        """Features [robots features] of views [robots class side side]."""
        return self.layers(views)


class LearningCurve(BaseCallback):
    """After each rollout, mean steps and success of the last hundred episodes.

    There is none before the step limit: all robots start in step, so that only the short episodes have ended.
    """

    def __init__(self) -> None:
        super().__init__()
        self.ended: collections.deque[tuple[int, bool]] = collections.deque(maxlen=100)
        self.points: list[tuple[int, float, float]] = []

    def _on_step(self) -> bool:
        infos = [info for info in self.locals["infos"] if "episode" in info]
        self.ended += [(info["episode"]["l"], not info["TimeLimit.truncated"]) for info in infos]
        return True

    def _on_rollout_end(self) -> None:
        early = self.n_calls < TASK["step_limit"]
        steps, success = (np.nan, np.nan) if early else np.mean(self.ended, axis=0)
        self.points.append((self.num_timesteps, steps, success))


def environments(robots: int) -> DummyVecEnv:
    """Robots in small procedural houses, each of which sees the cells around it."""
    options = {"dataset": dc2g.open_dataset("procedural", cells=CELLS), **TASK}

    def make() -> gymnasium.Env:
        env = EgocentricObservation(gymnasium.make("dc2g_jax/FrontDoor-v0", **options), RADIUS)
        # The monitor counts true steps and rewards.
        return TransformReward(Monitor(env), lambda reward: REWARD_SCALE * reward)

    return DummyVecEnv([make] * robots)


def main(options: Options) -> None:
    """Learn, and save policy and curve."""
    if options.out.exists() or not options.out.parent.is_dir():
        raise InputError(f"{options.out}: exists, or its parent folder does not; give --out a new folder")
    options.out.mkdir()
    torch.set_num_threads(1)  # More threads would mostly wait for each other: the network is small.
    model = PPO(
        "CnnPolicy",
        environments(options.robots),
        learning_rate=lambda left: 1e-3 * left,
        n_steps=128,
        batch_size=512,
        n_epochs=4,
        ent_coef=0.01,
        policy_kwargs={"features_extractor_class": Convolutions, "normalize_images": False},
        seed=options.seed,
        device="cpu",
    )
    curve = LearningCurve()
    model.learn(options.steps, callback=curve)
    model.save(options.out / "policy.zip")
    steps, lengths, success = map(np.array, zip(*curve.points, strict=True))
    save_learning_curve(options.out / "curve", steps, lengths, success)
    print(
        f"{lengths[-1]:.1f} steps per episode, {success[-1]:.0%} success after {steps[-1]} steps; an episode ends "
        f"after {TASK['step_limit']}\nPolicy and learning curve are in {options.out}."
    )


if __name__ == "__main__":
    try:
        main(tyro.cli(Options))
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted")
