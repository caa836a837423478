"""The loop of every training: steps, progress, losses looked at late, validations and their log, checkpoints."""

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
from jaxtyping import Array, Float
from tqdm import tqdm

from dc2g_jax.errors import InputError
from dc2g_jax.rollouts.devices import fetch, in_any_process

_State = TypeVar("_State")

#: Mean losses of the steps since the last look: one of a single run, one for each of several trained together.
Losses = Float[np.ndarray, "*runs"]


@dataclasses.dataclass(frozen=True)
class Task(Generic[_State]):
    """What is trained. A state has a `step`, the number of optimizer steps behind it.

    Attributes:
      steps: optimizer steps in all.
      init: makes the state before the first step.
      step: `state ->` new state and loss; the old state may be used up. A single run, whose loss is a scalar, stops
        where the loss is not finite; runs trained together have a loss each and go on.
      validate: `(state, step, losses) ->` lines of the log, one for each run; called now and then and after the last
        step, to save the network as it is with its card. The losses are `None` before the first look at them.
      validated: steps that were validated by earlier runs; one that was interrupted there catches up.
      watch: called as `watch(state, step, losses)` after each look, and once before the first step; must leave the
        state as it is.
      name: what the progress bar says.
      steps_per_look: steps between two looks at the losses, at most: looking waits for the device.
    """

    steps: int
    init: Callable[[], _State]
    step: Callable[[_State], tuple[_State, Array]]
    validate: Callable[[_State, int, Losses | None], Sequence[Mapping[str, Any]]]
    validated: Collection[int] = ()
    watch: Callable[[_State, int, Losses | None], None] = lambda state, step, losses: None
    name: str = "train"
    steps_per_look: int = 50


@dataclasses.dataclass(frozen=True)
class Pauses:
    """When training pauses.

    Attributes:
      validate_every: steps between validations; 0 for the last step only.
      minutes_per_checkpoint: how often to save.

    Raises:
      InputError: if one of them is less than 0, or not a number.
    """

    validate_every: int
    minutes_per_checkpoint: float

    def __post_init__(self) -> None:
        if self.validate_every < 0:
            raise InputError(f"--validate-every {self.validate_every}: give at least 1, or 0 for none")
        if not self.minutes_per_checkpoint >= 0:
            raise InputError(f"--minutes-per-checkpoint {self.minutes_per_checkpoint}: give a number from 0 on")

    def validates(self, step: int, steps: int) -> bool:
        """Is there a validation after this step of so many?"""
        return step == steps or (self.validate_every > 0 and step > 0 and step % self.validate_every == 0)


class Checkpoints(Protocol):
    """Where states are kept, see `dc2g_jax.estimation.checkpoints.TrainingCheckpoints`."""

    def restore(self) -> Any:
        """The newest state; `None` if there is none."""
        ...

    def save(self, state: Any) -> None:
        """Save a state."""
        ...

    def close(self) -> None:
        """Release the folder."""
        ...


class Log:
    """`log.jsonl`: a line for each validation. One made again after an interruption counts once.

    Args:
      out: folder of the training.
    """

    def __init__(self, out: Path):
        self._path = out / "log.jsonl"

    def write(self, *lines: Mapping[str, Any]) -> None:
        """Add validations; each has a `step`, and a `run` where several are trained together."""
        cut_off = self._path.exists() and not self._path.read_bytes().endswith(b"\n")
        with self._path.open("a") as file:
            file.write("\n" * cut_off)
            file.writelines(json.dumps(line) + "\n" for line in lines)

    def by_step(self, run: str | None = None) -> dict[int, dict[str, Any]]:
        """Validations by step, in order; of one run where several are trained together. None before the first."""
        found: dict[int, dict[str, Any]] = {}
        for text in self._path.read_text().splitlines() if self._path.exists() else ():
            with contextlib.suppress(json.JSONDecodeError):  # a line that a kill cut off
                line = json.loads(text)
                if run is None or line["run"] == run:
                    found[line["step"]] = line
        return dict(sorted(found.items()))


@contextlib.contextmanager
def _interrupts_noted() -> Iterator[list[int]]:
    """Note the first Ctrl-C instead of raising: a step uses its state up, so one broken off leaves none to save."""
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
    """So many steps: the state after them, their losses, and whether Ctrl-C made them fewer."""
    losses: list[Array] = []
    several = jax.process_count() > 1  # all take the same steps
    with _interrupts_noted() as noted:
        while len(losses) < count and (several or not noted):
            state, loss = take_step(state)
            losses.append(loss)
    return state, losses, bool(noted)


def _is_used_up(state: Any) -> bool:
    """Has a step been given the state, and not brought back a new one?"""
    return any(isinstance(leaf, jax.Array) and leaf.is_deleted() for leaf in jax.tree.leaves(state))


def _steps_to_next_stop(task: Task[Any], pauses: Pauses, step: int) -> int:
    """Steps until something is to be done next."""
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


def train(task: Task[_State], out: Path, checkpoints: Checkpoints, pauses: Pauses) -> _State:
    """Train to the end from the newest checkpoint on, saving now and then, at the end, and at Ctrl-C.

    Args:
      task: what is trained.
      out: folder of the log.
      checkpoints: where states are kept; closed in the end.
      pauses: when to validate and to save.

    Returns:
      The last state.

    Raises:
      InputError: the newest checkpoint is damaged, or the loss of a single run is not finite; checkpoints stay.
    """
    losses: Losses | None = None
    saved, last_save = -1, time.monotonic()

    def validate() -> None:
        bar.set_description("validate")
        lines = task.validate(state, step, losses)
        Log(out).write(*lines)
        if len(lines) == 1:
            tqdm.write(json.dumps(lines[0]), file=sys.stderr)
        bar.set_description(task.name)

    def save() -> None:
        nonlocal saved, last_save
        with _interrupts_noted() as noted:  # a save broken off would leave a part of a state
            saved = step
            checkpoints.save(state)
        last_save = time.monotonic()
        if noted:
            raise KeyboardInterrupt

    with contextlib.closing(checkpoints):
        state: Any = checkpoints.restore()
        if state is None:
            state = task.init()
        step = int(np.max(fetch(state.step)))
        with tqdm(total=task.steps, initial=step, desc=task.name, unit="step", file=sys.stderr) as bar:
            try:
                if step not in task.validated and pauses.validates(step, task.steps):
                    validate()
                if step < task.steps:
                    task.watch(state, step, None)
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
                    task.watch(state, step, losses)
                    if pauses.validates(step, task.steps):
                        validate()
                    if in_any_process(time.monotonic() - last_save > 60 * pauses.minutes_per_checkpoint):
                        save()
                if saved != step:
                    save()
            except KeyboardInterrupt:
                # The state is used up when a second Ctrl-C breaks a step off.
                if saved != step and not _is_used_up(state):
                    save()
                raise
    return state
