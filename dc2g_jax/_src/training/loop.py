"""The training loop: steps, progress, late fetching of losses, validations and their log, curves, checkpoints."""

import contextlib
import dataclasses
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import jax
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float
from tqdm import tqdm

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.files.reading import number as as_number, opened, parse_json, read_lines, whole_number
from dc2g_jax._src.rollouts.devices import fetch, in_any_process, settle
from dc2g_jax._src.training.tracking import Curve, Image, TrackerName

_State = TypeVar("_State")

#: Most bytes of a line of the log.
_LONGEST_LINE = 2**20

#: Steps between pictures for a tracker, which also gets a picture at each validation.
_STEPS_PER_PICTURE = 500

#: Fields of log lines that are not validation figures.
_NO_VALIDATION = ("step", "run", "loss")

#: Mean losses of the steps since the last fetch: a scalar for a single run, one per run for several.
Losses = Float[np.ndarray, "*runs"]


@dataclasses.dataclass(frozen=True)
class Task(Generic[_State]):
    """A training task. Its state has an attribute `step`, the number of optimizer steps.

    Attributes:
      steps: total number of optimizer steps.
      step: `state ->` new state and loss. The old state may be donated. A single run, whose loss is a scalar, stops if
        its loss is not finite; runs trained together have one loss each and continue.
      validate: `(state, step, losses) ->` lines of the log, one per run. Called at validations and after the last step;
        it also saves the network and its card. The losses are `None` before they are first fetched.
      validated: steps that earlier runs validated. A missing validation of the current step is made up for.
      watch: called as `watch(state, step, losses)` after each fetch, and once before the first step. It must not change
        the state.
      place: puts a state on the devices of the task.
      name: title of the progress bar.
      steps_per_look: maximum number of steps between fetches of the losses, which wait for the device.
      runs: names of the runs trained together; empty for a single one.
      learning_rate: called as `learning_rate(step)`; the learning rate of a step, from 1, or that of each run.
      pictures: makes a picture of predictions for a tracker, one per run.
    """

    steps: int
    step: Callable[[_State], tuple[_State, Array]]
    validate: Callable[[_State, int, Losses | None], Sequence[Mapping[str, Any]]]
    validated: Collection[int] = ()
    watch: Callable[[_State, int, Losses | None], None] = lambda state, step, losses: None
    place: Callable[[_State], _State] = lambda state: state
    name: str = "train"
    steps_per_look: int = 50
    runs: Sequence[str] = ()
    learning_rate: Callable[[int], npt.ArrayLike] | None = None
    pictures: Callable[[_State], Sequence[Image]] | None = None

    def figures(self, step: int, losses: Losses) -> list[dict[str, float]]:
        """Loss and learning rate of a step, for each run."""
        columns = {"loss": losses} | ({"learning_rate": self.learning_rate(step)} if self.learning_rate else {})
        each = {name: np.broadcast_to(values, max(1, len(self.runs))).tolist() for name, values in columns.items()}
        return [dict(zip(each, values, strict=True)) for values in zip(*each.values(), strict=True)]


@dataclasses.dataclass(frozen=True)
class Pauses:
    """When to validate and to save.

    Attributes:
      validate_every: steps between validations; the last step is validated too. 0 for none.
      minutes_per_checkpoint: minutes between checkpoints.
    """

    validate_every: int
    minutes_per_checkpoint: float = 5.0

    def check_pauses(self) -> None:
        """Check the numbers.

        Raises:
          InputError: one of them is negative or NaN.
        """
        if self.validate_every < 0:
            raise InputError(f"--validate-every {self.validate_every}: give at least 1, or 0 for none")
        if not self.minutes_per_checkpoint >= 0:
            raise InputError(f"--minutes-per-checkpoint {self.minutes_per_checkpoint}: give a number from 0 on")

    def validates(self, step: int, steps: int) -> bool:
        """Whether there is a validation after `step` of `steps`."""
        return step == steps or (self.validate_every > 0 and step > 0 and step % self.validate_every == 0)


class Checkpoints(Protocol):
    """Storage of training states, see `estimation.checkpoints.TrainingCheckpoints`."""

    def restore(self) -> Any:
        """The newest state, or the first if none is saved."""
        ...

    def save(self, state: Any) -> None:
        """Save a state."""
        ...

    def close(self) -> None:
        """Release the folder."""
        ...


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
          run: name of the run; `None` for the only one.
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
                    own = run is None or line["run"] == run
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


