"""Learn where the goal is, not the cost of going there: `python -m experiments.studies.goal_location`.

The same network is trained with the same masks to predict the cost-to-go, the straight-line distance to the nearest
goal cell, and the goal's place on the map. Algorithm 2 then goes by each of them.
"""

import dataclasses
import functools
import shutil
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, UInt8
from scipy.stats import spearmanr

from dc2g_jax._src.cli.common import command_line, digests
from dc2g_jax._src.cli.options import DatasetOptions, OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import Estimator, ExactCostToGo, NetworkCostToGo
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.readers.houses import HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import sample_starts, usable_houses
from dc2g_jax._src.rollouts.evaluation import evaluate
from dc2g_jax._src.rollouts.results import Results
from dc2g_jax._src.rollouts.statistics import house_bootstrap
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax._src.training.cost_to_go import TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig, drawn_houses, validation_pairs
from dc2g_jax._src.training.loop import Pauses
from dc2g_jax._src.training.pairs import Pair, TrainingSet
from dc2g_jax._src.training.train import train

from .unknown_dimensions import SEEDS

#: What a network learns.
LABELS = ("cost_to_go", "distance", "place")

#: Validation pairs, bootstrap samples, and steps from one look at the pairs to the next.
_PAIRS, _RESAMPLES, _STEPS_A_LOOK = 512, 10_000, 100


def straight_to(goals: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """Straight-line distance from every cell to the nearest goal cell, in cells; infinite without one."""
    height, width = goals.shape
    rows, columns = jnp.arange(height), jnp.arange(width)
    apart = ((rows[:, None] - rows) ** 2)[..., None]
    in_column = jnp.min(jnp.where(goals, apart, jnp.inf), axis=1)
    return jnp.sqrt(jnp.min(in_column[:, None, :] + (columns[:, None] - columns) ** 2, axis=-1))


def to_distance(pair: Pair) -> Pair:
    """The pair with straight-line distances as labels of the same cells, with the same weights."""
    target = jax.vmap(straight_to)(pair.target == 0)
    return dataclasses.replace(pair, target=target, weight=jnp.where(jnp.isfinite(target), pair.weight, 0))


def to_place(pair: Pair) -> Pair:
    """The pair with 1 at goal cells and 0 elsewhere as labels of all cells, observed or not."""
    goals = pair.target == 0
    there = jnp.any(goals, axis=(1, 2), keepdims=True)
    return dataclasses.replace(pair, target=goals.astype(jnp.float32), weight=there * jnp.ones_like(pair.weight))


def place_loss(
    estimate: Float[Array, "h w q"], target: Float[Array, "h w 1"], levels: Float[Array, "q"]
) -> Float[Array, "h w q"]:
    """Negative logarithm of the probability of the goal's cells, a softmax over the map; the same for every cell."""
    del levels
    log_chance = jax.nn.log_softmax(estimate, axis=(0, 1))
    at_goal = jax.nn.logsumexp(jnp.where(target > 0, log_chance, -1e9), axis=(0, 1))
    return jnp.broadcast_to(-at_goal, estimate.shape)


@dataclasses.dataclass(frozen=True)
class LabeledData(DataConfig):
    """Training data whose labels are one of `LABELS`."""

    label: str = "cost_to_go"

    def draw_batch(self, key: Array, data: TrainingSet, *, batch_size: int) -> Pair:
        """Draws the pairs of a step."""
        pairs = super().draw_batch(key, data, batch_size=batch_size)
        change: Callable[[Pair], Pair] = {"distance": to_distance, "place": to_place}.get(self.label, lambda same: same)
        return change(pairs)


@struct.dataclass
class ExpectedDistance(Estimator):
    """The mean straight-line distance to the goal, whose place a network predicts.

    Attributes:
      network: network of `place_loss`.
    """

    network: NetworkCostToGo

    def chances(self, terrain: UInt8[Array, "h w *batch"]) -> Float[Array, "h w *batch"]:
        """Probability that the goal is in a cell."""
        logits = self.network.estimate(terrain, ())[0] / self.network.architecture.cost_scale
        return jax.nn.softmax(logits, axis=(0, 1))

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: tuple[()]) -> Float[Array, "1 h w *batch"]:
        """The mean distance in cells."""
        del state
        height, width = terrain.shape[:2]
        rows, columns = (axis.ravel() for axis in jnp.mgrid[:height, :width])
        apart = jnp.hypot(*((place[:, None] - place).astype(jnp.float32) for place in (rows, columns)))
        return (apart @ self.chances(terrain).reshape(height * width, -1)).reshape(1, *terrain.shape)


