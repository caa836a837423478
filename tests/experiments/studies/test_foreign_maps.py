"""Planners on maps that others drew: the file, and the table."""

import numpy as np
import pytest

from experiments.studies.foreign_maps import Options, foreign_dataset, main
from tests.support.refusals import refusal


def maps_in(path, side=20):
    free = np.zeros((3, side, side + 4), bool)
    free[:, 2:-2, 2:-6] = True
    free[:, 8:11, 6:10] = False
    np.savez(path, names=np.array(["caves/one", "caves/two", "blocks/one"]), free=np.packbits(free, axis=-1))
    return path


def test_each_map_has_doors_of_its_own(tmp_path):
    houses = foreign_dataset(maps_in(tmp_path / "maps.npz"), 2, 0).houses
    assert [house.name for house in houses][:3] == ["caves/one/0", "caves/one/1", "caves/two/0"]
    assert {house.terrain.shape for house in houses} == {(20, 20)}
    assert len({house.terrain.tobytes() for house in houses}) == len(houses)


def test_other_files_are_refused(tmp_path):
    other, text = tmp_path / "other.npz", tmp_path / "text.npz"
    np.savez(other, names=np.array(["a/b"]))
    text.write_text("maps")
    for file in (tmp_path / "none.npz", other, text):
        refusal(lambda: foreign_dataset(file, 1, 0), file.name, "give --maps")  # noqa: B023


@pytest.mark.slow
def test_a_table_by_collection(tmp_path, capsys):
    main(Options(maps=maps_in(tmp_path / "maps.npz"), planner=("next_best_view",), starts=1, out=tmp_path / "out"))
    table = (tmp_path / "out" / "table.md").read_text()
    assert "| planner | all | caves (2) | blocks (1) |" in table
    assert "`next_best_view`" in table
    assert table in capsys.readouterr().out
