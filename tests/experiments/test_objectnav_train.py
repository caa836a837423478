"""The command that trains the indoor network, on a house of two rooms."""

import dataclasses
import json

import pytest

from dc2g_jax._src.estimation.checkpoints import CARD, WEIGHTS
from dc2g_jax.indoor.learning.networks import ENCODER_FOLDER, load_costs
from experiments import objectnav_train
from experiments.objectnav.collecting import CollectionConfig
from experiments.objectnav_train import Options, main
from tests.support.refusals import refusal
from tests.support.two_rooms import two_rooms


@pytest.fixture
def options(tmp_path, monkeypatch):
    monkeypatch.setattr(objectnav_train, "indoor_houses", lambda *args, **options: [two_rooms()])
    return Options(
        out=tmp_path / "out", count=1, validation_houses=1, collection=CollectionConfig(journeys=1, views=4, places=1),
        encoder_steps=2, widths=(4, 4), steps=2, batch_size=2, validate_every=1, validation_samples=2,
    )  # fmt: skip


@pytest.mark.slow
def test_it_writes_a_network_its_encoder_and_their_card_and_goes_on_where_it_was(options, capsys):
    main(options)
    assert "Training on 4 samples of 1 houses" in capsys.readouterr().out
    estimator = load_costs(options.out)
    assert estimator.architecture.widths == (4, 4)
    card = json.loads((options.out / "network.json").read_text())
    assert card["steps"] == 2
    log = (options.out / "log.jsonl").read_text()
    main(dataclasses.replace(options, resume=True))
    assert (options.out / "log.jsonl").read_text() == log

    taken = dataclasses.replace(options, out=options.out.parent / "other", encoder=options.out / ENCODER_FOLDER)
    main(taken)
    for name in (CARD, WEIGHTS):
        given, copied = (one.out / ENCODER_FOLDER / name for one in (options, taken))
        assert copied.read_bytes() == given.read_bytes()
        given.unlink()
    main(dataclasses.replace(taken, resume=True))  # has its own copy


def test_an_encoder_that_is_none_and_numbers_that_make_no_sense_are_refused(options, tmp_path):
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    (wrong / CARD).write_bytes(b"nothing")
    refusal(lambda: main(dataclasses.replace(options, encoder=wrong)), wrong)
    refusal(lambda: main(dataclasses.replace(options, count=0)), "--count 0", "at least 1")
    refusal(lambda: main(dataclasses.replace(options, patch=3)), "--patch 3", "give")
    for name, value in (("learning_rate", float("nan")), ("learning_rate", 0.0), ("steps", 0), ("batch_size", 0)):
        number = f"{name.replace('_', ' ')} {value}"
        refusal(lambda: main(dataclasses.replace(options, **{name: value})), number, "give")  # noqa: B023
    refusal(lambda: main(dataclasses.replace(options, loss="cross")), "no loss is called 'cross'", "give one of paper")
    collection = dataclasses.replace(options.collection, data_seed=2**64)
    refusal(lambda: main(dataclasses.replace(options, collection=collection)), "--data-seed", "give")
    assert not options.out.exists()
    damaged = tmp_path / "data.safetensors"
    damaged.write_bytes(b"garbage")
    refusal(lambda: objectnav_train.kept(damaged, lambda report: None, 1), damaged, "delete it")
    refusal(lambda: main(dataclasses.replace(options, widths=(4,), out=tmp_path / "new")), "--widths 4", "at least two")


def test_a_run_is_resumed_with_the_houses_that_it_was_begun_with(options, monkeypatch):
    monkeypatch.setattr(objectnav_train, "_open_encoder", lambda options, houses: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(options)
    other = two_rooms()
    other.world.heights[0, 0] += 1
    monkeypatch.setattr(objectnav_train, "indoor_houses", lambda *args, **options: [other])
    refusal(lambda: main(dataclasses.replace(options, resume=True)), options.out, "--dataset", "has changed")