@struct.dataclass
class ExactDistance(Estimator):
    """The exact straight-line distance to the nearest goal cell, which is hidden from the robot."""

    def init(self, world: World) -> Float[Array, "h w *batch"]:
        """The distance from each cell."""
        goals = bitboard.unpack(world.goals, world.width)
        flat = goals.reshape(*goals.shape[:2], -1)
        return jax.vmap(straight_to, in_axes=-1, out_axes=-1)(flat).reshape(goals.shape)

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: Array) -> Float[Array, "1 h w *batch"]:
        """The same whatever was observed."""
        del terrain
        return state[None]


def estimator_of(label: str, network: NetworkCostToGo) -> Estimator:
    """What a planner goes by."""
    return ExpectedDistance(network) if label == "place" else network


@jit
def _mean_estimate(estimator: Estimator, terrain: UInt8[Array, "h w *batch"]) -> Float[Array, "h w *batch"]:
    return jnp.mean(estimator.estimate(terrain, ()), axis=0)


class Judge:
    """Validation pairs without a goal in view, and how well an estimator does on them."""

    def __init__(self, dataset: HouseDataset):
        pairs = validation_pairs(dataset, count=_PAIRS, edge_weight=4.0)
        hidden = ~jnp.any((pairs.target == 0) & (pairs.weight > 0), axis=(1, 2))
        pairs = jax.tree.map(lambda leaf: leaf[hidden], pairs)
        self.cost, self.straight = pairs, jit(to_distance)(pairs)
        self.terrain = jnp.moveaxis(pairs.terrain, 0, -1)

    def estimates(self, estimator: Estimator) -> np.ndarray:
        """What the estimator says, `[pair h w]`."""
        return np.moveaxis(np.asarray(_mean_estimate(estimator, self.terrain)), -1, 0)

    def skill(self, label: str, network: NetworkCostToGo) -> float:
        """1 - mean absolute error / that of the best constant, in the unit of the label, 0 to 1."""
        pairs = self.cost if label == "cost_to_go" else self.straight
        weight, target = np.asarray(pairs.weight), np.asarray(jnp.where(pairs.weight > 0, pairs.target, 0))
        weight = weight / weight.sum(axis=(1, 2), keepdims=True)

        def error(estimate: np.ndarray | float) -> float:
            return float(np.sum(weight * np.abs(estimate - target)) / len(weight))

        constant = min(error(float(value)) for value in range(int(target.max()) + 1))
        return 1 - error(self.estimates(estimator_of(label, network))) / constant

    def ranks(self, estimator: Estimator) -> float:
        """Mean rank correlation with the exact cost-to-go, over the cells of each map that border on unseen ground."""
        found = []
        for mine, exact, weight in zip(self.estimates(estimator), self.cost.target, self.cost.weight, strict=True):
            edge = np.asarray(weight) > 1
            if edge.sum() > 2 and np.ptp(np.asarray(exact)[edge]) > 0:
                found.append(spearmanr(mine[edge], np.asarray(exact)[edge]).statistic)
        return float(np.nanmean(found))

    def place(self, network: ExpectedDistance) -> dict[str, float]:
        """Of a network that predicts the goal's place: AUC of goal cells, nats, and those of chance in unseen cells."""
        chances = np.moveaxis(np.asarray(jit(ExpectedDistance.chances)(network, self.terrain)), -1, 0)
        goals, unseen = np.asarray(self.cost.target) == 0, np.asarray(self.cost.terrain) == 0
        areas = [np.mean(one[goal].max() > one[~goal]) for one, goal in zip(chances, goals, strict=True)]
        found = -np.log(np.sum(chances * goals, axis=(1, 2)))
        guess = -np.log(np.sum(unseen & goals, axis=(1, 2)) / np.sum(unseen, axis=(1, 2)))
        return {"auc": float(np.mean(areas)), "nats": float(np.mean(found)), "nats of a guess": float(np.mean(guess))}