def _take_steps(
    state: _State, count: int, take_step: Callable[[_State], tuple[_State, Array]]
) -> tuple[_State, list[Array], bool]:
    """Take up to `count` steps. Returns the state, the losses, and whether Ctrl-C was pressed."""
    losses: list[Array] = []
    several = jax.process_count() > 1  # all take the same steps
    with _interrupts_noted() as noted:
        while len(losses) < count and (several or not noted):
            state, loss = take_step(state)
            settle(loss)
            losses.append(loss)
    return state, losses, bool(noted)


def _is_used_up(state: Any) -> bool:
    """Whether the state was donated to a step that did not finish."""
    return any(isinstance(leaf, jax.Array) and leaf.is_deleted() for leaf in jax.tree.leaves(state))


def _steps_to_next_stop(task: Task[Any], pauses: Pauses, step: int) -> int:
    """Number of steps until the next fetch, validation or end."""
    waits = [task.steps - step, task.steps_per_look - step % task.steps_per_look]
    if pauses.validate_every:
        waits.append(pauses.validate_every - step % pauses.validate_every)
    return min(waits)


def _check_finite(losses: Losses, step: int, out: Path) -> None:
    """Stop a single run whose loss is not finite.

    Raises:
      InputError: it is not.
    """
    if losses.ndim == 0 and not np.isfinite(losses):
        raise InputError(
            f"{out}: the loss is {losses} at step {step}; lower --learning-rate and give another --out (the last "
            "checkpoint before it is kept)"
        )


def fit(
    task: Task[_State], out: Path, checkpoints: Checkpoints, pauses: Pauses, track: TrackerName | None = None
) -> _State:
    """Train to the end from the newest checkpoint. Saves checkpoints regularly, at the end, and at Ctrl-C.

    Args:
      task: the training task.
      out: folder of the log and the curves.
      checkpoints: storage of the states; closed at the end.
      pauses: when to validate and to save.
      track: tracker to send the curves to.

    Returns:
      The last state.

    Raises:
      InputError: the newest checkpoint is damaged, or the loss of a single run is not finite. Checkpoints are kept.
    """
    losses: Losses | None = None
    saved, last_save = -1, time.monotonic()

    def validate() -> None:
        bar.set_description("validate")
        lines = task.validate(state, step, losses)
        Log(out).write(*lines)
        if lines:
            figures = [{name: line[name] for name in line if name not in _NO_VALIDATION} for line in lines]
            curve.add(step, figures, "validation/")
        if len(lines) == 1:
            tqdm.write(json.dumps(lines[0]), file=sys.stderr)
        bar.set_description(task.name)

    def look() -> None:
        task.watch(state, step, losses)
        if losses is not None:
            curve.add(step, task.figures(step, losses))
        if track and task.pictures and (step % _STEPS_PER_PICTURE == 0 or pauses.validates(step, task.steps)):
            # All processes make them, since they fetch the state together.
            curve.show(step, "cost-to-go", task.pictures(state))

    def save() -> None:
        nonlocal saved, last_save
        with _interrupts_noted() as noted:  # an interrupted save would leave an incomplete state
            saved = step
            checkpoints.save(state)
        last_save = time.monotonic()
        if noted:
            raise KeyboardInterrupt

    with contextlib.closing(checkpoints), contextlib.closing(Curve(out, task.runs, track)) as curve:
        state: Any = task.place(checkpoints.restore())
        step = int(np.max(fetch(state.step)))
        with tqdm(total=task.steps, initial=step, desc=task.name, unit="step", file=sys.stderr) as bar:
            try:
                if step not in task.validated and pauses.validates(step, task.steps):
                    validate()
                if step < task.steps:
                    look()
                while step < task.steps:
                    count = _steps_to_next_stop(task, pauses, step)
                    state, each, interrupted = _take_steps(state, count, task.step)
                    if each:
                        losses = np.asarray(np.mean([np.asarray(loss) for loss in each], axis=0))
                        step += len(each)
                        bar.set_postfix(loss=f"{np.mean(losses):.4f}", refresh=False)
                        bar.update(len(each))
                        _check_finite(losses, step, out)
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
                if saved != step and not _is_used_up(state):
                    save()
                raise
    return state
