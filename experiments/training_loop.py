"""The loop that all training commands share: steps, progress, losses looked at late, checkpoints now and then."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from dc2g_jax.errors import InputError

State = TypeVar("State")


class FiniteLoss:
    """Remembers the latest loss of a single run, and stops training where it is no number.

    Attributes:
      latest: mean loss when it was last looked at.
    """

    def __init__(self, out: Path):
        self.latest = float("nan")
        self._out = out

    def __call__(self, step: int, loss: Float[np.ndarray, ""]) -> None:
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


def _next_stop(step: int, steps: int, validate_every: int, steps_per_look: int) -> int:
    """The step after which something is to be done next."""
    stops = [steps, step + steps_per_look - step % steps_per_look]
    if validate_every:
        stops.append(step + validate_every - step % validate_every)
    return min(stops)


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
      steps_per_look: steps between two looks at the losses, at most: looking waits for the device.
      watch: called as `watch(state, step, mean losses)` after each look; must leave the state as it is.

    Returns:
      The last state.
    """
    step, saved = first_step, time.monotonic()
    with tqdm(total=steps, initial=step, desc=description, unit="step", file=sys.stderr) as bar:
        try:
            while step < steps:
                losses: list[Any] = []
                for _ in range(_next_stop(step, steps, validate_every, steps_per_look) - step):
                    state, loss = take_step(state)
                    losses.append(loss)
                mean = np.mean([np.asarray(loss) for loss in losses], axis=0)
                step += len(losses)
                bar.update(len(losses))
                bar.set_postfix(loss=f"{np.mean(mean):.4f}")
                look(step, mean)
                watch(state, step, mean)
                if step == steps or (validate_every and step % validate_every == 0):
                    validate(state, step)
                if time.monotonic() - saved > 60 * minutes_per_checkpoint:
                    save(state)
                    saved = time.monotonic()
        except KeyboardInterrupt:
            save(state)
            raise
    save(state)
    return state
