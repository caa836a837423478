"""The loop of training: when it validates and saves, whatever interrupts it, and its log."""

import itertools
import os
import signal
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training import loop
from dc2g_jax._src.training.loop import Log, Pauses, Task, fit
from tests.support.refusals import refusal
from tests.support.trainings import Count, Counting, count_step


class Training:
    """A training that counts its steps, and notes what the loop does with it. It keeps its states as well."""

    def __init__(self, out: Path, patch: pytest.MonkeyPatch):
        self.out = out
        self.saved: list[int] = []
        self.interrupt_step, self.interrupt_validation, self.interrupts = -1, -1, 1
        patch.setattr(loop, "RunStates", lambda task, out: self)
        patch.setattr(loop, "supervised_step", lambda state, **options: self.take(state))
        self.take = self.step

    @property
    def validations(self) -> list[int]:
        return list(Log(self.out).by_step())

    def step(self, state):
        if int(jnp.copy(np.max(state.step))) == self.interrupt_step:  # with a view, jax 0.11 would not use the state up
            self.interrupt_step = -1
            done = count_step(state)
            for _ in range(self.interrupts):
                os.kill(os.getpid(), signal.SIGINT)
            return done
        return count_step(state)

    def validate(self, weights, step):
        assert int(weights) == step
        if step == self.interrupt_validation:
            self.interrupt_validation = -1
            raise KeyboardInterrupt
        return {}

    def restore(self):
        return [Count(jnp.int32(self.first_step)) for _ in self.runs]

    def save(self, states):
        self.saved.append(int(states[0].step))

    def close(self):
        pass

    def run(self, first_step=0, validate_every=10, minutes=np.inf, runs=("",), **changes):
        self.first_step, self.runs = first_step, runs
        task = Task(
            Counting(), None, dict.fromkeys(runs), 25, **{"validate": self.validate, **changes},
            save=lambda folder, weights, facts: None, name="test", steps_per_look=4,
        )  # fmt: skip
        return fit(task, self.out, Pauses(validate_every, minutes))


@pytest.fixture
def training(tmp_path, monkeypatch) -> Training:
    return Training(tmp_path, monkeypatch)


@pytest.mark.parametrize(("validate_every", "wanted"), [(10, [10, 20, 25]), (0, [25]), (25, [25])])
def test_it_validates_now_and_then_and_in_the_end(training, validate_every, wanted):
    assert training.run(validate_every=validate_every) == [25]
    assert training.validations == wanted
    assert training.saved == [25]


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("step", [0, 5, 19, 24])
def test_an_interrupt_in_a_step_keeps_all_that_is_done(training, step):
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
def test_a_second_interrupt_breaks_a_step_off(training):
    training.interrupt_step, training.interrupts = 5, 2
    with pytest.raises(KeyboardInterrupt):
        training.run()
    assert training.saved == []  # the step had used its state up


@pytest.mark.usefixtures("interruptible")
def test_what_diverged_before_an_interrupt_is_not_saved(training):
    training.interrupt_step = 5

    def step(state):
        new, loss = training.step(state)
        return new, jnp.where(new.step < 6, loss, jnp.nan)

    training.take = step
    with pytest.raises(InputError, match="the loss is nan at step 6; lower --learning-rate"):
        training.run()
    assert training.saved == []


def test_runs_with_names_go_on_when_one_diverges(training):
    numbers = itertools.cycle([1.0, jnp.nan])  # on a CPU, runs take their steps one after another

    def step(state):
        new, loss = training.step(state)
        return new, loss * next(numbers)

    training.take = step
    assert training.run(runs=("a", "b"), validate=lambda weights, step: {"error": 1.0}) == [25, 25]
    assert training.saved == [25]
    lines = [Log(training.out).by_step(run) for run in ("a", "b")]
    assert [line["loss"] for line in lines[0].values()] == [8.5, 17.5, 24.0]  # means of the steps since the last fetch
    assert [line["loss"] for line in lines[1].values()] == [None] * 3


