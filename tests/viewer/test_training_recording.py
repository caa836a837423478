"""A training recording holds what the network said, survives being killed, and leaves training alone."""

import dataclasses
import math
import shutil
import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.cli.commands.train import Options, shown_by
from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.terrain import FIGURE_RGB, TRAVERSABLE
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training.cost_to_go import CostToGoTraining, TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.loop import Pauses, Task, fit
from dc2g_jax._src.training.pairs import Pair, TrainingSet
from dc2g_jax._src.viewer import legend
from dc2g_jax._src.viewer.legend import CostScale
from dc2g_jax._src.viewer.training_recording import TrainingRecording, maps_to_watch, next_file, prediction_picture
from tests.support.recordings import read
from tests.support.trainings import DRAW_PAIRS

_CONFIG = TrainingConfig(architecture=Architecture(widths=(4, 4, 4, 4)), steps=6, batch_size=2)
_SHAPE = (3, 8, 10)


def _maps() -> Pair:
    """Three small maps of random classes, the first column of each not observed."""
    rng = np.random.default_rng(0)
    terrain = rng.integers(1, 16, _SHAPE).astype(np.uint8)
    terrain[:, :, 0] = 0
    counts = TRAVERSABLE[terrain]
    target = np.where(counts, rng.integers(0, 60, _SHAPE), np.inf).astype(np.float32)
    return Pair(terrain=terrain, target=target, weight=counts.astype(np.float32))


def _network(seed: int) -> NetworkCostToGo:
    weights = compact_unet.init_weights(_CONFIG.architecture, jax.random.key(seed))
    return NetworkCostToGo(weights=weights, architecture=_CONFIG.architecture)


def _recording(folder, maps: Pair) -> TrainingRecording:
    return TrainingRecording(folder, _CONFIG, maps, file=next_file(folder), viewer=None)


