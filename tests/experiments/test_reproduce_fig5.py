"""The translator's training: its pairs, and what happens when it is interrupted or diverges."""

import dataclasses
import json
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training import loop
from dc2g_jax._src.training.loop import Log
from experiments import reproduce_fig4, reproduce_fig5
from experiments.reproduce_fig5 import TranslationOptions, train_translators, translation_data
from experiments.translator.network import Generator, init_weights
from tests.support import maps

OPTIONS = TranslationOptions(
    size=32, base_filters=2, train_masks=5, validation_masks=1, steps=30, validate_every=10
)  # fmt: skip
METRICS = {"l1": 0.25, "low_precision": np.nan, "low_recall": 0.5}


@pytest.fixture(scope="module")
def dataset() -> HouseDataset:
    return maps.drawn_dataset()


def test_pairs_by_default_are_as_many_as_the_papers(dataset):
    options = TranslationOptions(size=32)
    data = translation_data(dataset, options)
    assert (len(data.train.pair_house), len(data.validation.pair_house)) == (2 * 256, 80)
    assert data.train.masks.shape == (256, 1, 32)
    # Validation masks are none of the training masks.
    seen = {np.asarray(mask).tobytes() for mask in data.train.masks}
    assert not seen & {np.asarray(mask).tobytes() for mask in data.validation.masks}


@pytest.fixture
def steps(monkeypatch):
    """Stand-in for the real step: notes its number, and misbehaves where told."""
    taken, trouble = [], {}

    def step(state, **options):
        number = int(state.step)
        if trouble.get(number) is KeyboardInterrupt:
            del trouble[number]
            signal.raise_signal(signal.SIGINT)
        taken.append(number)
        return state.replace(step=state.step + 1), jnp.float32(trouble.get(number, 0.5))

    monkeypatch.setattr(loop, "supervised_step", step)
    monkeypatch.setattr(reproduce_fig5, "metrics_over_pairs", lambda network, data: dict(METRICS))
    return taken, trouble


def train(out, dataset, **changes) -> None:
    options = dataclasses.replace(OPTIONS, **changes)
    train_translators(out, {"run": 0}, dataset, translation_data(dataset, options), options.config("l1"), options)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_run_goes_on_where_it_was(dataset, tmp_path, steps):
    taken, trouble = steps
    trouble[17] = KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, dataset)
    assert taken == list(range(18))  # the step that was under way is finished
    train(tmp_path, dataset)
    assert taken == list(range(30))
    log = Log(tmp_path).by_step("run")
    assert list(log) == [10, 20, 30]
    assert log[30] == {"run": "run", "step": 30, "loss": 0.5, **METRICS, "low_precision": None, "steps_left_out": 30}
    assert (tmp_path / "runs" / "run" / "network" / "network.json").is_file()
    with pytest.raises(InputError, match="train_masks was 5"):
        train(tmp_path, dataset, train_masks=4)


def test_a_run_at_its_end_goes_on_to_more_steps(dataset, tmp_path, steps):
    for count in (20, 40):
        train(tmp_path, dataset, steps=count)
    assert steps[0] == list(range(40))
    assert list(Log(tmp_path).by_step("run")) == [10, 20, 30, 40]


def test_a_run_that_is_refused_fewer_steps_stays_as_it_is(dataset, tmp_path, steps, monkeypatch):
    monkeypatch.setattr(reproduce_fig5, "open_dataset", lambda location, *, cells: dataset)
    options = reproduce_fig5.Options(
        out=tmp_path / "run", losses=("l1",), seeds=(0,), **dataclasses.asdict(dataclasses.replace(OPTIONS, steps=20))
    )
    reproduce_fig5.main(options)
    longer = dataclasses.replace(options, resume=True, steps=OPTIONS.steps)
    reproduce_fig5.main(longer)
    written = (tmp_path / "run" / "run.json").read_bytes()
    assert len(json.loads(written)["runs"]) == 2
    with pytest.raises(InputError, match=r"l1-seed0: has 30 steps behind it; give at least as many --steps"):
        reproduce_fig5.main(dataclasses.replace(options, resume=True))
    assert (tmp_path / "run" / "run.json").read_bytes() == written
    assert steps[0] == list(range(30))


def test_a_run_that_diverges_goes_on_and_says_so(dataset, tmp_path, steps):
    steps[1][12] = np.nan
    train(tmp_path, dataset)
    assert [line["loss"] for line in Log(tmp_path).by_step("run").values()] == [0.5, None, 0.5]


