"""Learn the planner `recurrent_policy` with PPO: `python examples/ppo.py --out learned`.

One compiled program, robots included, in the manner of PureJaxRL: a scan over updates, in each a scan over steps of all
robots, then a few passes over what they decided. The maps are procedural houses, mazes, halls and offices drawn for
this, none of them in a dataset. The policy is then set beside an untrained one, frontier exploration and the oracle, in
maps of the split `val`.
"""

import collections
import dataclasses
import functools
import itertools
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro
from flax import nnx, struct
from jaxtyping import Array, Float, Int
from tqdm import tqdm

from dc2g_jax import InputError
from dc2g_jax.datasets import House, open_dataset, sample_starts, stack_worlds, why_no_episode
from dc2g_jax.environments import FrontDoor, Params, State, front_door
from dc2g_jax.estimation import fresh_weights, with_weights, write_safetensors
from dc2g_jax.families import plain_maps, procedural_training_houses
from dc2g_jax.grid import sample_grid
from dc2g_jax.inspection import save_learning_curve
from dc2g_jax.planning import GAVE_UP, Frontier, Oracle, Rules, complete_rules
from dc2g_jax.rivals import PolicyInputs, RecurrentNetwork, RecurrentPolicy
from dc2g_jax.rollouts import episodes_from, rollout

GAE_DECAY, CLIP, VALUE_WEIGHT, MAX_GRADIENT_NORM = 0.95, 0.2, 0.5, 0.5
UNITS = RecurrentNetwork.UNITS
FIRST_STEPS = 10  # The cost of a step is what it adds to the logarithm of the steps and these.
PLAIN = ("mazes", "halls", "offices")
progress = functools.partial(tqdm, mininterval=0.1 if sys.stderr.isatty() else 15)  # seconds; few lines in a log file


@dataclasses.dataclass(frozen=True)
class Options:
    """Learn the planner `recurrent_policy` with PPO, and compare it in maps never seen.

    Attributes:
      steps: steps to learn from, of all robots together.
      maps: maps drawn to learn in, half of them houses.
      sensing_range: reach of the robot's field of view, in cells.
      step_limit: steps after which an episode ends without success.
      robots: robots that learn side by side.
      steps_per_update: steps of each robot between two updates.
      passes: times that what the robots decided is gone over in an update.
      batches: parts of the robots that one gradient is taken of.
      learning_rate: of Adam at first; falls to zero.
      entropy_weight: weight of the policy's entropy.
      val_maps: maps of each kind of the split `val` to compare in, at most.
      seed: of everything random, the maps included.
      out: new folder for the policy, the learning curve and the table; without it, nothing is written.
    """

    steps: int = 2_500_000
    maps: int = 600
    sensing_range: int = 8
    step_limit: int = 400
    robots: int = 64
    steps_per_update: int = 128
    passes: int = 4
    batches: int = 4
    learning_rate: float = 1e-3
    entropy_weight: float = 0.01
    val_maps: int = 16
    seed: int = 0
    out: Path | None = None


class Decided(NamedTuple):
    """The last decision of each robot: axes of the batch come last, and first in what is learned from.

    Attributes:
      noise: Gumbel noise that the next block is drawn with.
      count: decisions in this episode.
      seen: inputs of the policy.
      hidden: state of the recurrent layer before.
      block: the block drawn.
    """

    noise: Array
    count: Array
    seen: Any
    hidden: Array
    block: Array


@struct.dataclass
class Drawing(RecurrentPolicy):
    """The policy, but its blocks are drawn, and what was decided is noted."""

    def init(self, world):
        """Nothing has been decided."""
        state = super().init(world)
        memory, zero = state.estimator, jnp.zeros(world.goals.shape[2:], jnp.int32)
        notes = Decided(memory.logits, zero, PolicyInputs.none(zero.shape), memory.hidden, zero)
        return state._replace(estimator=memory._replace(notes=notes))

    def prefer(self, seen, memory):
        """The block drawn is preferred to all others."""
        preferred, notes = super().prefer(seen, memory), memory.notes
        block = jnp.argmax(preferred.logits + notes.noise, axis=0).astype(jnp.int32)
        notes = Decided(notes.noise, notes.count + 1, seen, memory.hidden, block)
        return preferred._replace(logits=jax.nn.one_hot(block, len(preferred.logits), axis=0), notes=notes)


