"""Learn to find the front door with PPO: `python examples/ppo.py`.

One compiled program, environments included, in the manner of PureJaxRL: a scan over updates, in each a scan over steps
of all robots, then a few passes over what they lived through. The maps are procedural houses drawn small. The policy is
then set beside random actions, frontier exploration and the oracle, in maps that it has never seen.
"""

import collections
import dataclasses
import functools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro
from flax import nnx
from jaxtyping import Array, Bool, Float, Int, UInt8
from optax import softmax_cross_entropy_with_integer_labels as cross_entropy
from tqdm import tqdm

from dc2g_jax import InputError
from dc2g_jax.datasets import (
    STYLES,
    House,
    draw_house,
    sample_starts,
    stack_worlds,
    training_house_seed,
    why_no_episode,
)
from dc2g_jax.environments import FrontDoor, Observation, Params, State, egocentric, front_door, observe
from dc2g_jax.estimation import read_safetensors, read_weights, shapes_of_weights, with_weights, write_safetensors
from dc2g_jax.grid import CLASS_NAMES, FORWARD_ACTION, TRAVERSABLE, sample_grid
from dc2g_jax.inspection import save_learning_curve
from dc2g_jax.planning import Frontier, Oracle, complete_rules
from dc2g_jax.rollouts import Episodes, episodes_from, rollout

DISCOUNT, GAE_DECAY = 0.99, 0.95
CLIP, ENTROPY_WEIGHT, VALUE_WEIGHT, MAX_GRADIENT_NORM = 0.2, 0.01, 0.5, 0.5
REWARD_SCALE = 0.05  # What a step's reward of -1 counts, which keeps values around one.

# What the network is told of a cell: 0 unknown, 1 no ground, 2 house, 3 outside, 4 street, 5 driveway or path, 6 door.
CELL_GROUPS = np.array([0, *np.where(TRAVERSABLE[1:], 4, 1), 3])
for _group, _names in ((2, ("house", "garage door")), (5, ("driveway", "path")), (6, ("front_door",))):
    CELL_GROUPS[[CLASS_NAMES.index(name) for name in _names]] = _group
Act = Callable[[Array, Observation], Int[Array, "robots"]]
progress = functools.partial(tqdm, mininterval=0.1 if sys.stderr.isatty() else 15)  # seconds; few lines in a log file


@dataclasses.dataclass(frozen=True)
class Options:
    """Learn to find the front door with PPO, and compare with exploration in maps never seen.

    Attributes:
      steps: steps to learn from, of all robots together.
      maps: procedural houses drawn to learn in; those that lose their door at this size are left out.
      held_out_maps: further houses drawn to compare in.
      cells: cells a side of the maps.
      sensing_range: reach of the robot's field of view, in cells.
      step_limit: steps after which an episode ends without success.
      robots: robots that learn side by side.
      steps_per_update: steps of each robot between two updates.
      passes: times that what the robots lived through is gone over in an update.
      batch: decisions that one gradient is taken of.
      width: units of a hidden layer.
      view: cells that the network sees in each direction.
      learning_rate: of Adam at first; falls to zero.
      starts_per_map: episodes in each map to compare in.
      seed: of everything random, the maps included.
      out: new folder for the policy, the learning curve and the table; without it, nothing is written.
    """

    steps: int = 3_000_000
    maps: int = 800
    held_out_maps: int = 100
    cells: int = 16
    sensing_range: int = 4
    step_limit: int = 200
    robots: int = 256
    steps_per_update: int = 32
    passes: int = 3
    batch: int = 1024
    width: int = 128
    view: int = 8
    learning_rate: float = 1e-3
    starts_per_map: int = 8
    seed: int = 0
    out: Path | None = None


