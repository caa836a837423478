"""The table of episodes: read back as written, and gone on with where a run stopped."""

import numpy as np
import pytest

from dc2g_jax._src.cli import episodes
from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.files.rows import read_rows, write_rows
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.errors import InputError
from tests.support.refusals import refusal

STARTS = (Start("left", 9, 5, 1), Start("right", 9, 5, 2))
PLANNERS = ("oracle", "frontier")


class Interrupted(Runner):
    """Is interrupted in the middle of a planner, and counts what it was asked for."""

    def __init__(self, dataset: HouseDataset, at: str | None = None):
        super().__init__(dataset, SETTINGS["reference"])
        self.at, self.asked = at, []

    def run(self, starts, planners, estimator=None):
        self.asked += planners
        if self.at in planners:
            raise KeyboardInterrupt
        return super().run(starts, planners, estimator)


@pytest.fixture(scope="module")
def dataset(street) -> HouseDataset:
    mirrored = np.ascontiguousarray(street[:, ::-1])
    return HouseDataset("toys", "folder", (House("left", "test", street), House("right", "val", mirrored)))


@pytest.fixture(scope="module")
def results(dataset):
    return Runner(dataset, SETTINGS["reference"]).run(STARTS, PLANNERS)


def test_episodes_are_read_as_they_were_written(results, tmp_path):
    path = tmp_path / "episodes.csv"
    mixed = [*results, results[0]._replace(expanding_range=None, actions="", success=False, mode="gave_up")]
    write_rows(path, EpisodeResult, mixed)
    assert read_rows(path, EpisodeResult) == mixed
    assert [file.name for file in tmp_path.iterdir()] == ["episodes.csv"]


@pytest.mark.parametrize(
    ("old", "new", "mention"), [(",9,", ",nine,", "line 2: .*'nine'"), ("house,", "home,", "lacks the column 'house'")]
)
def test_a_damaged_table_is_refused(dataset, results, tmp_path, old, new, mention):
    path = tmp_path / "episodes.csv"
    write_rows(path, EpisodeResult, results)
    path.write_text(path.read_text().replace(old, new, 1))
    runner = Interrupted(dataset)
    with pytest.raises(InputError, match=mention):
        EpisodeTable(path).run(runner, STARTS, PLANNERS)
    assert runner.asked == []


@pytest.mark.parametrize(
    ("changes", "mention"),
    [
        ({"steps": -3}, "-3 steps"),
        ({"steps": "9" * 400}, "'999999"),
        ({"success": 7}, "'7' is neither 0 nor 1"),
        ({"mode": "banana"}, "'banana' is none of explore, to_goal, gave_up"),
        ({"actions": "ZZZ"}, "actions 'ZZZ' are not letters F, L, R"),
        ({"actions": "F"}, "1 actions for"),
        ({"extra": "nan"}, "extra is nan"),
        ({"extra": -100.0}, "extra is -100.0"),
        ({"heading": 4}, "heading 4"),
        ({"x": "1_0"}, "'1_0' is not a whole number"),
        ({"oracle_steps": 0}, "the oracle took 0 steps"),
    ],
    ids=str,
)
def test_rows_that_contradict_themselves_are_refused(results, tmp_path, changes, mention):
    path = tmp_path / "episodes.csv"
    write_rows(path, EpisodeResult, [results[0], results[1]._replace(**changes)])
    refusal(lambda: read_rows(path, EpisodeResult), path, "line 3", mention, "repair the line")


def test_an_interrupted_run_goes_on_with_the_planner_it_was_at(dataset, results, tmp_path):
    path = tmp_path / "episodes.csv"
    with pytest.raises(KeyboardInterrupt):
        EpisodeTable(path).run(Interrupted(dataset, at="frontier"), STARTS, PLANNERS)
    assert read_rows(path, EpisodeResult) == results[:2]
    runner = Interrupted(dataset)
    assert EpisodeTable(path).run(runner, STARTS, PLANNERS) == results
    assert runner.asked == ["frontier"]
    assert read_rows(path, EpisodeResult) == results


def test_parts_of_a_run_are_kept_one_after_the_other(dataset, results, tmp_path):
    path = tmp_path / "episodes.csv"
    runner = Interrupted(dataset, at="frontier")
    table = EpisodeTable(path)
    table.run(runner, STARTS, ["oracle"])
    with pytest.raises(KeyboardInterrupt):
        table.run(runner, STARTS[1:], PLANNERS)
    assert read_rows(path, EpisodeResult) == [*results[:2], results[1]]
    runner, table = Interrupted(dataset), EpisodeTable(path)
    table.run(runner, STARTS, ["oracle"])
    assert table.run(runner, STARTS[1:], PLANNERS) == [results[1], results[3]]
    assert runner.asked == ["frontier"]


def test_episodes_of_the_range_asked_for_are_kept(dataset, results, tmp_path):
    path = tmp_path / "episodes.csv"
    write_rows(path, EpisodeResult, results)
    starts = [start._replace(sensing_range=results[0].range) for start in STARTS]
    runner = Interrupted(dataset)
    assert EpisodeTable(path).run(runner, starts, ["oracle"]) == results[:2]
    assert runner.asked == []


@pytest.mark.parametrize(
    ("kept", "starts"),
    [
        ({}, [start._replace(sensing_range=9) for start in STARTS]),
        ({"range": 5, "expanding_range": 5}, STARTS),
        ({}, STARTS[::-1]),
    ],
    ids=["another range", "not the settings' own range", "other starts"],
)
def test_other_episodes_are_refused_and_stay(dataset, results, tmp_path, kept, starts):
    path = tmp_path / "episodes.csv"
    write_rows(path, EpisodeResult, [result._replace(**kept) for result in results])
    before, runner = path.read_text(), Interrupted(dataset)
    refusal(lambda: EpisodeTable(path).run(runner, starts, ["oracle"]), path, "where this run has", "remove the file")
    assert runner.asked == []
    assert path.read_text() == before


@pytest.mark.parametrize("lost", [1, 20, 300])
def test_a_table_that_a_kill_cut_off_ends_like_one_that_was_not(dataset, results, tmp_path, lost, monkeypatch):
    monkeypatch.setattr(episodes, "EPISODES_A_SHARD", 3)
    starts, path = [start for _ in range(4) for start in STARTS], tmp_path / "episodes.csv"
    whole = EpisodeTable(path).run(Interrupted(dataset), starts, PLANNERS)
    assert whole == Runner(dataset, SETTINGS["reference"]).run(starts, PLANNERS)
    written = path.read_bytes()
    path.write_bytes(written[:-lost])
    runner = Interrupted(dataset)
    assert EpisodeTable(path).run(runner, starts, PLANNERS) == whole
    assert path.read_bytes() == written
    assert 0 < len(runner.asked) < 6


def test_a_kill_loses_one_shard_at_most(dataset, results, tmp_path, monkeypatch):
    monkeypatch.setattr(episodes, "EPISODES_A_SHARD", 1)
    path = tmp_path / "episodes.csv"
    runner = Interrupted(dataset)
    shards = EpisodeTable(path).shards(runner, STARTS, PLANNERS)
    assert [next(shards) for _ in range(3)] == [[result] for result in results[:3]]
    assert read_rows(path, EpisodeResult) == results[:3]
    assert runner.asked == ["oracle", "oracle", "frontier"]
