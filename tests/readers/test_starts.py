"""Where episodes start: sampled, published, and read from files that may be wrong in many ways."""

import numpy as np
import pytest

from dc2g_jax._src.grid.ground import connected_to_goal
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, ROAD, TRAVERSABLE
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import (
    Start,
    any_ground,
    check_starts,
    published_episodes,
    read_starts,
    sample_starts,
    start_cells,
    usable_houses,
    why_no_episode,
)
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.families import procedural_dataset
from tests.support.refusals import refusal


@pytest.fixture(scope="module")
def dataset(street, island) -> HouseDataset:
    doorless = np.where(street == FRONT_DOOR, 7, street).astype(np.uint8)
    houses = (House("street", "test", street), House("island", "test", island), House("doorless", "val", doorless))
    return HouseDataset("toys", "folder", houses)


# --- sampled -----------------------------------------------------------------------------------------------


def test_sampled_starts_are_on_road_connected_to_a_door(dataset):
    starts = sample_starts(dataset.houses, 50, seed=0)
    assert [start.house for start in starts] == ["street"] * 50
    terrain = dataset.house("street").terrain
    assert all(terrain[start.y, start.x] == ROAD for start in starts)
    assert {start.heading for start in starts} == {0, 1, 2, 3}
    assert len(set(starts)) > 25
    assert all(type(value) is int for start in starts for value in start[1:4])
    assert all((start.sensing_range, start.expanding_range) == (None, None) for start in starts)


def test_no_starts_at_all_are_refused(dataset):
    refusal(lambda: sample_starts(dataset.houses, 0, seed=0), "starts per house 0", "at least 1")
    refusal(lambda: sample_starts(dataset.houses, 1, seed=-1), "seed -1", "from 0 to 4294967295")
    refusal(lambda: procedural_dataset(seed=-1), "seed -1")


def test_road_cut_off_from_the_doors_is_not_sampled(street):
    terrain = np.vstack([street, np.full((2, 10), 2, np.uint8), np.full((1, 10), ROAD, np.uint8)])
    starts = sample_starts([House("street", "test", terrain)], 60, seed=0)
    assert all(start.y < len(street) for start in starts)


def test_sampled_starts_depend_on_seed_and_name_alone(street):
    others = [House(name, "test", street) for name in ("a", "b", "c")]
    alone = sample_starts(others[1:2], 5, seed=3)
    among = [start for start in sample_starts(others, 5, seed=3) if start.house == "b"]
    backwards = [start for start in sample_starts(others[::-1], 5, seed=3) if start.house == "b"]
    assert alone == among == backwards == sample_starts(others[1:2], 5, seed=3)
    assert alone != sample_starts(others[1:2], 5, seed=4)
    by_house = [[start[1:] for start in sample_starts([house], 5, seed=3)] for house in others]
    assert by_house[0] != by_house[1] != by_house[2]


def test_a_map_without_road_has_starts_on_all_ground_but_the_doors(street):
    terrain = np.where(street == ROAD, CLASS_NAMES.index("traversable"), street).astype(np.uint8)
    np.testing.assert_array_equal(start_cells(terrain), TRAVERSABLE[terrain] & (terrain != FRONT_DOOR))
    assert why_no_episode(House("roadless", "test", terrain)) is None
    assert len(sample_starts([House("roadless", "test", terrain)], 4, seed=0)) == 4


def test_why_no_episode(dataset):
    assert why_no_episode(dataset.house("street")) is None
    assert why_no_episode(dataset.house("doorless")) == "it has no front door"
    assert "reached" in why_no_episode(dataset.house("island"))


def test_starts_without_a_goal_in_reach_are_refused_unless_any_ground_will_do(dataset):
    for start, mentions in (
        (Start("island", 0, 0, 0), ["no goal can be reached from column 0, row 0"]),
        (Start("doorless", 3, 4, 0), ["no goal can be reached", "in doorless: it has no front door"]),
    ):
        refusal(lambda start=start: check_starts([start], dataset), f"start 0 in {start.house}: ", *mentions)
        check_starts([start], dataset, ground_of=any_ground)


def test_a_split_without_episodes_is_refused_by_name(dataset):
    assert usable_houses(dataset, "test") == [dataset.house("street")]
    folder = ("val/", "validation_houses.csv")
    refusal(lambda: usable_houses(dataset, "val"), "toys: ", "its 1 val houses", "give another dataset", *folder)
    refusal(lambda: usable_houses(dataset, "train", instead="raise cells"), "its 0 train houses; raise cells", "train/")


def test_published_houses_without_episodes(published_dataset):
    unusable = {house.name for house in published_dataset.houses if why_no_episode(house)}
    assert unusable == {"n002m001h003", "n001m001h002"}
    starts = sample_starts(published_dataset.houses, 3, seed=0)
    assert len(starts) == 3 * 75
    for start in starts:
        terrain = published_dataset.house(start.house).terrain
        assert terrain[start.y, start.x] == ROAD
        assert connected_to_goal(terrain)[start.y, start.x]