class ActorCritic(nnx.Module):
    """What to do next, and what the future is worth: two hidden layers on the robot's view."""

    def __init__(self, options: Options, rngs: nnx.Rngs):
        layer = functools.partial(nnx.Linear, rngs=rngs)
        self.first = layer((2 * options.view + 1) ** 2 * (CELL_GROUPS.max() + 1), options.width)
        self.second = layer(options.width, options.width)
        self.policy = layer(options.width, FrontDoor.num_actions, kernel_init=nnx.initializers.orthogonal(0.01))
        self.value = layer(options.width, 1, kernel_init=nnx.initializers.orthogonal(1.0))

    def __call__(self, view: UInt8[Array, "robots side side"]) -> tuple[Array, Array]:
        """Logits of the actions `[robots action]` and values `[robots]`."""
        groups = jnp.asarray(CELL_GROUPS)[view]
        hidden = jax.nn.relu(self.first(jax.nn.one_hot(groups, CELL_GROUPS.max() + 1).reshape(len(view), -1)))
        hidden = jax.nn.relu(self.second(hidden))
        # The cell ahead is always seen: whoever knows that there is no ground does not try.
        blocked = groups[:, view.shape[1] // 2 - 1, view.shape[2] // 2] < 4
        return self.policy(hidden).at[:, FORWARD_ACTION].add(-1e9 * blocked), self.value(hidden)[:, 0]


class Lived(NamedTuple):
    """Decisions and what came of them: each `[robots]`, or `[steps robots]` together; views have two more axes."""

    view: Array
    action: Array
    log_probability: Array
    value: Array
    reward: Array
    done: Array
    reached: Array
    episode_length: Array


class Learner(NamedTuple):
    """All that changes while learning."""

    weights: Any
    optimizer_state: Any
    states: State
    observations: Observation
    key: Array


class PPO:
    """What is fixed while learning, and the program that learns."""

    def __init__(self, options: Options, environment: FrontDoor, params: Params):
        self.options, self.environment, self.params = options, environment, params
        self.view = jax.vmap(functools.partial(egocentric, radius=options.view))
        self.definition, self.first_weights = nnx.split(ActorCritic(options, nnx.Rngs(options.seed)))
        self.decisions = options.robots * options.steps_per_update
        self.chunk = max(1, options.steps // self.decisions // 100)  # Progress is shown a hundred times.
        self.updates = self.chunk * max(1, options.steps // self.decisions // self.chunk)
        self.batches = max(1, self.decisions // options.batch)
        rate = optax.linear_schedule(options.learning_rate, 0.0, self.updates * options.passes * self.batches)
        self.optimizer = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.adam(rate, eps=1e-5))

    def network(self, weights: Any, view: UInt8[Array, "robots side side"]) -> tuple[Array, Array]:
        """Logits and values."""
        return nnx.merge(self.definition, weights)(view)

    def act(self, weights: Any, key: Array, observations: Observation) -> Int[Array, "robots"]:
        """Draw actions from the policy."""
        return jax.random.categorical(key, self.network(weights, self.view(observations))[0])

    def live(self, learner: Learner, _: None) -> tuple[Learner, Lived]:
        """One step of every robot."""
        key, action_key, step_key = jax.random.split(learner.key, 3)
        view = self.view(learner.observations)
        logits, value = self.network(learner.weights, view)
        action = jax.random.categorical(action_key, logits)
        keys = jax.random.split(step_key, len(action))
        observations, states, reward, terminated, truncated, info = jax.vmap(
            self.environment.step, in_axes=(0, 0, 0, None)
        )(keys, learner.states, action, self.params)
        # Where only the steps ran out the future is not worth nothing, but what the network expects of it.
        future = self.network(learner.weights, self.view(info["final_observation"]))[1]
        reward = REWARD_SCALE * reward + DISCOUNT * future * truncated
        done, length = terminated | truncated, info["episode_length"]
        lived = Lived(view, action, -cross_entropy(logits, action), value, reward, done, terminated, length)
        return learner._replace(states=states, observations=observations, key=key), lived

    def loss(self, weights: Any, lived: Lived, advantage: Array, target: Array) -> Float[Array, ""]:
        """The clipped objective, to be minimized (Schulman et al. 2017, arXiv 1707.06347, equations 7 and 9)."""
        logits, value = self.network(weights, lived.view)
        ratio = jnp.exp(-cross_entropy(logits, lived.action) - lived.log_probability)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage).mean()
        entropy = -jnp.sum(jax.nn.softmax(logits) * jax.nn.log_softmax(logits), axis=1).mean()
        return -gain + VALUE_WEIGHT * jnp.square(value - target).mean() - ENTROPY_WEIGHT * entropy

    def update(self, learner: Learner, _: None) -> tuple[Learner, Int[Array, "3"]]:
        """Live for some steps and learn from them; returns how many episodes ended, their total length, and doors."""
        learner, lived = jax.lax.scan(self.live, learner, None, self.options.steps_per_update)
        advantage = advantages(lived, self.network(learner.weights, self.view(learner.observations))[1])
        decisions = jax.tree.map(
            lambda leaf: leaf.reshape(self.decisions, *leaf.shape[2:]), (lived, advantage, advantage + lived.value)
        )

        def descend(carry: tuple[Any, Any], rows: Array) -> tuple[tuple[Any, Any], None]:
            gradient = jax.grad(self.loss)(carry[0], *jax.tree.map(lambda leaf: leaf[rows], decisions))
            change, optimizer_state = self.optimizer.update(gradient, carry[1])
            return (optax.apply_updates(carry[0], change), optimizer_state), None

        key, *keys = jax.random.split(learner.key, 1 + self.options.passes)
        orders = jnp.stack([jax.random.permutation(key, self.decisions) for key in keys])
        rows = orders[:, : self.decisions // self.batches * self.batches].reshape(len(keys) * self.batches, -1)
        (weights, optimizer_state), _ = jax.lax.scan(descend, (learner.weights, learner.optimizer_state), rows)
        learner = learner._replace(weights=weights, optimizer_state=optimizer_state, key=key)
        counts = lived.done, lived.done * lived.episode_length, lived.reached
        return learner, jnp.stack([jnp.sum(count) for count in counts])

    @functools.partial(jax.jit, static_argnames="self")
    def learn(self, learner: Learner) -> tuple[Learner, Int[Array, "updates 3"]]:
        """A chunk of updates in one program."""
        return jax.lax.scan(self.update, learner, None, self.chunk)


def advantages(lived: Lived, last_value: Float[Array, "robots"]) -> Float[Array, "steps robots"]:
    """Generalized advantage estimates (Schulman et al. 2016, arXiv 1506.02438, equation 16)."""

    def backward(carry: tuple[Array, Array], step: Lived) -> tuple[tuple[Array, Array], Array]:
        advantage, next_value = carry
        surprise = step.reward + DISCOUNT * next_value * ~step.done - step.value
        advantage = surprise + DISCOUNT * GAE_DECAY * ~step.done * advantage
        return (advantage, step.value), advantage

    return jax.lax.scan(backward, (jnp.zeros_like(last_value), last_value), lived, reverse=True)[1]


def learned_weights(options: Options, ppo: PPO) -> tuple[Any, Float[np.ndarray, "chunks 2"]]:
    """Learn, with a look at the progress after each chunk of updates.

    Returns:
      Weights of the network; and, at the end of each chunk, mean steps and success of the episodes that ended in the
      last `step_limit` steps of the robots, rounded up to chunks. Fewer steps would count only the short episodes,
      since all robots start in step: the first chunks have NaN.
    """
    key, *keys = jax.random.split(jax.random.key(options.seed), 1 + options.robots)
    observations, states = jax.vmap(ppo.environment.reset, in_axes=(0, None))(jnp.stack(keys), ppo.params)
    learner = Learner(ppo.first_weights, ppo.optimizer.init(ppo.first_weights), states, observations, key)
    window = -(-options.step_limit // (ppo.chunk * options.steps_per_update))
    recent: collections.deque[np.ndarray] = collections.deque(maxlen=window)
    curve = []
    with progress(total=ppo.updates * ppo.decisions, desc="learning", unit="step", unit_scale=True) as bar:
        for _ in range(ppo.updates // ppo.chunk):
            learner, counts = ppo.learn(learner)
            recent.append(np.sum(counts, axis=0))
            ended, lengths, reached = np.sum(recent, axis=0)
            curve.append((lengths / ended, reached / ended) if len(recent) == window else (np.nan, np.nan))
            bar.set_postfix(steps_an_episode=f"{curve[-1][0]:.1f}", success=f"{curve[-1][1]:.0%}", refresh=False)
            bar.update(ppo.chunk * ppo.decisions)
    return learner.weights, np.array(curve)


def play(
    act: Act, environment: FrontDoor, step_limit: int, params: Params, episodes: Episodes, key: Array
) -> tuple[Int[Array, "episodes"], Bool[Array, "episodes"]]:
    """Run a policy from given starts: steps taken, and whether a door was reached."""

    def cycle(carry: tuple[State, Array, Array], key: Array) -> tuple[tuple[State, Array, Array], None]:
        states, steps, success = carry
        action = act(key, jax.vmap(observe)(states))
        states, _, reached, _ = jax.vmap(environment.advance, in_axes=(0, 0, None))(states, action, params)
        return (states, steps + ~success, success | reached), None

    _, states = jax.vmap(environment.start, in_axes=(0, 0, None))(episodes.world, episodes.start, params)
    carry = states, jnp.zeros(len(episodes), jnp.int32), jnp.zeros(len(episodes), bool)
    return jax.lax.scan(cycle, carry, jax.random.split(key, step_limit))[0][1:]


def small_houses(count: int, cells: int, seed: int, split: str) -> list[House]:
    """Procedural houses squeezed into few cells; those in which no episode can be run then are left out."""
    numbers = progress(range(count), desc=f"{split} maps", unit="map")
    pictures = (draw_house(training_house_seed(seed, number), STYLES[number % len(STYLES)]) for number in numbers)
    houses = [House(f"{split}{n}", split, sample_grid(picture, cells)) for n, picture in enumerate(pictures)]
    if not (kept := [house for house in houses if why_no_episode(house) is None]):
        raise InputError(f"no {split} map of {count} keeps a way to its door in {cells} cells; give more --cells")
    return kept


def read_policy(path: str | Path, options: Options) -> ActorCritic:
    """The network of a `policy.safetensors`, learned with these options (`view` and `width` count)."""
    weights = read_weights(path, shapes_of_weights(ActorCritic, options), read_safetensors(path)[0])
    return with_weights(ActorCritic, options, weights)


def compare(options: Options, houses: Sequence[House], act: Act) -> list[tuple[str, float, float]]:
    """Planner, mean steps and success of the policy and of what it is measured against, from the same starts."""
    environment, params = front_door(houses, sensing_range=options.sensing_range, step_limit=options.step_limit)
    starts = sample_starts(houses, options.starts_per_map, seed=options.seed)
    episodes = episodes_from(starts, {house.name: number for number, house in enumerate(houses)})
    results: dict[str, Any] = {}
    at_random = lambda key, seen: jax.random.randint(key, seen.pose.x.shape, 0, FrontDoor.num_actions)  # noqa: E731
    for name, policy in (("random", at_random), ("PPO", act)):
        run = jax.jit(functools.partial(play, policy, environment, options.step_limit))
        results[name] = run(params, episodes, jax.random.key(options.seed))
    rules = complete_rules(options.sensing_range)
    for name, planner in (("frontier", Frontier(rules)), ("oracle", Oracle())):
        done = rollout(planner, stack_worlds(houses), episodes, sensing=rules.sensing, step_limit=options.step_limit)
        results[name] = done.steps, done.success
    return [(name, float(np.mean(steps)), float(np.mean(success))) for name, (steps, success) in results.items()]


def main(options: Options) -> None:
    """Draw maps, learn in them and in their mirror images, compare."""
    for name, value in vars(options).items():
        if isinstance(value, int) and value < 1 and (name, value) != ("seed", 0):
            raise InputError(f"--{name.replace('_', '-')} is {value}; give a whole number of at least 1")
    if options.out is not None:
        if options.out.exists() or not options.out.parent.is_dir():
            raise InputError(f"{options.out}: exists, or its parent folder does not; give --out a new folder")
        options.out.mkdir()
    houses = small_houses(options.maps, options.cells, 2 * options.seed, "training")
    held_out = small_houses(options.held_out_maps, options.cells, 2 * options.seed + 1, "held-out")
    houses += [House(f"{house.name}m", house.split, house.terrain[:, ::-1].copy()) for house in houses]
    ppo = PPO(options, *front_door(houses, sensing_range=options.sensing_range, step_limit=options.step_limit))
    weights, curve = learned_weights(options, ppo)
    rows = compare(options, held_out, functools.partial(ppo.act, weights))
    print(f"{len(held_out)} held-out maps, {options.starts_per_map} starts in each, at most {options.step_limit} steps")
    print(f"{'':10}{'mean steps':>12}{'success':>10}")
    for name, steps, success in rows:
        print(f"{name:10}{steps:12.1f}{success:10.1%}")
    if options.out is None:
        print("Nothing was kept; --out FOLDER keeps policy, learning curve and table.")
    else:
        lines = ("planner,mean_steps,success", *(f"{name},{steps},{success}" for name, steps, success in rows), "")
        (options.out / "table.csv").write_text("\n".join(lines))
        steps = ppo.chunk * ppo.decisions * np.arange(1, len(curve) + 1)
        save_learning_curve(options.out / "curve", steps, *curve.T)
        write_safetensors(options.out / "policy.safetensors", nnx.to_pure_dict(weights), {})
        print(f"Policy, learning curve and table are in {options.out}.")


if __name__ == "__main__":
    try:
        main(tyro.cli(Options))
    except (InputError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted")
