"""Sweeps: networks with many losses, learning rates, widths and seeds, trained together where shapes allow."""

import collections
import dataclasses
import functools
import itertools
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from dc2g_jax._src.estimation.compact_unet import multiply_accumulates
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.cache import keep_compiled_programs
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.files.tables import write_table
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.rollouts.evaluation import evaluate
from dc2g_jax._src.runtime.errors import InputError, check_number, short
from dc2g_jax._src.training.cost_to_go import TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import VALIDATION_PAIRS, DataConfig, open_training_set, validation_pairs
from dc2g_jax._src.training.loop import PAUSES, Log, Pauses
from dc2g_jax._src.training.losses import LOSSES, Loss, checked_loss, losses_as_text, parse_losses
from dc2g_jax._src.training.tracking import TrackerName
from dc2g_jax._src.training.train import Picture, Plan, checked, error_on, finished_network, train_runs

#: Losses by name or as weighted sums, see `parse_losses`; functions, perhaps with names; or functions and sums by name.
LossSources = Iterable[str | Loss | tuple[str, Loss]] | Mapping[str, str | Loss]

#: A sweep by default: a short training of each run.
SWEEP = TrainingConfig(steps=2000)

#: Names of losses of the user's own: they are parts of folders' names.
_NAME = re.compile(r"[A-Za-z_][\w.-]*")


@dataclasses.dataclass(frozen=True)
class Sweep:
    """What `sweep` gives. `print(sweep)` shows the losses side by side, with mean and deviation over seeds.

    Attributes:
      table: a row for each run: its name, `loss`, `learning_rate`, `widths`, `seed`, `error` on validation pairs in
        cells, number of `steps_left_out` because the loss was not finite, and, with a split, `mean_extra` steps of
        planner `dc2g` in percent.
      steps: steps of the validations.
      curves: error of each run, in the order of the table, at each validation, in cells.
      networks: the network of each run by name.
      data: description of the data.
    """

    table: tuple[Mapping[str, Any], ...]
    steps: Int[np.ndarray, "validations"]
    curves: Float[np.ndarray, "runs validations"]
    networks: Mapping[str, NetworkCostToGo]
    data: str

    def kinds(self) -> dict[str, list[int]]:
        """Indices of the runs that only differ in the seed, by what they have in common; the best kind first."""
        varied = [name for name in ("learning_rate", "widths") if len({row[name] for row in self.table}) > 1]
        kinds: dict[str, list[int]] = collections.defaultdict(list)
        for number, row in enumerate(self.table):
            more = [f"{name.replace('_', ' ')} {row[name]}" for name in varied]
            kinds[", ".join([row["loss"], *more])].append(number)

        def order(kind: str) -> tuple[bool, float]:
            rows = [self.table[number] for number in kinds[kind]]
            return any(row["steps_left_out"] for row in rows), float(np.mean([_quality(row) for row in rows]))

        return {kind: kinds[kind] for kind in sorted(kinds, key=order)}

    def __str__(self) -> str:
        """The table by loss."""
        figures = {"error": "error (cells)", "mean_extra": "extra steps (%)"}
        shown = [name for name in figures if name in self.table[0]]
        width = max(len("loss"), *map(len, self.kinds()))
        lines = [f"{'loss':{width}}  runs" + "".join(f"{figures[name]:>20}" for name in shown)]
        for kind, numbers in self.kinds().items():
            rows = [self.table[number] for number in numbers]
            line = f"{kind:{width}}{len(rows):>6}"
            for name in shown:
                values = [row[name] for row in rows]
                deviation = f" ± {np.std(values, ddof=1):.2f}" if len(rows) > 1 else ""
                line += f"{f'{np.mean(values):.2f}{deviation}':>20}"
            diverged = sum(row["steps_left_out"] > 0 for row in rows)
            lines.append(line + f"   {diverged} diverged: the loss of some steps was not finite" * (diverged > 0))
        return "\n".join(lines)


def _quality(row: Mapping[str, Any]) -> float:
    """What runs are ordered by, the lower the better."""
    return row.get("mean_extra", row["error"])


