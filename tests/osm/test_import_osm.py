"""Maps of an OpenStreetMap extract from the command line, and every command's reader on what it writes."""

import csv

import cv2
import pytest

from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.starts import sample_starts
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.osm.import_osm import Options, main
from tests.support.hamlet import hamlet


@pytest.fixture
def extract(tmp_path):
    (tmp_path / "hamlet.osm").write_text(hamlet().text())
    return tmp_path / "hamlet.osm"


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_folder_of_maps_is_a_dataset(tmp_path, extract, capsys):
    out = tmp_path / "maps"
    main(Options(extract, out))
    printed = capsys.readouterr().out
    assert "Not mapped, but added: front_door to 1, driveway to" in printed
    assert "2 maps of 60 m a side on 50 x 50 cells" in printed
    assert "(c) OpenStreetMap contributors" in printed
    assert "(c) OpenStreetMap contributors" in (out / "ATTRIBUTION.txt").read_text()
    houses = open_dataset(str(out)).houses
    assert [(house.name, house.split, house.terrain.shape) for house in houses] == [
        ("way2", "test", (50, 50)), ("way4", "test", (50, 50)),
    ]  # fmt: skip
    assert len(sample_starts(houses, 3, seed=0)) == 6
    table = rows(out / "maps.csv")
    assert [(row["map"], row["address"]) for row in table] == [("way2", "1"), ("way4", "Main 3")]
    assert int(table[1]["front_door"]) > 0
    assert abs(float(table[0]["latitude"]) - 47.6) < 0.001
    assert cv2.imread(str(out / "added" / "way4.png")).shape == cv2.imread(str(out / "way4.png")).shape
    with pytest.raises(InputError, match="not an empty folder"):
        main(Options(extract, out))


def test_only_what_is_mapped(tmp_path, extract, capsys):
    out = tmp_path / "maps"
    main(Options(extract, out, only_mapped=True, cells=40, meters=50.0))
    printed = capsys.readouterr().out
    assert "left out, no front door is mapped: way4" in printed
    assert ": 1 map of 50 m" in printed
    assert "but added" not in printed
    assert rows(out / "left_out.csv") == [{"building": "way4", "reason": "no front door is mapped"}]
    assert [house.terrain.shape for house in open_dataset(str(out)).houses] == [(40, 40)]
    assert not cv2.imread(str(out / "added" / "way2.png")).any()


def test_what_cannot_be_done(tmp_path, extract):
    for changed, message in (
        ({"meters": 5.0}, r"--meters 5\.0: .*20 to 1000"),
        ({"cells": 2}, r"--cells 2: .*10 to 2000"),
        ({"around": (47.6, -122.2999), "meters": 20.0}, r"hamlet\.osm: no building .* --around"),
    ):
        with pytest.raises(InputError, match=message):
            main(Options(extract, tmp_path / "maps", **changed))
        assert not (tmp_path / "maps").exists()
    extract.write_text(hamlet().text().replace("entrance", "exit"))
    with pytest.raises(InputError, match="all 2 buildings were left out"):
        main(Options(extract, tmp_path / "maps", only_mapped=True))