class Curve:
    """Watches a training: the skill on validation pairs as the network learns, see `training.loop.Recording`."""

    def __init__(self, judge: Judge, label: str, architecture: Architecture):
        self.judge, self.label, self.architecture, self.skills = judge, label, architecture, dict[int, float]()

    def look(self, step: int, figures: Mapping[str, float], weights: Any) -> None:
        """Note the skill."""
        if step % _STEPS_A_LOOK == 0:
            self.skills[step] = self.judge.skill(self.label, NetworkCostToGo(weights, self.architecture))

    def validate(self, step: int, figures: Mapping[str, float], weights: Any) -> None:
        """Nothing to show."""

    def close(self) -> None:
        """Nothing to close."""


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, OutOptions):
    """Compare networks that learn the cost-to-go, the distance to the goal and the goal's place, in validation houses.

    Attributes:
      steps: optimizer steps of each training.
      seeds: seeds of the trainings.
      extra_houses: procedural houses to train in besides the dataset's.
      starts_per_house: sampled starts in each of the dataset's validation houses.
      drawn: procedural validation houses, with two sampled starts in each.
    """

    steps: int = 1000
    seeds: tuple[int, ...] = (0, 1)
    extra_houses: int = 200
    starts_per_house: int = 20
    drawn: int = 100


def main(options: Options) -> None:
    """Train, judge and run; print and write the figures."""
    if min(options.starts_per_house, options.drawn) < 1 or not options.seeds:
        raise InputError("give --starts-per-house and --drawn of at least 1, and one of --seeds")
    dataset = open_dataset(options.dataset)
    out = output_folder(options, "goal_location", inputs=digests(dataset))
    judge, facts = Judge(dataset), dict[str, Any]()
    sources: dict[str, Estimator] = {"exact cost_to_go": ExactCostToGo(), "exact distance": ExactDistance()}
    masks = out / "masks.safetensors"
    for seed in options.seeds:
        for label in LABELS:
            name = f"{label} {seed}"
            folder, place = out / f"{label}_{seed}", label == "place"
            folder.mkdir()
            if masks.exists():
                shutil.copyfile(masks, folder / masks.name)
            architecture = Architecture(quantiles=(0.5,)) if place else Architecture()
            losses = (("experiments.studies.goal_location:place_loss", 1.0),) if place else TrainingConfig.losses
            curve = Curve(judge, label, architecture)
            network = train(
                folder,
                dataset,
                config=TrainingConfig(architecture, steps=options.steps, losses=losses, seed=seed),
                data=LabeledData(extra_houses=options.extra_houses, label=label),
                pauses=Pauses(validate_every=0, minutes_per_checkpoint=1.0),
                split=None,
                recording=functools.partial(lambda one: one, curve),
            ).network
            if not masks.exists():
                shutil.copyfile(folder / masks.name, masks)
            sources[name] = source = estimator_of(label, network)
            facts[name] = {"skill": judge.skill(label, network), "ranks": judge.ranks(source), "curve": curve.skills}
            facts[name] |= judge.place(source) if isinstance(source, ExpectedDistance) else {}
            print(name, {key: value if key == "curve" else round(value, 3) for key, value in facts[name].items()})
    planners = {"frontier": "frontier"} | {
        name: functools.partial(planner_with, "dc2g_paper", estimator=one) for name, one in sources.items()
    }
    own = usable_houses(dataset, "val")
    drawn = drawn_houses("v", "val", options.drawn, SEEDS["val"], own[0].terrain.shape[0])
    starts = sample_starts(own, options.starts_per_house, seed=0) + sample_starts(drawn, 2, seed=0)
    maps = HouseDataset("validation", "folder", (*own, *drawn))
    results = evaluate(planners, maps, split="val", starts=starts, progress=False)
    results.save(out / "episodes.csv")
    for group, houses in (("own", own), ("drawn", drawn)):
        names = {house.name for house in houses}
        some = Results(one for one in results if one.house in names)
        print(f"\n{group}: starts in {len(houses)} validation houses\n{some}")
        facts[group] = dict(some.summary())
        gains = {label: _gain(some, label, options.seeds) for label in LABELS[1:]}
        facts[group]["less cost_to_go"] = gains
        print(gains, flush=True)
    write_json(out / "results.json", facts)
    print_files(out)


def _gain(results: Results, label: str, seeds: tuple[int, ...]) -> dict[str, Any]:
    """Extra steps by a label less those by the cost-to-go, by start, means over seeds; and the houses' interval."""
    mine, theirs = (
        np.mean([results.array("extra")[f"{name} {seed}"] for seed in seeds], axis=0) for name in (label, "cost_to_go")
    )
    houses = [one.house for one in results.of(f"{label} {seeds[0]}")]
    return house_bootstrap(mine - theirs, houses, resamples=_RESAMPLES, seed=0)._asdict()


if __name__ == "__main__":
    command_line(Options, main)
