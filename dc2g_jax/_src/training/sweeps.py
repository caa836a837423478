"""Training of several runs together that only differ in hyperparameters."""

import dataclasses
import functools
import itertools
import operator
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.checkpoints import TrainingCheckpoints
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.programs import jit
from dc2g_jax._src.rollouts.devices import fetch
from dc2g_jax._src.training.cost_to_go import Hyperparameters, TrainingConfig, mean_error
from dc2g_jax._src.training.losses import parse_losses
from dc2g_jax._src.training.pairs import Pair
from dc2g_jax._src.training.step import TrainingState, stacked

_Run = TypeVar("_Run")

#: Batch size of validation pairs.
_PAIRS_AT_A_TIME = 64


def runs_of_grid(
    base: TrainingConfig,
    *,
    losses: Sequence[str],
    learning_rates: Sequence[float],
    widths: Sequence[Sequence[int]],
    seeds: Sequence[int],
) -> dict[str, TrainingConfig]:
    """All combinations of the values, by a descriptive name.

    Args:
      base: all other parameters.
      losses: see `training.losses.parse_losses`.
      learning_rates: peak learning rates.
      widths: channels of the network at its scales.
      seeds: seeds of weights and batches.

    Raises:
      InputError: there is no value of a parameter, or a value is invalid.
    """
    for name, values in (("loss", losses), ("learning rate", learning_rates), ("widths", widths), ("seed", seeds)):
        if not values:
            raise InputError(f"{name}: no value to try; give one at least")
        if len({str(value) for value in values}) < len(values):
            raise InputError(f"{name}: {', '.join(map(str, values))} has a value twice; give each once")
    runs: dict[str, TrainingConfig] = {}
    for width, loss, rate, seed in itertools.product(widths, losses, learning_rates, seeds):
        name = f"{loss}_rate{float(rate)!r}_width{'-'.join(map(str, width))}_seed{seed}"
        name = name.replace(",", "+").replace(":", ".")  # a folder's
        run = dataclasses.replace(
            base,
            architecture=dataclasses.replace(base.architecture, widths=tuple(width)),
            losses=parse_losses(loss),
            learning_rate=float(rate),
            seed=seed,
        )
        if run in runs.values():
            raise InputError(f"loss: {', '.join(losses)} names the same loss twice; give each once")
        runs[name] = run
    return runs


def group_by_shape(runs: Mapping[str, TrainingConfig]) -> list[dict[str, TrainingConfig]]:
    """Group runs whose networks have the same shape, so that they can be trained together.

    All runs of a group get the same losses; those that a run does not use have weight 0. Groups are in the order of
    their first runs.
    """
    names = list(dict.fromkeys(name for config in runs.values() for name, _ in config.losses))
    groups: dict[TrainingConfig, dict[str, TrainingConfig]] = {}
    for run, config in runs.items():
        weights = dict(config.losses)
        whole = dataclasses.replace(config, losses=tuple((name, weights.get(name, 0.0)) for name in names))
        groups.setdefault(whole.recipe, {})[run] = whole
    return list(groups.values())


def in_turns(runs: Mapping[str, _Run], at_once: int) -> list[dict[str, _Run]]:
    """Split runs, in order, into groups of at most `at_once`.

    Raises:
      InputError: `at_once` is less than 1.
    """
    if at_once < 1:
        raise InputError(f"--runs-at-once {at_once}: give at least 1")
    names = list(runs)
    turns = [names[first : first + at_once] for first in range(0, len(names), at_once)]
    return [{name: runs[name] for name in turn} for turn in turns]


def stacked_hyperparameters(configs: Sequence[TrainingConfig]) -> Hyperparameters:
    """The stacked hyperparameters of all runs of a group."""
    return stacked([config.hyperparameters for config in configs])


def fetched_runs(states: Any) -> list[Any]:
    """The tree of each of several stacked runs, as NumPy arrays."""
    whole = jax.tree.map(fetch, states)
    return [jax.tree.map(operator.itemgetter(run), whole) for run in range(len(jax.tree.leaves(whole)[0]))]


@dataclasses.dataclass(frozen=True)
class StackedCheckpoints:
    """Stacked states of several runs, each saved in its own folder.

    Attributes:
      of_runs: checkpoints of each run, in the order of the stack.
    """

    of_runs: Sequence[TrainingCheckpoints]

    def restore(self) -> TrainingState:
        """The stacked states of the newest step that all runs have, or the first if there is none."""
        common = set.intersection(*(set(checkpoints.steps()) for checkpoints in self.of_runs))
        if not common:
            for checkpoints in self.of_runs:
                checkpoints.delete()
        return stacked([checkpoints.restore(max(common, default=None)) for checkpoints in self.of_runs])

    def save(self, states: TrainingState) -> None:
        """Save the state of each run."""
        for checkpoints, state in zip(self.of_runs, fetched_runs(states), strict=True):
            checkpoints.save(state)

    def close(self) -> None:
        """Release the folders."""
        for checkpoints in self.of_runs:
            checkpoints.close()


def steps_left_out(states: TrainingState) -> Int[Array, "runs"]:
    """Number of skipped steps of each run, in which the loss or the weights would not have been finite."""
    (_, taken), *_ = optax.tree_utils.tree_get_all_with_path(states.optimizer, "count")
    return states.step - taken


@functools.partial(jit, static_argnames=("architecture",))
def validation_errors(architecture: Architecture, weights: Any, pairs: Pair) -> Float[Array, "runs"]:
    """Mean error of each run on all pairs, whose number is a multiple of 64, in cells."""
    chunks = jax.tree.map(lambda leaf: leaf.reshape(-1, _PAIRS_AT_A_TIME, *leaf.shape[1:]), pairs)

    def error(weights: Any) -> Float[Array, ""]:
        return jnp.mean(jax.lax.map(lambda chunk: mean_error(architecture, weights, chunk), chunks))

    return jax.lax.map(error, weights)