def named_losses(losses: Any) -> tuple[dict[str, tuple[tuple[str, float], ...]], dict[str, Loss]]:
    """Losses with weights by what they are called; and the functions of the user's own by name.

    Raises:
      InputError: a loss is unknown, has no name, or is given twice.
    """
    sums: dict[str, tuple[tuple[str, float], ...]] = {}
    own: dict[str, Loss] = {}
    losses = [losses] if isinstance(losses, str) else losses
    given: list[Any] = [*(losses.items() if isinstance(losses, Mapping) else losses)]
    for source in given:
        name, loss = source if isinstance(source, tuple) else (source, source)
        if callable(name):
            name = getattr(name, "__name__", "")
        if isinstance(loss, str):
            parsed = parse_losses(loss)
        elif callable(loss):
            if not isinstance(name, str) or not _NAME.fullmatch(name) or name in LOSSES:
                raise InputError(
                    f"loss {short(name)}: give a function of your own another name, such as losses={{'mine': function}}"
                )
            parsed, own[name] = ((name, 1.0),), checked_loss(name, loss)
        else:
            raise InputError(f"loss {short(loss)}: give a name, a weighted sum such as 'l1=1,log=0.5', or a function")
        if name in sums or parsed in sums.values():
            raise InputError(f"loss: {short(name)} is given twice; give each once")
        sums[name] = parsed
    return sums, own


