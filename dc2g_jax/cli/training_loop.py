"""The loop that all training commands share: steps, progress, losses looked at late, checkpoints, and the log."""

import contextlib
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from dc2g_jax.errors import InputError

State = TypeVar("State")


class FiniteLoss:
    """Remembers the latest loss of a single run, and stops training where it is no number.

    Attributes:
      latest: mean loss when it was last looked at; `None` before.
    """

    def __init__(self, out: Path):
        self.latest: float | None = None
        self._out = out

    def __call__(self, step: int, loss: Any) -> None:
        """Look at a loss.

        Raises:
          InputError: if it is not finite.
        """
        self.latest = float(loss)
        if not np.isfinite(self.latest):
            raise InputError(
                f"{self._out}: the loss is {self.latest} at step {step}; lower --learning-rate and give another --out "
                "(the last checkpoint before it is kept)"
            )


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
    state: State, count: int, take_step: Callable[[State], tuple[State, Array]]
) -> tuple[State, list[Array], bool]:
    """So many steps: the state after them, their losses, and whether Ctrl-C made them fewer."""
    losses: list[Array] = []
    with _interrupts_noted() as noted:
        while len(losses) < count and not noted:
            state, loss = take_step(state)
            losses.append(loss)
    return state, losses, bool(noted)


def _is_used_up(state: Any) -> bool:
    """Has a step been given the state, and not brought back a new one?"""
    return any(isinstance(leaf, jax.Array) and leaf.is_deleted() for leaf in jax.tree.leaves(state))


def _next_stop(step: int, steps: int, validate_every: int, steps_per_look: int) -> int:
    """The step after which something is to be done next."""
    stops = [steps, step + steps_per_look - step % steps_per_look]
    if validate_every:
        stops.append(step + validate_every - step % validate_every)
    return min(stops)


def _is_validated(step: int, steps: int, validate_every: int) -> bool:
    """Is there a validation after this step?"""
    return step == steps or (validate_every > 0 and step > 0 and step % validate_every == 0)


def check_pauses(validate_every: int, minutes_per_checkpoint: float) -> None:
    """Refuse a number of steps between validations, or of minutes between checkpoints, that is none.

    Raises:
      InputError: if one of them is less than 0, or not a number.
    """
    if validate_every < 0:
        raise InputError(f"--validate-every {validate_every}: give at least 1, or 0 for none")
    if not minutes_per_checkpoint >= 0:
        raise InputError(f"--minutes-per-checkpoint {minutes_per_checkpoint}: give a number from 0 on")


def run_steps(
    state: State,
    first_step: int,
    steps: int,
    *,
    take_step: Callable[[State], tuple[State, Array]],
    look: Callable[[int, Float[np.ndarray, "*runs"]], None],
    validate: Callable[[State, int], None],
    validate_every: int,
    save: Callable[[State], None],
    minutes_per_checkpoint: float,
    description: str,
    validated: Collection[int] = (),
    steps_per_look: int = 50,
    watch: Callable[[State, int, Float[np.ndarray, "*runs"]], None] = lambda state, step, loss: None,
) -> State:
    """Train to the end, saving now and then, at the end, and at Ctrl-C.

    Args:
      state: where to go on.
      first_step: steps that the state has behind it.
      steps: steps in all.
      take_step: `state ->` new state and loss; the old state may be used up.
      look: called as `look(step, mean losses since the last look)`; raises where training must not go on, and what was
        saved before stays.
      validate: called as `validate(state, step)` now and then and after the last step.
      validate_every: steps between validations; 0 for the last step only.
      save: keeps a state.
      minutes_per_checkpoint: how often to save.
      description: what the progress bar says.
      validated: steps that were validated by earlier runs; one that was interrupted there catches up.
      steps_per_look: steps between two looks at the losses, at most: looking waits for the device.
      watch: called as `watch(state, step, mean losses)` after each look; must leave the state as it is.

    Returns:
      The last state.
    """
    step, begun_saving, last_save = first_step, -1, time.monotonic()
    with tqdm(total=steps, initial=step, desc=description, unit="step", file=sys.stderr) as bar:

        def validate_now() -> None:
            bar.set_description("validate")
            validate(state, step)
            bar.set_description(description)

        def save_now() -> None:
            nonlocal begun_saving, last_save
            with _interrupts_noted() as noted:  # a save broken off would leave a part of a state
                begun_saving = step
                save(state)
            last_save = time.monotonic()
            if noted:
                raise KeyboardInterrupt

        try:
            if step not in validated and _is_validated(step, steps, validate_every):
                validate_now()
            while step < steps:
                count = _next_stop(step, steps, validate_every, steps_per_look) - step
                state, losses, interrupted = _take_steps(state, count, take_step)
                if losses:
                    mean = np.mean([np.asarray(loss) for loss in losses], axis=0)
                    step += len(losses)
                    bar.set_postfix(loss=f"{np.mean(mean):.4f}", refresh=False)
                    bar.update(len(losses))
                    look(step, mean)
                if interrupted:
                    raise KeyboardInterrupt
                watch(state, step, mean)
                if _is_validated(step, steps, validate_every):
                    validate_now()
                if time.monotonic() - last_save > 60 * minutes_per_checkpoint:
                    save_now()
            if begun_saving != step:
                save_now()
        except KeyboardInterrupt:
            # The state is used up when a second Ctrl-C breaks a step off.
            if begun_saving != step and not _is_used_up(state):
                save_now()
            raise
    return state
