"""Curves of a training: the table, and what trackers get."""

import csv
import itertools
import struct
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training import loop
from dc2g_jax._src.training.loop import Pauses, Task, fit
from dc2g_jax._src.training.tracking import Curve, check_tracker
from tests.support.trainings import Count, Counting, count_step

PICTURE = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "curve.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def events(folder: Path) -> dict[tuple[str, int], object]:
    """Values in TensorBoard's event files, by name and step, each of which there is once."""
    event_pb2 = pytest.importorskip("tensorboardX.proto.event_pb2")
    found: dict[tuple[str, int], object] = {}
    for path in sorted(folder.glob("events.*")):
        data = path.read_bytes()
        while len(data) > 12:
            (length,) = struct.unpack("<Q", data[:8])
            if len(data) < 16 + length:
                break  # it is being written
            event = event_pb2.Event.FromString(data[12 : 12 + length])
            data = data[16 + length :]
            for value in event.summary.value:
                shown = (
                    value.simple_value if value.HasField("simple_value") else (value.image.height, value.image.width)
                )
                assert (value.tag, event.step) not in found
                found[value.tag, event.step] = shown
    return found


class Checkpoints:
    """Keeps the last state in memory."""

    step, runs = 0, 1

    def restore(self):
        return [Count(jnp.int32(self.step)) for _ in range(self.runs)]

    def save(self, states):
        self.step = int(states[0].step)

    def close(self):
        pass


@pytest.fixture
def trained(monkeypatch):
    """A training of 10 steps, with a look every 2, a validation every 5, and losses that are steps before it."""

    def train(out: Path, checkpoints: Checkpoints, fail_at: int | None = None, track=None, runs=("",)) -> None:
        signs = itertools.cycle([1, -1][: len(runs)])  # on a CPU, runs take their steps one after another

        def step(state, **options):
            if int(np.max(state.step)) == fail_at:
                raise RuntimeError("killed")
            state, loss = count_step(state)
            return state, loss * next(signs)

        checkpoints.runs = len(runs)
        monkeypatch.setattr(loop, "RunStates", lambda task, out: checkpoints)
        monkeypatch.setattr(loop, "supervised_step", step)
        task = Task(
            Counting(), None, dict.fromkeys(runs), 10, lambda weights, step: {"error": step / 4},
            lambda folder, weights, facts: None, steps_per_look=2, picture=lambda weights: PICTURE,
        )  # fmt: skip
        fit(task, out, Pauses(5, 0.0), track)

    return train


WHOLE = [
    {"step": "2", "loss": "0.5", "learning_rate": "0.2", "error": ""},
    {"step": "4", "loss": "2.5", "learning_rate": "0.4", "error": ""},
    {"step": "5", "loss": "4.0", "learning_rate": "0.5", "error": "1.25"},
    {"step": "6", "loss": "5.0", "learning_rate": "0.6", "error": ""},
    {"step": "8", "loss": "6.5", "learning_rate": "0.8", "error": ""},
    {"step": "10", "loss": "8.5", "learning_rate": "1.0", "error": "2.5"},
]


def test_the_table_has_every_look_and_every_validation(tmp_path, trained):
    trained(tmp_path, Checkpoints())
    assert rows(tmp_path) == WHOLE


@pytest.mark.parametrize("fail_at", [3, 7, 9])
@pytest.mark.parametrize("lost", [False, True])
def test_a_training_that_was_killed_goes_on_in_the_table_and_in_tensorboard(tmp_path, trained, fail_at, lost):
    checkpoints = Checkpoints()
    with pytest.raises(RuntimeError, match="killed"):
        trained(tmp_path, checkpoints, fail_at, "tensorboard")
    if lost:  # the last state was not saved, and steps are taken again
        checkpoints.step = 2
    trained(tmp_path, checkpoints, track="tensorboard")
    assert rows(tmp_path) == WHOLE
    shown = events(tmp_path / "tensorboard")
    assert {key: value for key, value in shown.items() if key[0] == "loss"} == {
        ("loss", int(row["step"])): float(row["loss"]) for row in WHOLE
    }
    assert (shown["validation/error", 5], shown["validation/error", 10]) == (1.25, 2.5)
    assert shown["learning_rate", 8] == pytest.approx(0.8)
    assert shown["cost-to-go", 10] == PICTURE.shape[:2]