def runs_of_grid(
    base: TrainingConfig,
    *,
    losses: Mapping[str, tuple[tuple[str, float], ...]],
    learning_rates: Sequence[float],
    widths: Sequence[Sequence[int]],
    seeds: Sequence[int],
) -> dict[str, TrainingConfig]:
    """All combinations of the values, by a descriptive name.

    Args:
      base: all other parameters.
      losses: losses with weights, by what they are called.
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
        name = re.sub(r"[,\s]+", "+", name).replace(":", ".").replace("/", ".")  # a folder's
        architecture = dataclasses.replace(base.architecture, widths=tuple(width))
        runs[name] = dataclasses.replace(
            base, architecture=architecture, losses=losses[loss], learning_rate=float(rate), seed=seed
        )
    return runs


def group_by_shape(runs: Mapping[str, TrainingConfig], at_once: int) -> list[dict[str, TrainingConfig]]:
    """Group runs whose networks have the same shape, so that they can be trained together, at most `at_once` of them.

    All runs of a group get the same losses; those that a run does not use have weight 0. Groups are in the order of
    their first runs.

    Raises:
      InputError: `at_once` is less than 1.
    """
    check_number("--runs-at-once", at_once, whole=True, least=1)
    names = list(dict.fromkeys(name for config in runs.values() for name, _ in config.losses))
    groups: dict[TrainingConfig, dict[str, TrainingConfig]] = {}
    for run, config in runs.items():
        weights = dict(config.losses)
        whole = dataclasses.replace(config, losses=tuple((name, weights.get(name, 0.0)) for name in names))
        groups.setdefault(whole.recipe, {})[run] = whole
    return [
        dict(itertools.islice(group.items(), first, first + at_once))
        for group in groups.values()
        for first in range(0, len(group), at_once)
    ]


def sweep(
    out: str | os.PathLike[str],
    dataset: HouseDataset | str | os.PathLike[str] | None = None,
    *,
    losses: LossSources = tuple(LOSSES),
    seeds: Sequence[int] = (0, 1, 2),
    learning_rates: Sequence[float] | None = None,
    widths: Sequence[Sequence[int]] | None = None,
    config: TrainingConfig = SWEEP,
    data: DataConfig | None = None,
    pauses: Pauses = PAUSES,
    split: str | None = "val",
    runs_at_once: int = 64,
    track: TrackerName | None = None,
    picture: Picture | None = None,
    card: Mapping[str, Any] | None = None,
    begin: Callable[[], object] | None = None,
) -> Sweep:
    """Train a network with every combination of losses, learning rates, widths and seeds, and compare them.

    Runs whose networks have the same shape are one program. Masks, checkpoints, curves, networks and `results.csv` are
    written to the folder; a sweep that stopped goes on from its last checkpoints.

    ```
    def relative(estimate, target, levels):
        return jnp.abs(estimate - target) / (1 + target)

    sweep = dc2g_jax.sweep("outputs/sweep", "procedural", losses=["quantile", "l1", relative], seeds=[0, 1, 2])
    print(sweep)
    dc2g_jax.plot_sweep(sweep, "outputs/sweep/sweep")
    ```

    Args:
      out: folder of the sweep.
      dataset: see `train`.
      losses: names in `dc2g_jax.training.LOSSES`, `package.module:Name`, weighted sums of them such as
        `quantile=1,log=0.5`, and functions `(estimate, target, levels) -> loss`, see `dc2g_jax.training.Loss`; or a
        mapping from names of your choice to them.
      seeds: seeds of weights and batches.
      learning_rates: peak learning rates; that of `config` by default.
      widths: channels of the network at its scales, from the finest; those of `config` by default.
      config: everything else: steps, batch size, architecture.
      data: see `train`.
      pauses: see `train`; there is always a validation after the last step.
      split: split of the houses to run planner `dc2g` in with every network at the end, ten starts in each; `None` for
        no episodes.
      runs_at_once: largest number of runs to train together; best a multiple of the number of devices.
      track: see `train`.
      picture: see `train`.
      card: see `train`.
      begin: see `train`.

    Raises:
      InputError: a value is invalid, the dataset cannot be trained on, or the folder holds a sweep with other settings.
    """
    keep_compiled_programs()
    out = Path(out)
    sums, own_losses = named_losses(losses)
    runs = runs_of_grid(
        config,
        losses=sums,
        learning_rates=learning_rates or (config.learning_rate,),
        widths=widths or (config.architecture.widths,),
        seeds=seeds,
    )
    grouped = group_by_shape(runs, runs_at_once)
    plan = checked(
        dataset, {run: one for turn in grouped for run, one in turn.items()}, data=data, pauses=pauses, split=split,
        track=track, validated=True, own_losses=own_losses, at_once=runs_at_once,
    )  # fmt: skip
    turns = [plan._replace(runs={run: plan.runs[run] for run in turn}) for turn in grouped]
    if begin is not None:
        begin()
    # Pairs first: they raise for unsuitable houses before minutes of data collection.
    opened = functools.cache(
        lambda: (
            validation_pairs(plan.dataset, edge_weight=plan.data.edge_weight),
            open_training_set(out, plan.dataset, plan.data),
        )
    )
    networks: dict[str, NetworkCostToGo] = {}

    def validate(network: NetworkCostToGo, step: int) -> dict[str, float]:
        return {"error": error_on(opened()[0], network)}

    for turn in turns:
        found: Sequence[NetworkCostToGo | None] = [finished_network(out, turn, run) for run in turn.runs]
        if None in found:
            found = train_runs(
                out, turn, opened()[1], validate, card=card, picture=picture, name=f"{len(turn.runs)} runs"
            )
        networks |= {run: network for run, network in zip(turn.runs, found, strict=True) if network is not None}
    extra = {} if split is None else _episodes(out, plan.dataset, split, networks)
    result = _result(out, plan, networks, extra)
    rows = sorted(result.table, key=lambda row: (row["steps_left_out"] > 0, _quality(row)))
    write_table(out / "results.csv", list(rows[0]), (list(row.values()) for row in rows))
    return result


def _episodes(
    out: Path, dataset: HouseDataset, split: str, networks: Mapping[str, NetworkCostToGo]
) -> dict[str, dict[str, float]]:
    """Extra steps in the houses of a split with each network. Results are saved in a file and reused."""
    path = out / "episodes.json"
    remedy = "delete it to run its episodes anew"
    found: dict[str, Any] = read_object(path, remedy) if path.exists() else {}
    for run, network in tqdm(networks.items(), desc="episodes", unit="run", file=sys.stderr):
        if not isinstance(found.get(run, {}), dict):
            raise InputError(f"{path}: {run} has {short(found[run])}, no figures; {remedy}")
        if run not in found:
            summary = evaluate(["dc2g"], dataset, split=split, network=network, progress=False).summary()["dc2g"]
            found[run] = {name: round(summary[name], 2) for name in ("mean_extra", "median_extra")}
            write_json(path, found)
    return found


def _result(
    out: Path, plan: Plan, networks: Mapping[str, NetworkCostToGo], extra: Mapping[str, Mapping[str, float]]
) -> Sweep:
    """The result of a sweep, from its log. Multiply-accumulates are for one map of the dataset."""
    logs = {run: Log(out).by_step(run, ("error", "steps_left_out")) for run in plan.runs}
    architectures = dict.fromkeys(config.architecture for config in plan.runs.values())
    macs = {one: multiply_accumulates(one, *plan.dataset.houses[0].terrain.shape) for one in architectures}
    table = tuple(
        {
            "run": run,
            "loss": losses_as_text(config.losses),
            "learning_rate": config.learning_rate,
            "widths": "-".join(map(str, config.architecture.widths)),
            "million_multiply_accumulates": round(1e-6 * macs[config.architecture], 2),
            "seed": config.seed,
            "steps": config.steps,
            "steps_left_out": logs[run][config.steps]["steps_left_out"],
            "error": logs[run][config.steps]["error"],
            **extra.get(run, {}),
        }
        for run, config in plan.runs.items()
    )
    steps = np.array(sorted(set.intersection(*(set(log) for log in logs.values()))))
    curves = np.array([[log[step]["error"] for step in steps] for log in logs.values()])
    return Sweep(table, steps, curves, networks, f"{plan.dataset.name}; errors on {VALIDATION_PAIRS} validation pairs")
