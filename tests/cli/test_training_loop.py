"""The loop of the training commands: when it validates and saves, whatever interrupts it, and its log."""

import functools
import os
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.cli.training_loop import FiniteLoss, Log, check_pauses, run_steps
from dc2g_jax.errors import InputError


@functools.partial(jax.jit, donate_argnames=("state",))
def take_step(state):
    """A step that uses its state up, as those of training do."""
    return state + 1, state[0]


class Training:
    """A training that counts its steps, and notes what the loop does with it."""

    def __init__(self):
        self.validations: list[int] = []
        self.saved: list[int] = []
        self.interrupt_step, self.interrupt_validation, self.interrupts = -1, -1, 1

    def step(self, state):
        if int(state[0]) == self.interrupt_step:
            self.interrupt_step = -1
            done = take_step(state)
            for _ in range(self.interrupts):
                os.kill(os.getpid(), signal.SIGINT)
            return done
        return take_step(state)

    def validate(self, state, step):
        assert int(state[0]) == step
        if step == self.interrupt_validation:
            self.interrupt_validation = -1
            raise KeyboardInterrupt
        self.validations.append(step)

    def run(self, first_step=0, **changes):
        options = {
            "take_step": self.step,
            "look": lambda step, loss: None,
            "validate": self.validate,
            "validate_every": 10,
            "save": lambda state: self.saved.append(int(state[0])),
            "minutes_per_checkpoint": np.inf,
            "description": "test",
            "validated": self.validations,
            "steps_per_look": 4,
        }
        return run_steps(jnp.full(3, first_step), first_step, 25, **{**options, **changes})


@pytest.mark.parametrize(("validate_every", "wanted"), [(10, [10, 20, 25]), (0, [25]), (25, [25])])
def test_it_validates_now_and_then_and_in_the_end(validate_every, wanted):
    training = Training()
    assert int(training.run(validate_every=validate_every)[0]) == 25
    assert training.validations == wanted
    assert training.saved == [25]


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("step", [0, 5, 19, 24])
def test_an_interrupt_in_a_step_keeps_all_that_is_done(step):
    training = Training()
    training.interrupt_step = step
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        training.run()
    assert training.saved == [step + 1]  # the step that was under way is finished
    assert signal.getsignal(signal.SIGINT) is before
    training.run(step + 1)
    assert training.validations == [10, 20, 25]
    assert training.saved == [step + 1, 25]


@pytest.mark.usefixtures("interruptible")
def test_a_second_interrupt_breaks_a_step_off():
    training = Training()
    training.interrupt_step, training.interrupts = 5, 2
    with pytest.raises(KeyboardInterrupt):
        training.run()
    assert training.saved == []  # the step had used its state up


@pytest.mark.usefixtures("interruptible")
def test_what_diverged_before_an_interrupt_is_not_saved(tmp_path):
    training = Training()
    training.interrupt_step = 5
    look = FiniteLoss(tmp_path)
    with pytest.raises(InputError, match="the loss is nan at step 6; lower --learning-rate"):
        training.run(look=lambda step, loss: look(step, loss if step < 6 else np.float32(np.nan)))
    assert training.saved == []


def test_pauses_that_are_none_are_refused():
    with pytest.raises(InputError, match="--validate-every -1: give at least 1"):
        check_pauses(-1, 1.0)
    for minutes in (-0.5, np.nan):
        with pytest.raises(InputError, match=f"--minutes-per-checkpoint {minutes}: give a number from 0 on"):
            check_pauses(10, minutes)
    check_pauses(0, 0.0)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(("minutes", "saves", "kept"), [(0.0, 2, [4, 8]), (np.inf, 1, [25])])
def test_an_interrupt_while_saving_lets_it_finish(minutes, saves, kept):
    training = Training()

    def save(state):
        if len(training.saved) == saves - 1:
            os.kill(os.getpid(), signal.SIGINT)
        training.saved.append(int(state[0]))

    with pytest.raises(KeyboardInterrupt):
        training.run(save=save, minutes_per_checkpoint=minutes)
    assert training.saved == kept  # once each


@pytest.mark.usefixtures("interruptible")
def test_a_save_that_is_broken_off_is_not_begun_again():
    training = Training()

    def save(state):
        training.saved.append(int(state[0]))
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        training.run(save=save)
    assert training.saved == [25]


@pytest.mark.parametrize("step", [10, 20, 25])
def test_an_interrupted_validation_is_caught_up_with(step):
    training = Training()
    training.interrupt_validation = step
    with pytest.raises(KeyboardInterrupt):
        training.run()
    assert training.saved == [step]
    training.run(step)
    assert training.validations == [10, 20, 25]


def test_a_finished_training_does_nothing_more():
    training = Training()
    training.run()
    training.run(25)
    assert training.validations == [10, 20, 25]


def test_validations_made_again_count_once(tmp_path):
    log = Log(tmp_path)
    assert log.by_step() == {}
    log.write({"step": 20, "l1": 0.4}, {"step": 10, "l1": 0.5})
    log.write({"step": 20, "l1": 0.3})
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"step": 30, "l')
    log.write({"step": 30, "l1": 0.2})
    assert log.by_step().pop(30) == {"step": 30, "l1": 0.2}
    assert list(log.by_step().items())[:2] == [(10, {"step": 10, "l1": 0.5}), (20, {"step": 20, "l1": 0.3})]


def test_runs_trained_together_have_one_log(tmp_path):
    log = Log(tmp_path)
    log.write({"run": "a", "step": 10}, {"run": "b", "step": 10}, {"run": "a", "step": 20})
    assert list(log.by_step("a")) == [10, 20]
    assert list(log.by_step("b")) == [10]
    assert log.by_step("c") == {}
