"""The command that compares what a network may be asked about."""

import json

import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.estimation.estimators import WHOLE_MAP, ExactCostToGo, trait
from dc2g_jax._src.files.rows import read_rows
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.errors import InputError
from experiments.benchmarks.extents import Window, WindowedEstimator
from experiments.studies import unknown_dimensions
from experiments.studies.unknown_dimensions import (
    Options,
    Worlds,
    estimators_by_planner,
    main,
    neighborhoods,
    open_ended,
)


@pytest.mark.slow
def test_every_planner_runs_the_same_episodes(street, compact_network, tmp_path, monkeypatch, capsys):
    worlds = Worlds([House("street", "val", street)], [Start("street", 9, 5, 2), Start("street", 0, 4, 0)])
    monkeypatch.setattr(unknown_dimensions, "all_worlds", lambda options, dataset: {"one": worlds})
    # One of them is enough: each takes a program of its own.
    windows = {"dc2g_window_16": WindowedEstimator(network_in_folder(compact_network), Window(16))}
    monkeypatch.setattr(unknown_dimensions, "estimators_by_planner", lambda network, sides: windows)
    out = tmp_path / "out"
    main(Options(dataset="procedural", network=compact_network, out=out))
    facts = json.loads((out / "results.json").read_text())["worlds"]["one"]
    planners = ["frontier", "dc2g_window_16"]
    assert list(facts) == planners
    assert all(facts[planner]["episodes"] == 2 for planner in planners)
    assert facts["dc2g_window_16"]["milliseconds"] > 0
    episodes = read_rows(out / "episodes.csv", EpisodeResult)
    assert [episode.planner for episode in episodes] == [planner for planner in planners for _ in range(2)]
    assert all(episode.success for episode in episodes)
    assert "2 episodes in 1 maps of 10 x 8 cells, val" in capsys.readouterr().out


def test_each_extent_has_a_name():
    estimators = estimators_by_planner(ExactCostToGo(), (20, 64))
    assert list(estimators) == ["dc2g", "dc2g_crop", "dc2g_window_20", "dc2g_window_64"]
    extents = [trait(one, "extent") for one in estimators.values()]
    assert extents == [WHOLE_MAP, WHOLE_MAP, Window(20, 20.0), Window(64, 64.0)]


def test_around_an_open_ended_house_nothing_comes_to_light(street):
    houses, starts = open_ended(Worlds([House("street", "val", street)], [Start("street", 9, 5, 2)]))
    (house,), (start,) = houses, starts
    assert start.house == house.name
    assert house.terrain[start.y, start.x] == street[5, 9]
    assert np.count_nonzero(house.terrain) == np.count_nonzero(street)
    assert house.terrain.shape == tuple(side + 2 * unknown_dimensions.OPEN_MARGIN for side in street.shape)


def test_neighborhoods_of_the_two_splits_differ():
    maps = {}
    for split in ("val", "test"):
        houses, starts = neighborhoods(Options(split=split, rows=1, cells=64), doors=1)
        maps[split] = houses[0].terrain
        assert maps[split].shape == (64, 64)
        assert len(starts) == 2
    assert np.any(maps["val"] != maps["test"])


@pytest.mark.parametrize("wrong", [{"cells": 49}, {"doors": (0,)}, {"windows": (0,)}, {"rows": -1}])
def test_numbers_that_are_none_are_refused(wrong, tmp_path):
    with pytest.raises(InputError, match="give"):
        main(Options(**wrong, out=tmp_path / "out"))
