"""The training loop: from configurations, data and a step to networks on disk, for one run or several together."""

import contextlib
import dataclasses
import functools
import json
import math
import operator
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh
from tqdm import tqdm

from dc2g_jax._src.estimation.checkpoints import TrainingCheckpoints
from dc2g_jax._src.files.reading import number as as_number, opened, parse_json, read_lines, whole_number
from dc2g_jax._src.runtime.devices import (
    fetch,
    first_copy,
    in_any_process,
    mesh_for_batch,
    platform,
    replicate,
    reuse_memory,
    settle,
)
from dc2g_jax._src.runtime.errors import InputError, check_number
from dc2g_jax._src.training.step import Supervised, TrainingState, first_state, placed, stacked, supervised_step
from dc2g_jax._src.training.tracking import Curve, Image, TrackerName, run_folder

#: Most bytes of a line of the log.
_LONGEST_LINE = 2**20

#: Steps between pictures for a tracker, which also gets a picture at each validation.
_STEPS_PER_PICTURE = 500

#: Validations of a run, unless it is told how often.
_VALIDATIONS = 6

#: Fields of log lines that are not figures of the validation.
_NO_FIGURES = ("step", "run", "loss", "steps_left_out")


class Recording(Protocol):
    """Shows a training, see `viewer.training_recording.TrainingRecording`. It must not change the weights."""

    def look(self, step: int, figures: Mapping[str, float], weights: Any) -> None:
        """Show loss, learning rate and predictions; predictions alone, without figures, before the first step."""
        ...

    def validate(self, step: int, figures: Mapping[str, Any], weights: Any) -> None:
        """Show the results of a validation."""
        ...

    def close(self) -> None:
        """Called at the end."""
        ...


@dataclasses.dataclass(frozen=True)
class Task:
    """A training of one run, or of several together that only differ in their hyperparameters.

    Attributes:
      training: what is trained.
      data: what batches are drawn from.
      runs: the configuration of each run by its name, a dataclass that is saved, with an attribute `hyperparameters` if
        the runs have any. A training of one run calls it "", and stops if its loss is not finite; runs with names do
        not.
      steps: total number of optimizer steps.
      validate: `(weights, step) ->` figures of a run.
      save: `(folder, weights, facts)` saves the network of a run after each validation, with facts for its card.
      facts: a JSON object of anything else that must be the same to resume the runs.
      begin_with: weights to begin with; by default those of the training's first state.
      recording: shows a single run.
      picture: makes a picture of the predictions with a run's weights, for a tracker.
      name: title of the progress bar.
      steps_per_look: maximum number of steps between fetches of the losses, which wait for the device.
    """

    training: Supervised
    data: Any
    runs: Mapping[str, Any]
    steps: int
    validate: Callable[[Any, int], Mapping[str, Any]]
    save: Callable[[Path, Any, dict[str, Any]], object]
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    begin_with: Any = None
    recording: Recording | None = None
    picture: Callable[[Any], Image] | None = None
    name: str = "train"
    steps_per_look: int = 50