class Critic(nnx.Module):
    """How much the logarithm of the steps will still grow, from what the policy remembers and the steps so far."""

    def __init__(self, units: int, rngs: nnx.Rngs):
        self.first = nnx.Linear(units + 1, units, rngs=rngs)
        self.value = nnx.Linear(units, 1, rngs=rngs)

    def __call__(self, hidden: Float[Array, "... unit"], steps: Int[Array, "..."]) -> Float[Array, "..."]:
        """Minus the growth to come."""
        inputs = jnp.concatenate([hidden, jnp.log(FIRST_STEPS + steps)[..., None] - 4], axis=-1)
        return self.value(jax.nn.relu(self.first(inputs)))[..., 0]


class Learner(NamedTuple):
    """All that changes while learning. Axes of the robots come last."""

    weights: Any
    optimizer_state: Any
    states: State
    memories: Any
    key: Array


class Step(NamedTuple):
    """One step of each robot: `[robots]`, or `[steps robots]` together."""

    decided: Array
    decision: Decided
    steps_before: Array
    reward: Array
    done: Array
    reached: Array


class PPO:
    """What is fixed while learning, and the program that learns."""

    def __init__(self, options: Options, environment: FrontDoor, params: Params, rules: Rules):
        self.options, self.environment, self.params, self.rules = options, environment, params, rules
        self.first_weights = {
            name: fresh_weights(kind, UNITS, jax.random.fold_in(jax.random.key(options.seed), number))
            for number, (name, kind) in enumerate((("policy", RecurrentNetwork), ("critic", Critic)))
        }
        per_update = options.robots * options.steps_per_update
        self.chunk = max(1, options.steps // per_update // 100)  # Progress is shown a hundred times.
        self.updates = self.chunk * max(1, options.steps // per_update // self.chunk)
        rate = optax.linear_schedule(options.learning_rate, 0.0, self.updates * options.passes * options.batches)
        self.optimizer = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.adam(rate, eps=1e-5))

    def reset(self, key: Array) -> tuple[State, Any]:
        """New episodes: their states and what the robots remember."""
        keys = jax.random.split(key, self.options.robots)
        states = jax.vmap(self.environment.reset, in_axes=(0, None), out_axes=-1)(keys, self.params)[1]
        return states, Drawing(self.rules, weights=self.first_weights["policy"]).init(states.belief)

    def live(self, learner: Learner, _: None) -> tuple[Learner, Step]:
        """One step of every robot."""
        key, draw, reset = jax.random.split(learner.key, 3)
        memory = learner.memories.estimator
        notes = memory.notes._replace(noise=jax.random.gumbel(draw, memory.logits.shape))
        before = learner.memories._replace(estimator=memory._replace(notes=notes))
        plan, memories = Drawing(self.rules, weights=learner.weights["policy"]).plan(learner.states.belief, before)
        states, _, reached, truncated = self.environment.advance(learner.states, plan.action, self.params)
        done = reached | truncated | (plan.mode == GAVE_UP)
        notes, steps = memories.estimator.notes, learner.states.belief.steps
        reward = jnp.log(FIRST_STEPS + steps) - jnp.log(FIRST_STEPS + steps + 1)
        # Steps of an episode without a decision teach nothing.
        step = Step(
            notes.count > memory.notes.count, notes._replace(noise=()), steps, reward * (notes.count > 0), done, reached
        )
        states, memories = jax.tree.map(
            lambda new, old: jnp.where(done, new, old), self.reset(reset), (states, memories)
        )
        return learner._replace(states=states, memories=memories, key=key), step

    def think(self, weights: Any, decision: Decided, steps: Array) -> tuple[Array, Array]:
        """Logits and values of decisions of the robots `[robots decisions ...]`, one after the other."""
        policy = with_weights(RecurrentNetwork, UNITS, weights["policy"])

        def remember(hidden: Array, decided: tuple[Array, Array]) -> tuple[Array, Array]:
            shares, count = decided
            hidden = policy.remember(jnp.where(count[:, None] == 1, 0, hidden), shares)
            return hidden, hidden

        in_turn = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), (decision.seen.shares, decision.count))
        hidden = jnp.swapaxes(jax.lax.scan(remember, decision.hidden[:, 0], in_turn)[1], 0, 1)
        return policy.rate(hidden, decision.seen), with_weights(Critic, UNITS, weights["critic"])(hidden, steps)

    def loss(
        self,
        weights: Any,
        decision: Decided,
        steps: Array,
        before: Array,
        advantage: Array,
        target: Array,
        valid: Array,
    ) -> Float[Array, ""]:
        """The clipped objective, to be minimized (Schulman et al. 2017, arXiv 1707.06347, equations 7 and 9)."""
        logits, value = self.think(weights, decision, steps)
        mean = lambda values: jnp.sum(values * valid) / jnp.maximum(jnp.sum(valid), 1)  # noqa: E731
        ratio = jnp.exp(log_probability(logits, decision.block) - before)
        advantage = advantage - mean(advantage)
        advantage /= jnp.sqrt(mean(jnp.square(advantage))) + 1e-8
        gain = mean(jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage))
        entropy = mean(-jnp.sum(jax.nn.softmax(logits) * jax.nn.log_softmax(logits), axis=-1))
        return -gain + VALUE_WEIGHT * mean(jnp.square(value - target)) - self.options.entropy_weight * entropy

    def update(self, learner: Learner, _: None) -> tuple[Learner, Float[Array, "4"]]:
        """Live for some steps and learn; returns how many episodes ended, their steps, logarithms, and doors."""
        learner, lived = jax.lax.scan(self.live, learner, None, self.options.steps_per_update)
        decision, steps, reward, done, valid = decisions(lived)
        logits, value = self.think(learner.weights, decision, steps)
        advantage = advantages(reward, value, done, valid)
        rows = decision, steps, log_probability(logits, decision.block), advantage, advantage + value, valid

        def descend(carry: tuple[Any, Any], robots: Array) -> tuple[tuple[Any, Any], None]:
            gradient = jax.grad(self.loss)(carry[0], *jax.tree.map(lambda leaf: leaf[robots], rows))
            change, optimizer_state = self.optimizer.update(gradient, carry[1])
            return (optax.apply_updates(carry[0], change), optimizer_state), None

        key, *keys = jax.random.split(learner.key, 1 + self.options.passes)
        orders = jnp.concatenate(
            [jax.random.permutation(key, self.options.robots).reshape(self.options.batches, -1) for key in keys]
        )
        (weights, optimizer_state), _ = jax.lax.scan(descend, (learner.weights, learner.optimizer_state), orders)
        length = lived.steps_before + 1
        counts = lived.done, lived.done * length, lived.done * jnp.log(length), lived.reached
        counts = jnp.stack([jnp.sum(count.astype(jnp.float32)) for count in counts])
        return learner._replace(weights=weights, optimizer_state=optimizer_state, key=key), counts

    @functools.partial(jax.jit, static_argnames="self")
    def learn(self, learner: Learner) -> tuple[Learner, Float[Array, "updates 4"]]:
        """A chunk of updates in one program."""
        return jax.lax.scan(self.update, learner, None, self.chunk)