def test_tensorboard_has_a_point_soon_whatever_becomes_of_the_process(tmp_path):
    curve = Curve(tmp_path, track="tensorboard")
    for step in (2, 4):
        curve.add(step, [{"loss": 0.5}])
        deadline = time.monotonic() + 20
        while ("loss", step) not in events(tmp_path / "tensorboard") and time.monotonic() < deadline:
            time.sleep(0.1)
        assert events(tmp_path / "tensorboard")["loss", step] == 0.5
    curve.close()


def test_runs_trained_together_have_rows_and_a_tracker_each(tmp_path, trained):
    trained(tmp_path, Checkpoints(), track="tensorboard", runs=("a", "b"))
    own = {run: [row for row in rows(tmp_path) if row.pop("run") == run] for run in ("a",)}
    assert own["a"] == WHOLE
    assert events(tmp_path / "tensorboard" / "a")["loss", 10] == 8.5
    assert events(tmp_path / "tensorboard" / "b")["loss", 10] == -8.5
    curve = Curve(tmp_path, ("c",))  # the next runs of a sweep
    curve.add(2, [{"loss": 1.0, "error": None}])
    assert [row["run"] for row in rows(tmp_path)] == ["a", "b"] * 6 + ["c"]


def test_a_table_that_is_none_is_refused(tmp_path):
    (tmp_path / "curve.csv").write_text("step,loss\n1,2\nfew,3\n")
    with pytest.raises(InputError, match=r"curve\.csv: line 3 has no step; delete the line"):
        Curve(tmp_path)


@pytest.mark.parametrize(("name", "package"), [("tensorboard", "tensorboardX"), ("wandb", "wandb")])
def test_a_package_that_is_missing_is_named_with_its_extra(monkeypatch, name, package):
    monkeypatch.setattr("importlib.util.find_spec", lambda module: None)
    with pytest.raises(InputError, match=rf'{package}: not installed; run: pip install "dc2g_jax\[{name}\]"'):
        check_tracker(name)
    check_tracker(None)


def test_wandb_takes_a_training_without_a_network(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    record_pb2 = pytest.importorskip("wandb.proto.wandb_internal_pb2")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    checkpoints = Checkpoints()
    with pytest.raises(RuntimeError, match="killed"):
        trained(tmp_path, checkpoints, 7, "wandb")
    time.sleep(1)  # wandb names the folder of a run by the second
    trained(tmp_path, checkpoints, track="wandb")
    losses, ids = {}, set()
    for path in tmp_path.glob("wandb/offline-run-*/*.wandb"):
        data = path.read_bytes()[7:]
        assert len(data) < 2**15  # one block
        while data:
            _, length, kind = struct.unpack("<IHB", data[:7])
            assert kind == 1  # a whole record
            record, data = record_pb2.Record.FromString(data[7 : 7 + length]), data[7 + length :]
            ids |= {record.run.run_id} - {""}
            items = {[item.key, *item.nested_key][-1]: item.value_json for item in record.history.item}
            if "loss" in items:
                losses[int(items["_step"])] = float(items["loss"])
    assert losses == {int(row["step"]): float(row["loss"]) for row in WHOLE}
    assert ids == {(tmp_path / "wandb" / "run.id").read_text()}


def test_trackio_takes_runs_that_are_trained_together(tmp_path, monkeypatch):
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    storage = pytest.importorskip("trackio.sqlite_storage").SQLiteStorage
    trained(tmp_path, Checkpoints(), track="trackio", runs=("a", "b"))
    for run, sign in (("a", 1), ("b", -1)):
        name = f"{run}-{(tmp_path / 'trackio' / f'{run}.id').read_text()}"
        logs = storage.get_logs("dc2g_jax", name)
        assert {log["step"]: log["loss"] for log in logs if "loss" in log} == {
            int(row["step"]): sign * float(row["loss"]) for row in WHOLE
        }