@dataclasses.dataclass(frozen=True)
class Pauses:
    """When to validate and to save.

    Attributes:
      validate_every: steps between validations; the last step is validated too. By default a sixth of the steps; 0 for
        none.
      minutes_per_checkpoint: minutes between checkpoints.
    """

    validate_every: int | None = None
    minutes_per_checkpoint: float = 2.0

    def check_pauses(self) -> None:
        """Check the numbers.

        Raises:
          InputError: one of them is negative or NaN.
        """
        if self.validate_every is not None:
            check_number("--validate-every", self.validate_every, whole=True, least=0, hint="(0 for none)")
        check_number("--minutes-per-checkpoint", self.minutes_per_checkpoint, least=0)

    def steps_between(self, steps: int) -> int:
        """Steps between the validations of a run of `steps`; 0 for none."""
        return -(-steps // _VALIDATIONS) if self.validate_every is None else self.validate_every

    def validates(self, step: int, steps: int) -> bool:
        """Whether there is a validation after `step` of `steps`."""
        every = self.steps_between(steps)
        return step == steps or (every > 0 and step > 0 and step % every == 0)


#: When a training validates and saves unless it is told.
PAUSES = Pauses()


def _together(runs: list[Any], mesh: Mesh) -> list[Any]:
    """Trees of runs that take their steps one after another; those of several on accelerators as one stack.

    The cores of a CPU are busy with one run, and convolutions over a stack of weights are slower there.
    """
    return [stacked(runs)] if len(runs) > 1 and platform(mesh) != "cpu" else runs


def _each_run(states: Sequence[Any], part: Callable[[Any], Any] = lambda state: state) -> list[Any]:
    if not states[0].step.ndim:
        return [first_copy(part(state)) for state in states]
    whole = jax.tree.map(fetch, part(states[0]))
    return [jax.tree.map(operator.itemgetter(run), whole) for run in range(len(jax.tree.leaves(whole)[0]))]


def steps_left_out(state: Any) -> int:
    """Number of skipped steps of a run, in which the loss or the weights would not have been finite."""
    counts = optax.tree_utils.tree_get_all_with_path(state.optimizer, "count")
    return int(state.step) - int(counts[0][1]) if counts else 0


class RunStates:
    """Training states on disk, those of each run in its own folder.

    Args:
      task: the runs.
      out: folder of the training.

    Raises:
      InputError: a folder holds a run of another configuration.
    """

    def __init__(self, task: Task, out: Path):
        begin = functools.partial(_begun, task)
        self._of_runs = [
            TrainingCheckpoints(run_folder(out, run), config, task.facts, first_state=begin)
            for run, config in task.runs.items()
        ]

    def restore(self) -> list[Any]:
        """The states of the newest step that all runs have, or the first ones if there is none."""
        common = set.intersection(*(set(checkpoints.steps()) for checkpoints in self._of_runs))
        if not common:
            for checkpoints in self._of_runs:
                checkpoints.delete()
        return [checkpoints.restore(max(common, default=None)) for checkpoints in self._of_runs]

    def save(self, states: Sequence[Any]) -> None:
        """Save the state of each run."""
        for checkpoints, state in zip(self._of_runs, states, strict=True):
            checkpoints.save(state)

    def close(self) -> None:
        """Release the folders."""
        for checkpoints in self._of_runs:
            checkpoints.close()


def _begun(task: Task, config: Any) -> TrainingState:
    """The state of a run before its first step."""
    state = first_state(_hyperparameters(config), training=task.training)
    if task.begin_with is None:
        return state
    fresh = [jax.tree.map(jnp.array, task.begin_with) for _ in range(2)]  # steps donate their buffers
    return dataclasses.replace(state, weights=fresh[0], average=None if state.average is None else fresh[1])


def _hyperparameters(config: Any) -> Any:
    return getattr(config, "hyperparameters", None)


class Log:
    """`log.jsonl`: one line per validation. A validation repeated after an interruption counts once.

    Args:
      out: folder of the training.
    """

    def __init__(self, out: Path):
        self._path = out / "log.jsonl"

    def write(self, *lines: Mapping[str, Any]) -> None:
        """Append validations. Each has a `step`, and a `run` if several are trained together."""
        cut_off = self._path.exists() and not self._path.read_bytes().endswith(b"\n")
        with self._path.open("a") as file:
            file.write("\n" * cut_off)
            file.writelines(json.dumps(line) + "\n" for line in lines)

    def by_step(self, run: str | None = None, figures: Collection[str] = ()) -> dict[int, dict[str, Any]]:
        """Validations by step, in order; those of `run` if several are trained together. Empty before the first.

        Lines that are not JSON are skipped: they were cut off when a process was killed, and their validation repeated.

        Args:
          run: name of the run; `None` or "" for the only one.
          figures: names of numbers that every line must have.

        Raises:
          InputError: the log cannot be read, or a line of it is no validation.
        """
        found: dict[int, dict[str, Any]] = {}
        if not self._path.exists():
            return found
        with opened(self._path, "give another folder") as file:
            for number, text in read_lines(file, self._path, at_most=_LONGEST_LINE):
                try:
                    line = parse_json(text)
                except ValueError:
                    continue
                try:
                    step = whole_number(line["step"])
                    own = not run or line["run"] == run
                    for name in figures:
                        as_number(line[name])
                except (LookupError, TypeError, ArithmeticError) as error:
                    raise InputError(
                        f"{self._path}: line {number} is no validation of this run ({error}); delete the line to "
                        "repeat it"
                    ) from None
                if own:
                    found[step] = line
        return dict(sorted(found.items()))


@contextlib.contextmanager
def _interrupts_noted() -> Iterator[list[int]]:
    """Defer the first Ctrl-C: a step donates its state, so an interrupted step would leave no state to save."""
    noted: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    if before in (signal.SIG_IGN, None) or threading.current_thread() is not threading.main_thread():
        yield noted  # never interrupted
        return

    def note(number: int, frame: object) -> None:
        noted.append(number)
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, before)