def test_published_episodes_are_those_recorded(shared):
    lines = (shared / "golden" / "published_episodes.csv").read_text().splitlines()
    columns = lines[0].split(",")
    recorded = [dict(zip(columns, line.split(","), strict=True)) for line in lines[1:]]
    episodes = published_episodes()
    assert len(episodes) == len(recorded) == 400
    for (start, _, steps), row in zip(episodes, recorded, strict=True):
        assert start == Start(row["house"], int(row["x"]), int(row["y"]), int(row["heading"]))
        assert steps == {name: int(row[f"{name}_steps"]) for name in ("oracle", "frontier", "dc2g")}


# --- read from a file ---------------------------------------------------------------------------------------

HEADER = "house,x,y,heading,range,expanding_range\n"
GOOD = HEADER + "street,3,4,0,,\nstreet,0,5,3,5,4\nstreet,1,4,2,6,\n"
WANTED = [Start("street", 3, 4, 0), Start("street", 0, 5, 3, 5, 4), Start("street", 1, 4, 2, 6)]


@pytest.mark.parametrize(
    "content",
    [
        GOOD.encode(),
        b"\xef\xbb\xbf" + GOOD.encode(),
        GOOD.replace("\n", "\r\n").encode(),
        GOOD.rstrip("\n").encode(),
        GOOD.replace("\nstreet,0", "\n\nstreet,0").encode(),
        GOOD.replace(",", " , ").replace(" , ", ",", 5).encode(),
        b"note,expanding_range,heading,y,x,house,range\nhello,,0,4,3,street,\n,4,3,5,0,street,5\n,,2,4,1,street,6\n",
    ],
    ids=["plain", "BOM", "CRLF", "no last newline", "blank line", "spaces", "columns in any order"],
)
def test_read_starts(tmp_path, dataset, content):
    path = tmp_path / "starts.csv"
    path.write_bytes(content)
    assert read_starts(path, dataset) == WANTED
    assert read_starts(str(path), dataset) == WANTED


def test_ranges_are_optional(tmp_path, dataset):
    path = tmp_path / "starts.csv"
    path.write_text("house,x,y,heading\nstreet,3,4,0\n")
    assert read_starts(path, dataset) == WANTED[:1]


@pytest.mark.parametrize(
    ("line", "mentions"),
    [
        ("street,3,4,4", ["heading", "4:", "0 to 3"]),
        ("street,3,4,-1", ["heading", "-1:"]),
        ("street,3,4,", ["heading", "no value"]),
        ("street,3,4", ["heading", "no value"]),
        ("street,10,4,0", ["column 10, row 4 is off the map of 10 x 8 cells"]),
        ("street,3,8,0", ["column 3, row 8 is off the map"]),
        ("street,east,4,0", ["x", "'east'"]),
        ("street,1.5,4,0", ["x", "'1.5'"]),
        ("street,-,4,0", ["x", "'-'"]),
        ("street,--3,4,0", ["x", "'--3'"]),
        ("street,²,4,0", ["x", "'²'"]),
        ("street,3,4,0,0,", ["range", "0:", "2 to 64"]),
        ("street,3,4,0,65,", ["range", "65:"]),
        ("street,3,4,0,wide,", ["range", "'wide'"]),
        ("street,3,4,0,5,1", ["expanding_range", "1:", "2 to 64"]),
        ("street,9,0,0", ["column 9, row 0 is 'grass'", "nearest cell to start from lies at column 7, row 2"]),
        ("street,0,0,0", ["column 0, row 0"]),
        ("street,2,0,0", ["column 2, row 0 is a goal already"]),
        ("strete,3,4,0", ["strete", "street"]),
        (",3,4,0", ["house"]),
        ("doorless,0,0,0", ["column 0, row 0 is 'house'", "nearest cell to start from"]),
    ],
    ids=ascii,
)
def test_bad_lines_are_refused_by_file_line_and_value(tmp_path, dataset, line, mentions):
    path = tmp_path / "starts.csv"
    path.write_text(HEADER + "street,3,4,0,,\n" + line + "\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_starts(path, dataset)
    message = str(caught.value)
    assert "\n" not in message
    for mention in (str(path), "line 3", *mentions):
        assert mention in message


@pytest.mark.parametrize(
    ("content", "mention"),
    [
        (b"", "house"),
        (b"house,x,y\nstreet,3,4\n", "heading"),
        (b"x,y,heading\n3,4,0\n", "house"),
        (HEADER.encode(), "no rows"),
        (b"house,x,y,heading,planner\nstreet,3,4,0,oracle\nstreet,3,4,0,frontier\n", "2 planners, frontier, oracle"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "UTF-8"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, dataset, content, mention):
    path = tmp_path / "starts.csv"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_starts(path, dataset)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    assert mention in message


def test_a_file_that_is_not_there(tmp_path, dataset):
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match="give a CSV file with columns house") as caught:
            read_starts(path, dataset)
        assert str(path) in str(caught.value)