def test_figure_5_goes_on_with_the_runs_that_are_there(dataset, tmp_path, steps, monkeypatch):
    monkeypatch.setattr(reproduce_fig5, "open_dataset", lambda location, *, cells: dataset)
    options = reproduce_fig5.Options(
        out=tmp_path / "fig5", losses=("l1", "l1+gan"), seeds=(0, 3), **dataclasses.asdict(OPTIONS)
    )
    reproduce_fig5.main(options)
    reproduce_fig5.main(dataclasses.replace(options, resume=True))
    assert steps[0] == 4 * list(range(30))
    facts = json.loads((tmp_path / "fig5" / "results.json").read_text())
    assert {loss: len(runs) for loss, runs in facts["runs"].items()} == {"l1": 2, "l1+gan": 2}
    assert [figures["step"] for figures in facts["runs"]["l1"][1]] == [10, 20, 30]
    assert (tmp_path / "fig5" / "fig5.png").stat().st_size > 0
    for wrong in ({"losses": ("l2",)}, {"losses": ()}, {"seeds": ()}, {"window": 0}):
        with pytest.raises(InputError, match=r"l2|at least one"):
            reproduce_fig5.main(dataclasses.replace(options, out=tmp_path / "no", **wrong))
    assert not (tmp_path / "no").exists()


def test_figure_4_shows_as_many_houses_as_asked_for(dataset, compact_network, tmp_path, monkeypatch):
    houses = tuple(dataclasses.replace(house, split="test") for house in dataset.houses)
    monkeypatch.setattr(
        reproduce_fig4, "open_dataset", lambda location, *, cells: HouseDataset("drawn", "folder", houses)
    )
    reproduce_fig4.main(reproduce_fig4.Options(network=compact_network, rows=1, out=tmp_path / "fig4"))
    assert {path.name for path in (tmp_path / "fig4").iterdir()} == {"fig4.png", "fig4.svg", "fig4.pdf", "run.json"}
    with pytest.raises(InputError, match="--rows 0"):
        reproduce_fig4.main(reproduce_fig4.Options(rows=0, out=tmp_path / "no"))


@pytest.mark.parametrize("share", [-0.1, 1.5])
def test_a_share_of_whole_maps_is_a_share(share):
    with pytest.raises(InputError, match=f"--whole-share {share}: give a number from 0 to 1"):
        dataclasses.replace(OPTIONS, whole_share=share).config("l1")


def test_networks_that_cannot_be_built_are_refused_in_one_line():
    with pytest.raises(InputError, match="size 48"):
        dataclasses.replace(OPTIONS, size=48).config("l1")
    with pytest.raises(InputError, match="steps 0: give a whole number of at least 1"):
        dataclasses.replace(OPTIONS, steps=0).config("l1")
    with pytest.raises(InputError, match="l1, gan"):
        OPTIONS.config("l3")
    with pytest.raises(InputError, match="--batch-size 4"):
        dataclasses.replace(OPTIONS, normalization="batch").config("l1")


@pytest.mark.usefixtures("steps")
def test_a_network_trained_with_batch_normalization_is_saved_with_statistics(dataset, tmp_path):
    train(tmp_path, dataset, normalization="batch", batch_size=2)
    network = network_in_folder(tmp_path / "runs" / "run" / "network")
    assert network.architecture.normalization == "batch"
    pictures = jax.random.uniform(jax.random.key(0), (2, 32, 32, 3))
    np.testing.assert_allclose(network.answer(pictures)[:1], network.answer(pictures[:1]), atol=1.01 / 255)
    first = init_weights(Generator, network.architecture, jax.random.split(jax.random.key(0), 3)[0])
    assert not np.allclose(network.weights["up1"]["norm"]["scale"], first["up1"]["norm"]["scale"], rtol=0.1)


@pytest.mark.slow
def test_runs_trained_together_are_those_trained_alone(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(reproduce_fig5, "metrics_over_pairs", lambda network, data: dict(METRICS))
    options, seeds = dataclasses.replace(OPTIONS, steps=2, validate_every=1), {"a": 3, "b": 4}
    data = translation_data(dataset, options)
    for run, seed in seeds.items():
        train_translators(tmp_path / "alone", {run: seed}, dataset, data, options.config("l1+gan"), options)
    monkeypatch.setattr(loop, "platform", lambda mesh: "gpu")  # a CPU would take runs one after another
    for steps in (1, 2):  # interrupted in between
        own = dataclasses.replace(options, steps=steps)
        train_translators(tmp_path / "together", seeds, dataset, data, own.config("l1+gan"), own)
    for run in seeds:
        alone, together = (
            jax.tree.leaves(network_in_folder(tmp_path / where / "runs" / run / "network").weights)
            for where in ("alone", "together")
        )
        # Adam moves each weight by 2e-4 a step, to either side where its gradient is zero but for rounding.
        for one, other in zip(alone, together, strict=True):
            np.testing.assert_allclose(other, one, atol=1e-3)
        alone, together = (Log(tmp_path / where).by_step(run) for where in ("alone", "together"))
        assert list(alone) == list(together) == [1, 2]
        for number in (1, 2):
            np.testing.assert_allclose(together[number]["loss"], alone[number]["loss"], rtol=2e-3)