def _is_used_up(state: Any) -> bool:
    """Whether the state was donated to a step that did not finish."""
    return any(isinstance(leaf, jax.Array) and leaf.is_deleted() for leaf in jax.tree.leaves(state))


def _steps_to_next_stop(task: Task, pauses: Pauses, step: int) -> int:
    """Number of steps until the next fetch, validation or end."""
    waits = [task.steps - step, task.steps_per_look - step % task.steps_per_look]
    if every := pauses.steps_between(task.steps):
        waits.append(every - step % every)
    return min(waits)


def fit(task: Task, out: Path, pauses: Pauses, track: TrackerName | None = None) -> list[Any]:
    """Train to the end from the newest checkpoints, on all devices.

    Writes to the folder `log.jsonl` and `curve.csv`; and to that of each run its configuration, its checkpoints,
    regularly, at the end and at Ctrl-C, and what `task.save` writes.

    Args:
      task: the training task.
      out: folder of the training; each of several runs has its own in `runs`.
      pauses: when to validate and to save.
      track: tracker to send the curves to.

    Returns:
      The trained weights of each run.

    Raises:
      InputError: a folder holds a run of another configuration, the newest checkpoint is damaged, or the loss of a
        single run is not finite. Checkpoints are kept.
    """
    reuse_memory()
    alone, log, mesh = "" in task.runs, Log(out), mesh_for_batch(task.training.batch_size, len(task.runs))
    numbers = _together([_hyperparameters(config) for config in task.runs.values()], mesh)
    data, numbers = replicate((task.data, numbers), mesh)
    losses: np.ndarray | None = None  # means of each run since the last fetch
    saved, last_save = -1, time.monotonic()

    def take_steps(states: Sequence[Any], count: int) -> tuple[Sequence[Any], list[Any], bool]:
        """Take up to `count` steps; the states, the losses, and whether Ctrl-C was pressed."""
        taken: list[Any] = []
        several = jax.process_count() > 1  # all take the same steps
        with _interrupts_noted() as noted:
            while len(taken) < count and (several or not noted):
                each = zip(states, numbers, strict=True)
                step = functools.partial(supervised_step, data=data, training=task.training, mesh=mesh)
                states, of_step = zip(*(step(one, hyperparameters=own) for one, own in each), strict=True)
                settle(of_step)
                taken.append(of_step)
        return states, taken, bool(noted)

    def trained() -> list[Any]:
        return _each_run(states, lambda state: state.trained)

    def save_networks(weights: Sequence[Any], figures: Sequence[Mapping[str, Any]]) -> None:
        for run, one, of_run in zip(task.runs, weights, figures, strict=True):
            task.save(run_folder(out, run), one, {"steps": step, "validation": dict(of_run)})

    def validate() -> None:
        if pauses.steps_between(task.steps):
            bar.set_description("validate")
        each = _each_run(states)
        weights = [one.trained for one in each]
        figures = [task.validate(one, step) for one in weights]
        save_networks(weights, figures)
        lines, last = [], [None] * len(each) if losses is None else losses
        for run, one, loss, of_run in zip(task.runs, each, last, figures, strict=True):
            known = None if loss is None or not math.isfinite(loss) else float(f"{loss:.6g}")
            lines.append({**({"run": run} if run else {}), "step": step, "loss": known, **of_run})
            if not alone:
                lines[-1]["steps_left_out"] = steps_left_out(one)
        curve.add(step, figures, "validation/")
        log.write(*lines)  # last, since it tells that the validation is done
        if alone and figures[0]:
            tqdm.write(", ".join(f"{name} {value}" for name, value in lines[0].items()), file=sys.stderr)
        if task.recording is not None:
            task.recording.validate(step, figures[0], weights[0])
        bar.set_description(task.name)

    def look() -> None:
        figures: list[dict[str, float]] = [{} for _ in task.runs]
        if losses is not None:
            rates = [fetch(jnp.asarray(task.training.learning_rate(own)(step - 1))) for own in numbers]
            columns = np.broadcast_arrays(losses, np.hstack(rates))
            figures = [{"loss": loss, "learning_rate": rate} for loss, rate in np.transpose(columns).tolist()]
            curve.add(step, figures)
        if task.recording is not None:
            task.recording.look(step, figures[0], trained()[0])
        if track and task.picture and (step % _STEPS_PER_PICTURE == 0 or pauses.validates(step, task.steps)):
            # All processes make them, since they fetch the state together.
            curve.show(step, "cost-to-go", [task.picture(weights) for weights in trained()])

    def save() -> None:
        nonlocal saved, last_save
        with _interrupts_noted() as noted:  # an interrupted save would leave an incomplete state
            saved = step
            checkpoints.save(_each_run(states))
        last_save = time.monotonic()
        if noted:
            raise KeyboardInterrupt

    with (
        contextlib.closing(task.recording) if task.recording else contextlib.nullcontext(),
        contextlib.closing(RunStates(task, out)) as checkpoints,
        contextlib.closing(Curve(out, [*task.runs], track)) as curve,
    ):
        states: Sequence[Any] = [placed(one, mesh) for one in _together(checkpoints.restore(), mesh)]
        step = int(np.max(fetch(states[0].step)))
        with tqdm(total=task.steps, initial=step, desc=task.name, unit="step", file=sys.stderr) as bar:
            try:
                if pauses.validates(step, task.steps):
                    lines = [log.by_step(run).get(step) for run in task.runs]
                    if all(lines):  # the networks may be gone
                        known = [line.items() for line in lines if line]
                        save_networks(trained(), [{k: v for k, v in one if k not in _NO_FIGURES} for one in known])
                    else:
                        validate()
                if step < task.steps:
                    look()
                while step < task.steps:
                    count = _steps_to_next_stop(task, pauses, step)
                    states, taken, interrupted = take_steps(states, count)
                    if taken:
                        losses = np.mean([np.hstack(of_step) for of_step in taken], axis=0)
                        step += len(taken)
                        bar.set_postfix(loss=f"{np.mean(losses):.4f}", refresh=False)
                        bar.update(len(taken))
                        if alone and not np.isfinite(losses[0]):
                            raise InputError(
                                f"{out}: the loss is {losses[0]} at step {step}; lower --learning-rate and give "
                                "another --out (the last checkpoint before it is kept)"
                            )
                    if in_any_process(interrupted):
                        raise KeyboardInterrupt
                    look()
                    if pauses.validates(step, task.steps):
                        validate()
                    if in_any_process(time.monotonic() - last_save > 60 * pauses.minutes_per_checkpoint):
                        save()
                if saved != step:
                    save()
            except KeyboardInterrupt:
                # A second Ctrl-C may interrupt a step, which leaves no state to save.
                if saved != step and not _is_used_up(states):
                    save()
                raise
    return trained()