def log_probability(logits: Array, block: Array) -> Array:
    """Of the blocks drawn."""
    return -optax.softmax_cross_entropy_with_integer_labels(logits, block)


def decisions(lived: Step) -> tuple[Decided, Array, Array, Array, Array]:
    """The decisions among the steps, at most one in three steps.

    Returns:
      The decisions `[robots decisions ...]`; the steps of the episode before each; the reward until the next one or the
      end of the episode; whether that came; and whether the decision is one to learn from: the last one of a robot is
      not, but its value counts.
    """
    count = -(-len(lived.decided) // 3)
    when = jnp.argsort(~lived.decided, axis=0, stable=True)[:count]
    there = jnp.take_along_axis(lived.decided, when, axis=0)

    def at(leaf: Array, when: Array) -> Array:
        """Values `[steps ... robots]` at steps, as `[robots decisions ...]`."""
        when = when.reshape(len(when), *(1,) * (leaf.ndim - 2), -1)
        return jnp.moveaxis(jnp.take_along_axis(leaf, when, axis=0), -1, 0)

    start = lambda leaf: jnp.cumsum(leaf.astype(jnp.float32), axis=0) - leaf  # noqa: E731
    valid = there[:-1] & there[1:]
    reward, done = (at(start(leaf), when[1:]) - at(start(leaf), when[:-1]) for leaf in (lived.reward, lived.done))
    decision = jax.tree.map(lambda leaf: at(leaf, when), lived.decision)
    last = [(0, 0), (0, 1)]
    return decision, at(lived.steps_before, when), *(jnp.pad(leaf, last) for leaf in (reward, done > 0, valid.T))


def advantages(reward: Array, value: Array, done: Array, valid: Array) -> Float[Array, "robots decisions"]:
    """Generalized advantage estimates without discount (Schulman et al. 2016, arXiv 1506.02438, equation 16)."""

    def backward(advantage: Array, step: tuple[Array, ...]) -> tuple[Array, Array]:
        reward, value, next_value, done, valid = step
        advantage = valid * (reward + ~done * (next_value + GAE_DECAY * advantage) - value)
        return advantage, advantage

    following = jnp.pad(value[:, 1:], [(0, 0), (0, 1)])
    steps = jax.tree.map(jnp.transpose, (reward, value, following, done, valid))
    return jax.lax.scan(backward, jnp.zeros(len(reward)), steps, reverse=True)[1].T


def learned_weights(options: Options, ppo: PPO) -> tuple[Any, Float[np.ndarray, "chunks 3"]]:
    """Learn, with a look at the progress after each chunk of updates.

    Returns:
      Weights of the policy; and, at the end of each chunk, mean steps, their geometric mean and success of the episodes
      that ended in the last `step_limit` steps of the robots, rounded up to chunks. Fewer steps would count only the
      short episodes, since all robots start in step: the first chunks have NaN.
    """
    key, first = jax.random.split(jax.random.key(options.seed))
    states, memories = ppo.reset(first)
    learner = Learner(ppo.first_weights, ppo.optimizer.init(ppo.first_weights), states, memories, key)
    window = -(-options.step_limit // (ppo.chunk * options.steps_per_update))
    recent: collections.deque[np.ndarray] = collections.deque(maxlen=window)
    curve = []
    steps = ppo.chunk * options.robots * options.steps_per_update
    with progress(total=ppo.updates // ppo.chunk * steps, desc="learning", unit="step", unit_scale=True) as bar:
        for _ in range(ppo.updates // ppo.chunk):
            learner, counts = ppo.learn(learner)
            recent.append(np.sum(counts, axis=0))
            ended, lengths, logs, reached = np.sum(recent, axis=0)
            ended = ended if len(recent) == window else np.nan
            curve.append((lengths / ended, np.exp(logs / ended), reached / ended))
            shown = dict(
                zip(("steps", "geometric_mean", "success"), (f"{value:.3g}" for value in curve[-1]), strict=True)
            )
            bar.set_postfix(shown, refresh=False)
            bar.update(steps)
            if options.out is not None:
                save(options.out / "policy.safetensors", learner.weights["policy"])
    return learner.weights["policy"], np.array(curve)


def save(path: Path, weights: Any) -> None:
    """Write a policy in half precision."""
    write_safetensors(path, jax.tree.map(lambda leaf: np.asarray(leaf, np.float16), weights))


def training_maps(options: Options) -> list[House]:
    """Houses, and as many mazes, halls and offices, of seeds that no dataset has; all of them mirrored, too."""
    pictures = [sample_grid(picture, 50) for picture in procedural_training_houses(options.maps // 2, options.seed)]
    each = -(-(options.maps - len(pictures)) // len(PLAIN))
    for kind in PLAIN:
        drawn = (picture for seed in itertools.count(options.seed + 1) for _, _, picture in plain_maps(kind, seed))
        pictures += itertools.islice(drawn, each)
    houses = [House(f"map{n}", "train", picture) for n, picture in enumerate(pictures)]
    houses = [house for house in houses if why_no_episode(house) is None]
    return houses + [House(f"{house.name}m", house.split, house.terrain[:, ::-1].copy()) for house in houses]


def compare(options: Options, rules: Rules, weights: Any) -> list[tuple[str, float, float]]:
    """Planner, geometric mean of steps and success of the policy and others, from the same starts in unseen maps."""
    houses = [
        house
        for name in ("procedural", *PLAIN)
        for house in [house for house in open_dataset(name).houses if house.split == "val"][: options.val_maps]
    ]
    starts = sample_starts(houses, 2, seed=options.seed)
    episodes = episodes_from(starts, {house.name: number for number, house in enumerate(houses)})
    untrained = fresh_weights(RecurrentNetwork, UNITS, jax.random.key(options.seed))
    rows = []
    for name, planner in (
        ("untrained", RecurrentPolicy(rules, weights=untrained)), ("PPO", RecurrentPolicy(rules, weights=weights)),
        ("frontier", Frontier(rules)), ("oracle", Oracle()),
    ):  # fmt: skip
        done = rollout(planner, stack_worlds(houses), *episodes, sensing=rules.sensing, step_limit=options.step_limit)
        rows.append((name, float(np.exp(np.mean(np.log(done.steps)))), float(np.mean(done.success))))
    return rows


def main(options: Options) -> None:
    """Draw maps, learn in them, compare."""
    for name, value in vars(options).items():
        if isinstance(value, int) and value < 1 and (name, value) != ("seed", 0):
            raise InputError(f"--{name.replace('_', '-')} is {value}; give a whole number of at least 1")
    if options.robots % options.batches:
        raise InputError(f"--batches is {options.batches}; give a divisor of --robots {options.robots}")
    if options.out is not None:
        if options.out.exists() or not options.out.parent.is_dir():
            raise InputError(f"{options.out}: exists, or its parent folder does not; give --out a new folder")
        options.out.mkdir()
    rules, houses = complete_rules(options.sensing_range), training_maps(options)
    learning = front_door(houses, sensing_range=options.sensing_range, step_limit=options.step_limit)
    ppo = PPO(options, *learning, rules)
    weights, curve = learned_weights(options, ppo)
    rows = compare(options, rules, weights)
    print(f"{'':10}{'geometric mean of steps':>25}{'success':>10}")
    for name, steps, success in rows:
        print(f"{name:10}{steps:25.1f}{success:10.1%}")
    if options.out is None:
        print("Nothing was kept; --out FOLDER keeps policy, learning curve and table.")
    else:
        lines = ("planner,steps,success", *(f"{name},{steps},{success}" for name, steps, success in rows), "")
        (options.out / "table.csv").write_text("\n".join(lines))
        each = ppo.chunk * options.robots * options.steps_per_update
        save_learning_curve(options.out / "curve", each * np.arange(1, len(curve) + 1), curve[:, 1], curve[:, 2])
        print(f"Policy, learning curve and table are in {options.out}.")


if __name__ == "__main__":
    try:
        main(tyro.cli(Options))
    except (InputError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted")