def _shown(image, maps: Pair) -> np.ndarray:
    """The maps of a row, cut out of the image in the file."""
    count, height, width = maps.terrain.shape
    row = np.asarray(image[0], np.uint8).reshape(height, -1)
    assert row.shape[1] == count * (width + 2) - 2
    return np.stack([row[:, start : start + width] for start in range(0, row.shape[1], width + 2)])


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A run of three looks and one validation."""
    folder = tmp_path_factory.mktemp("run")
    recording = _recording(folder, _maps())
    recording.look(0, {}, _network(0).weights)
    recording.look(2, {"loss": 0.5, "learning_rate": 0.01}, _network(1).weights)
    recording.look(4, {"loss": 0.25, "learning_rate": 0.02}, _network(1).weights)
    recording.validate(4, {"error": 3.5, "own_mean_extra": 12.5, "own_median_extra": 7.0}, _network(2).weights)
    recording.close()
    return read(folder / "training-001.rrd")


def test_learning_rates_are_those_of_warm_up_and_cosine_decay():
    config = TrainingConfig(steps=50, learning_rate=0.004)
    warm_up = [0.004 * step / 5 for step in range(5)]
    decay = [0.004 * (1 + math.cos(math.pi * step / 45)) / 2 for step in range(45)]
    schedule = CostToGoTraining(config.recipe, DRAW_PAIRS).learning_rate(config.hyperparameters)
    np.testing.assert_allclose([schedule(step) for step in range(50)], warm_up + decay, rtol=1e-5, atol=1e-9)


def test_curves_are_what_was_logged(logged):
    assert logged["/loss", "Scalars:scalars"] == {2: [0.5], 4: [0.25]}
    assert logged["/learning_rate", "Scalars:scalars"] == {2: [0.01], 4: [0.02]}
    assert logged["/validation/error/error", "Scalars:scalars"] == {4: [3.5]}
    assert logged["/validation/mean/own_mean_extra", "Scalars:scalars"] == {4: [12.5]}
    assert logged["/validation/mean/own_mean_extra", "SeriesLines:names"] == {None: ["own mean extra"]}
    assert logged["/validation/median/own_median_extra", "Scalars:scalars"] == {4: [7.0]}


def test_predictions_are_those_of_the_network(logged):
    maps = _maps()
    counts = maps.weight > 0
    scale = CostScale.of(maps.target)
    np.testing.assert_array_equal(_shown(logged["/maps/known", "SegmentationImage:buffer"][None], maps), maps.terrain)
    exact = _shown(logged["/maps/exact", "SegmentationImage:buffer"][None], maps)
    np.testing.assert_array_equal(exact[counts] - legend.FIRST_COST, maps.target[counts])
    assert np.all(exact[~counts] == legend.NOT_SHOWN)
    for step, seed in ((0, 0), (4, 2)):
        outcomes = compact_unet.apply(_CONFIG.architecture, _network(seed).weights, jnp.asarray(maps.terrain))
        expected = np.asarray(outcomes).mean(axis=-1)
        predicted = _shown(logged["/maps/predicted", "SegmentationImage:buffer"][step], maps)
        np.testing.assert_array_equal(predicted, scale.classes(expected, counts))
        difference = _shown(logged["/maps/difference", "SegmentationImage:buffer"][step], maps)
        off = np.clip(expected - maps.target, -40, 40)[counts]
        np.testing.assert_allclose(difference[counts] - 128.0, off, atol=0.501)
        assert np.all(difference[~counts] == legend.NOT_SHOWN)
        error = np.abs(expected - maps.target)[counts].mean()
        assert logged["/error", "Scalars:scalars"][step] == [pytest.approx(error, rel=1e-5)]
    # Looks soon after a prediction make none; a validation always does.
    assert sorted(logged["/maps/predicted", "SegmentationImage:buffer"]) == [0, 4]


def test_a_picture_shows_the_maps_and_their_costs_in_the_colors_of_the_viewer():
    maps, network = _maps(), _network(1)
    picture = prediction_picture(network, maps)
    count, height, width = maps.terrain.shape
    assert picture.shape == (3 * (18 + 3 * height), 3 * (count * (width + 2) - 2), 3)
    rows = picture.reshape(3, 18 + 3 * height, -1, 3)
    assert all((row[:18] == 0).any() and (row[:18] == 255).mean() > 0.5 for row in rows)  # names
    known, _, exact = rows[:, 18::3, ::3][:, :, :width]
    np.testing.assert_array_equal(known, FIGURE_RGB[maps.terrain[0]])
    counts, scale = maps.weight[0] > 0, CostScale.of(maps.target)
    np.testing.assert_array_equal(exact, scale.colors()[scale.classes(maps.target[0], counts)])
    assert len(np.unique(exact[counts], axis=0)) > 10
    other = prediction_picture(network, dataclasses.replace(maps, target=maps.target + 5)).reshape(rows.shape)
    assert np.any(prediction_picture(_network(2), maps).reshape(rows.shape)[1] != rows[1])
    assert np.any(other[2] != rows[2])


def test_differences_are_named_and_signed():
    shown = np.array([[True, True, True, False]])
    classes = legend.difference_classes(np.array([[-100.0, 0.4, 3.0, 5.0]]), shown)
    assert classes.tolist() == [[88, 128, 131, legend.NOT_SHOWN]]


def test_a_run_that_is_taken_up_again_overwrites_nothing(tmp_path):
    for number in (1, 2):
        assert next_file(tmp_path) == tmp_path / f"training-{number:03d}.rrd"
        recording = _recording(tmp_path, _maps())
        recording.look(number, {"loss": 1.0}, _network(0).weights)
        recording.close()
    chunks = pytest.importorskip("rerun.chunk")
    files = [chunks.RrdReader(tmp_path / f"training-{number:03d}.rrd") for number in (1, 2)]
    # Files of one folder are one recording, each with the first view in it.
    assert len({reader.recordings()[0].recording_id for reader in files}) == 1
    assert all(len(reader.blueprints()) == 1 for reader in files)
    assert [list(read(tmp_path / f"training-{n:03d}.rrd")["/loss", "Scalars:scalars"]) for n in (1, 2)] == [[1], [2]]


def test_a_file_that_cannot_be_written_and_an_address_that_is_none_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file/x\.rrd: cannot be written"):
        TrainingRecording(tmp_path, _CONFIG, _maps(), file=tmp_path / "file" / "x.rrd", viewer=None)
    with pytest.raises(InputError, match=r"garbage: is no address of a viewer .* give rerun\+http://127"):
        TrainingRecording(tmp_path, _CONFIG, _maps(), file=None, viewer="garbage")


def test_what_was_logged_is_readable_before_the_recording_is_closed(tmp_path):
    """A process that is killed leaves the file as it is at that moment."""
    recording = _recording(tmp_path, _maps())
    for step in range(1, 7):
        recording.look(step, {"loss": 1 / step}, _network(0).weights)
        time.sleep(0.1)
    left = tmp_path / "left.rrd"

    def steps_left() -> list[int]:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "RRD file has no footer")
            shutil.copy(tmp_path / "training-001.rrd", left)
            return sorted(read(left).get(("/loss", "Scalars:scalars"), {}))

    deadline = time.monotonic() + 30
    while steps_left() != [1, 2, 3, 4, 5, 6] and time.monotonic() < deadline:
        time.sleep(0.1)
    assert steps_left() == [1, 2, 3, 4, 5, 6]
    recording.close()


def test_training_is_the_same_with_and_without_a_recording(tmp_path):
    terrain = np.random.default_rng(1).integers(1, 16, (2, 16, 16)).astype(np.uint8)
    data = TrainingSet(
        terrain=jnp.asarray(terrain),
        cost_to_go=jnp.where(TRAVERSABLE[terrain], 5.0, jnp.inf),
        masks=jax.vmap(bitboard.pack)(jnp.ones((2, 16, 16), bool)),
        mask_world=jnp.arange(2),
        n_own=jnp.int32(2),
    )
    training = CostToGoTraining(_CONFIG.recipe, DataConfig(extra_houses=0).draw_batch)

    def trained(name, recording=None):
        task = Task(
            training, data, {"": _CONFIG}, _CONFIG.steps, validate=lambda weights, step: {"mean_extra": 1.0},
            save=lambda folder, weights, facts: None, recording=recording, steps_per_look=1,
        )  # fmt: skip
        return fit(task, tmp_path / name, Pauses(2, 1.0))

    recorded = trained("recorded", _recording(tmp_path, _maps()))
    jax.tree.map(np.testing.assert_array_equal, recorded, trained("plain"))
    assert sorted(read(tmp_path / "training-001.rrd")["/loss", "Scalars:scalars"]) == [1, 2, 3, 4, 5, 6]


def test_the_command_records_observed_parts_of_validation_houses(tmp_path, street):
    dataset = HouseDataset("two", "folder", (House("a", "val", street), House("b", "val", street[:, ::-1].copy())))
    maps = maps_to_watch(dataset)
    assert shown_by(Options(out=tmp_path), _CONFIG, dataset) == {}
    shown_by(Options(out=tmp_path, record=True), _CONFIG, dataset)["recording"]().close()
    shown = read(tmp_path / "training-001.rrd")["/maps/known", "SegmentationImage:buffer"][None]
    np.testing.assert_array_equal(_shown(shown, maps), maps.terrain)
    houses = [house.terrain for house in dataset.split("val")]
    for terrain, target, weight in zip(maps.terrain, maps.target, maps.weight, strict=True):
        seen = np.asarray(terrain) > 0
        assert 0 < seen.sum() < seen.size
        assert any(np.array_equal(terrain, np.where(seen, house, 0)) for house in houses)
        np.testing.assert_array_equal(weight > 0, seen & np.isfinite(target))