def test_losses_are_shown_before_the_first_step_and_after_each_fetch(training):
    class Shown:
        looked, validated, close = [], [], lambda self: None

        def look(self, step, figures, weights):
            self.looked.append((step, figures))

        def validate(self, step, figures, weights):
            self.validated.append(step)

    training.run(recording=Shown())
    assert Shown.looked[:2] == [(0, {}), (4, {"loss": 1.5, "learning_rate": pytest.approx(0.4)})]
    assert Shown.validated == [10, 20, 25]


@pytest.mark.parametrize(
    ("pauses", "words"),
    [
        (Pauses(-1, 1.0), "--validate-every -1: give a whole number of at least 0"),
        (Pauses(10, -0.5), "--minutes-per-checkpoint -0.5: give a number of at least 0"),
        (Pauses(10, np.nan), "--minutes-per-checkpoint nan: give a number of at least 0"),
    ],
)
def test_pauses_that_are_none_are_refused(pauses, words):
    refusal(pauses.check_pauses, words)


@pytest.mark.parametrize("steps", [1, 5, 20, 100, 48_000])
def test_a_training_validates_five_times_unless_told_otherwise(steps):
    validations = sum(Pauses().validates(step, steps) for step in range(1, steps + 1))
    assert validations == min(steps, 6) or validations == 5


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(("minutes", "saves", "kept"), [(0.0, 2, [4, 8]), (np.inf, 1, [25])])
def test_an_interrupt_while_saving_lets_it_finish(training, monkeypatch, minutes, saves, kept):

    def save(states):
        if len(training.saved) == saves - 1:
            os.kill(os.getpid(), signal.SIGINT)
        training.saved.append(int(states[0].step))

    monkeypatch.setattr(training, "save", save)
    with pytest.raises(KeyboardInterrupt):
        training.run(minutes=minutes)
    assert training.saved == kept  # once each


@pytest.mark.usefixtures("interruptible")
def test_a_save_that_is_broken_off_is_not_begun_again(training, monkeypatch):

    def save(states):
        training.saved.append(int(states[0].step))
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(training, "save", save)
    with pytest.raises(KeyboardInterrupt):
        training.run()
    assert training.saved == [25]


@pytest.mark.parametrize("step", [10, 20, 25])
def test_an_interrupted_validation_is_caught_up_with(training, step):
    training.interrupt_validation = step
    with pytest.raises(KeyboardInterrupt):
        training.run()
    assert training.saved == [step]
    training.run(step)
    assert training.validations == [10, 20, 25]


def test_a_finished_training_does_nothing_more(training):
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


@pytest.mark.parametrize(
    "line", ["[1]", "3", "null", '{"l1": 0.3}', '{"step": "10", "l1": 0.3}', '{"step": 1.5, "l1": 0.3}', '{"step": 20}']
)
def test_a_line_that_is_no_validation_is_named(tmp_path, line):
    log = Log(tmp_path)
    log.write({"step": 10, "l1": 0.5})
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write(line)
    refusal(lambda: log.by_step(None, ("l1",)), tmp_path / "log.jsonl", "line 2 is no validation", "delete the line")


@pytest.mark.parametrize("line", [b"\xff\xfe", bytes(99), b"[" * 100_000, b"9" * 5000, b'{"step": 20, "l'])
def test_a_line_that_is_not_json_is_a_validation_to_repeat(tmp_path, line):
    log = Log(tmp_path)
    log.write({"step": 10})
    with (tmp_path / "log.jsonl").open("ab") as file:
        file.write(line)
    log.write({"step": 30})
    assert list(log.by_step()) == [10, 30]


def test_runs_trained_together_have_one_log(tmp_path):
    log = Log(tmp_path)
    log.write({"run": "a", "step": 10}, {"run": "b", "step": 10}, {"run": "a", "step": 20})
    assert list(log.by_step("a")) == [10, 20]
    assert list(log.by_step("b")) == [10]
    assert log.by_step("c") == {}
