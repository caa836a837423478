"""Your own maps: what is read of each kind and of folders, and one clear line for everything that can be wrong."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from dc2g_jax._src.files.class_images import Palette, read_palette
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, GRASS, HOUSE, PATH, ROAD
from dc2g_jax._src.readers.houses import map_dataset, open_dataset, stack_worlds
from dc2g_jax._src.readers.maps import Goal, draw_map, map_from_classes, read_map
from dc2g_jax._src.readers.starts import sample_starts, why_no_episode
from dc2g_jax._src.runtime.errors import InputError
from tests.support.houses import save_dataset
from tests.support.maps import drawn
from tests.support.occupancy import save
from tests.support.refusals import refusal

COLORS = {"front_door": (250, 0, 0), "grass": (10, 200, 10), "house": (1, 2, 3), "road": (90, 90, 90)}


def paint(path: Path, terrain: np.ndarray) -> Path:
    """Write a picture in `COLORS`."""
    table = np.zeros((len(CLASS_NAMES), 3), np.uint8)
    for name, color in COLORS.items():
        table[CLASS_NAMES.index(name)] = color
    assert cv2.imwrite(str(path), table[terrain][..., ::-1])
    return path


def write_palette(path: Path) -> Path:
    path.write_text("class,r,g,b\n" + "".join(f"{name},{r},{g},{b}\n" for name, (r, g, b) in COLORS.items()))
    return path


@pytest.fixture
def palette(tmp_path) -> Palette:
    return read_palette(write_palette(tmp_path / "palette.csv"))


@pytest.fixture
def yard() -> np.ndarray:
    """Higher than wide, with an island."""
    return drawn("""
        .#D#.
        .RRR.
        .R#R.
        RRR..
        ....R
        #..RR
        #....
    """)


# --- what is read ---------------------------------------------------------------------------------------


def test_pictures_arrays_and_arrays_in_memory_give_the_same_map(tmp_path, palette, yard):
    np.save(tmp_path / "yard.npy", yard.astype(np.int64))
    maps = [
        read_map(paint(tmp_path / "yard.png", yard), palette=palette),
        read_map(tmp_path / "yard.npy"),
        read_map(str(tmp_path / "yard.npy")),
        map_from_classes(yard.tolist()),
    ]
    for terrain in maps:
        np.testing.assert_array_equal(terrain, yard)
        assert terrain.dtype == np.uint8
        assert not terrain.flags.writeable
    assert yard.flags.writeable


def test_goals_become_front_doors(yard):
    terrain = map_from_classes(yard, goals=[Goal(0, 3), Goal(4, 4)])
    assert np.argwhere(terrain == FRONT_DOOR).tolist() == [[0, 2], [3, 0], [4, 4]]
    np.testing.assert_array_equal(terrain[terrain != FRONT_DOOR], yard[terrain != FRONT_DOOR])


def test_maps_are_sampled_to_columns_and_rows(yard):
    large = yard.repeat(4, axis=0).repeat(6, axis=1)
    np.testing.assert_array_equal(map_from_classes(large, cells=(5, 7)), yard)
    assert map_from_classes(large, cells=(30, 7)).shape == (7, 30)
    # As everywhere in the package, paths are widened when a map is sampled, and only then.
    large[large == ROAD] = PATH
    assert np.sum(map_from_classes(large) == PATH) == np.sum(large == PATH)
    assert np.sum(map_from_classes(large, cells=(30, 28)) == PATH) > np.sum(large == PATH)
    goal = Goal(4, 5)
    assert map_from_classes(yard.repeat(2, axis=0), cells=(5, 7), goals=[goal])[5, 4] == FRONT_DOOR


def test_a_folder_of_maps_is_a_dataset(tmp_path, yard):
    write_palette(tmp_path / "labels_colors.csv")
    for split in ("train", "val", "test"):
        (tmp_path / split).mkdir()
    paint(tmp_path / "train" / "b.png", yard)
    np.save(tmp_path / "train" / "a.npy", yard)
    np.save(tmp_path / "val" / "c.npy", np.where(yard == FRONT_DOOR, HOUSE, yard))
    save(tmp_path / "test", np.full((7, 5), 254, np.uint8))
    (tmp_path / "goals.csv").write_text("map,x,y,unit\nlab,0.01,0.01,meters\nc,3,5,cells\n lab, 4, 0, cells\n")
    dataset = open_dataset(tmp_path)
    assert [(house.name, house.split) for house in dataset.houses] == [
        ("a", "train"), ("b", "train"), ("c", "val"), ("lab", "test"),
    ]  # fmt: skip
    assert (dataset.name, dataset.source) == (tmp_path.name, "folder")
    np.testing.assert_array_equal(dataset.house("b").terrain, yard)
    assert np.argwhere(dataset.house("c").terrain == FRONT_DOOR).tolist() == [[5, 3]]
    assert np.argwhere(dataset.house("lab").terrain == FRONT_DOOR).tolist() == [[0, 4], [6, 0]]
    assert stack_worlds(dataset.houses).goals.shape[-1] == 4


def test_maps_without_folders_for_the_splits_are_for_testing(tmp_path, yard):
    large = yard.repeat(4, axis=0).repeat(4, axis=1)
    np.save(tmp_path / "b.npy", large)
    np.save(tmp_path / "a.npy", large.T)
    (tmp_path / "._a.png").write_bytes(b"what another system keeps about a file")
    dataset = map_dataset(tmp_path)
    assert [(house.name, house.split) for house in dataset.houses] == [("a", "test"), ("b", "test")]
    assert [house.terrain.shape for house in dataset.houses] == [(20, 28), (28, 20)]
    (tmp_path / "cells.csv").write_text("columns,rows\n20,18\n")
    assert stack_worlds(map_dataset(tmp_path).houses).goals.shape[1:] == (18, 2)


def test_the_environment_may_name_a_folder_of_maps(tmp_path, yard, monkeypatch):
    np.save(tmp_path / "yard.npy", yard)
    monkeypatch.setenv("DC2G_DATA", str(tmp_path))
    assert [house.name for house in open_dataset().houses] == ["yard"]


def test_the_published_layout_is_never_taken_for_a_folder_of_maps(tmp_path, yard):
    folder = save_dataset([("a", "test", yard)], tmp_path / "houses")
    np.save(folder / "stray.npy", yard)
    assert [house.name for house in open_dataset(folder, cells=5).houses] == ["a"]


# --- what is refused ------------------------------------------------------------------------------------


def test_colors_outside_the_palette_are_all_listed(tmp_path, palette, yard):
    path = paint(tmp_path / "yard.png", yard)
    picture = cv2.imread(str(path))
    picture[6] = (11, 201, 11)
    picture[0, 3] = (93, 90, 90)
    cv2.imwrite(str(path), picture)
    refusal(
        lambda: read_map(path, palette=palette),
        path,
        palette.path.name,
        "(11, 201, 11) at x=0, y=6 and 4 more (nearest: 'grass' (10, 200, 10))",
        "(90, 90, 93) at x=3, y=0 (nearest: 'road' (90, 90, 90))",
        "repaint",
    )
    picture[1:5] = np.arange(60).reshape(4, 5, 3) + 100
    cv2.imwrite(str(path), picture)
    refusal(lambda: read_map(path, palette=palette), "(11, 201, 11)", "and 20 other colors")


def test_a_picture_without_palette(tmp_path, yard):
    path = paint(tmp_path / "yard.png", yard)
    refusal(lambda: read_map(path), path, "needs a palette", "class,r,g,b")
    refusal(lambda: read_map(tmp_path / "gone.png"), tmp_path / "gone.png", "no such file", "give")
    paint(tmp_path / "yard.png", yard)
    refusal(lambda: open_dataset(tmp_path), tmp_path / "labels_colors.csv", "no such file", "class,r,g,b")


@pytest.mark.parametrize(
    ("array", "mentions"),
    [
        (np.zeros((3, 4, 2), np.uint8), ["[H W]", "[3, 4, 2]"]),
        (np.zeros((0, 4), np.uint8), ["[H W]", "[0, 4]"]),
        (np.zeros((3, 4)), ["float64", "whole numbers"]),
        (np.pad([[16]], 2), ["holds 16 at column 2, row 2", "0 to 15"]),
        (np.pad([[-1]], ((1, 0), (3, 0))), ["holds -1 at column 3, row 1"]),
    ],
)
def test_arrays_that_are_no_classes(tmp_path, array, mentions):
    np.save(tmp_path / "a.npy", array)
    refusal(lambda: read_map(tmp_path / "a.npy"), tmp_path / "a.npy", *mentions)
    refusal(lambda: map_from_classes(array, name="my array"), "my array: ", *mentions)


def test_files_that_are_no_maps(tmp_path, palette, yard):
    np.save(tmp_path / "a.npy", yard)
    (tmp_path / "cut.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:-3])
    refusal(lambda: read_map(tmp_path / "cut.npy"), tmp_path / "cut.npy", "is not a plain array", "numpy.save")
    np.save(tmp_path / "b.npy", np.array([None]), allow_pickle=True)
    refusal(lambda: read_map(tmp_path / "b.npy"), tmp_path / "b.npy", "is not a plain array", "numpy.save")
    whole = (tmp_path / "a.npy").read_bytes()
    for name, damaged in (("open", whole.replace(b"}", b"(", 1)), ("word", whole.replace(b"False", b"F lse", 1))):
        (tmp_path / f"{name}.npy").write_bytes(damaged)
        refusal(lambda name=name: read_map(tmp_path / f"{name}.npy"), tmp_path / f"{name}.npy", "is not a plain array")
    (tmp_path / "empty.npy").touch()
    refusal(lambda: read_map(tmp_path / "empty.npy"), tmp_path / "empty.npy", "is not a plain array")
    (tmp_path / "archive.npy").write_bytes(b"PK\x03\x04nothing else")
    refusal(lambda: read_map(tmp_path / "archive.npy"), tmp_path / "archive.npy", "is not a plain array", "numpy.save")
    refusal(lambda: read_map(tmp_path / "gone.npy"), tmp_path / "gone.npy", "no such file", "numpy.save")
    refusal(lambda: read_map(tmp_path / "gone.png", palette=palette), tmp_path / "gone.png", "no such file", "give")
    refusal(lambda: read_map(tmp_path / "a.jpg"), tmp_path / "a.jpg", "is not a map", ".png, .npy, .yaml, .yml")


def test_maps_of_no_use(yard):
    remedy = "give a goal (--goals), next to ground that can be driven on: road, driveway, path, sidewalk, traversable"
    doorless = np.where(yard == FRONT_DOOR, GRASS, yard)
    refusal(lambda: map_from_classes(doorless), "the array: it has no front door", remedy)
    refusal(lambda: map_from_classes(np.full((2, 3), GRASS)), "it has no traversable ground", remedy)
    buried = np.where(yard == ROAD, GRASS, yard)
    buried[6, 4] = ROAD
    refusal(lambda: map_from_classes(buried), "no front door can be reached", remedy)
    terrain = map_from_classes(doorless, goals=[Goal(0, 3)])
    assert np.argwhere(terrain == FRONT_DOOR).tolist() == [[3, 0]]


def test_doors_that_a_coarse_grid_would_lose(yard):
    refusal(lambda: map_from_classes(yard.T, cells=(7, 4)), "every front door is too small", "7 x 4", "more cells")
    terrain = map_from_classes(yard.T, cells=(7, 4), goals=[Goal(3, 0)])
    assert np.argwhere(terrain == FRONT_DOOR).tolist() == [[0, 3]]


@pytest.mark.parametrize(
    ("goal", "mentions"),
    [
        (Goal(5, 0), ["goal (5, 0) lies at column 5, row 0, off the map of 5 x 7 cells"]),
        (Goal(0, -1), ["goal (0, -1) lies at column 0, row -1, off the map"]),
        (Goal(float("nan"), 1), ["goal (nan, 1) nan: give a number"]),
        (Goal(1, float("inf"), "meters"), ["goal (1, inf) inf: give a number"]),
        (Goal(1.5, 1), ["goal (1.5, 1) is between cells", "whole numbers"]),
        (Goal(1, 1, "meters"), ["goal (1, 1) is in meters", "only a ROS map"]),
        (Goal(0, 6), ["goal (0, 6) lies at column 0, row 6 on 'house'", "not traversable", "column 0, row 3"]),
    ],
)
def test_goals_off_the_ground(tmp_path, yard, goal, mentions):
    np.save(tmp_path / "yard.npy", yard)
    refusal(lambda: read_map(tmp_path / "yard.npy", goals=[goal]), tmp_path / "yard.npy", *mentions)


def test_a_goal_where_there_is_no_ground_at_all(tmp_path):
    np.save(tmp_path / "a.npy", np.full((2, 3), GRASS))
    refusal(lambda: draw_map(tmp_path / "a.npy", goals=[Goal(0, 0)]), "the map has no traversable ground at all")


@pytest.mark.parametrize("cells", [(6, 7), (5, 8), (0, 3), (3, -1)])
def test_grids_that_do_not_fit(yard, cells):
    mentions = (f"5 x 7 pixels cannot fill {cells[0]} x {cells[1]} cells", "at most 5 x 7 cells")
    refusal(lambda: map_from_classes(yard, cells=cells), "wrong grid size", *mentions)


def test_maps_of_two_sizes_cannot_be_run_together(tmp_path, yard):
    np.save(tmp_path / "tall.npy", yard)
    np.save(tmp_path / "wide.npy", yard.T)
    refusal(
        lambda: stack_worlds(map_dataset(tmp_path).houses),
        "tall has 5 x 7 cells, wide has 7 x 5", "one size", "'columns,rows' and '5,5' in cells.csv",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        ("map,x,y\nyard,1,2\n", ["lacks the column 'unit'"]),
        ("map,x,y,unit\nyrad,1,1,cells\n", ["line 2", "no map is called 'yrad'", "yard"]),
        ("map,x,y,unit\nyard,1,1,feet\n", ["line 2", "'feet'", "cells, meters"]),
        ("map,x,y,unit\nyard,1,one,cells\n", ["line 2", "'one'", "'y'", "write a number"]),
        ("map,x,y,unit\nyard,nan,1,cells\n", ["line 2", "nan:", "'x'"]),
    ],
)
def test_bad_tables_of_goals(tmp_path, yard, text, mentions):
    np.save(tmp_path / "yard.npy", yard)
    (tmp_path / "goals.csv").write_text(text)
    refusal(lambda: open_dataset(tmp_path), tmp_path / "goals.csv", *mentions)


@pytest.mark.parametrize("lines", ["5", "5,0", "5,4.5", "5,4\n5,4", "-5,4", f"5,{'9' * 4400}"])
def test_bad_sizes(tmp_path, yard, lines):
    np.save(tmp_path / "yard.npy", yard)
    (tmp_path / "cells.csv").write_text(f"columns,rows\n{lines}\n")
    refusal(lambda: open_dataset(tmp_path), tmp_path / "cells.csv", "line")


def test_bad_folders(tmp_path, yard):
    refusal(lambda: map_dataset(tmp_path), tmp_path, "holds no maps", ".png, .npy, .yaml, .yml")
    (tmp_path / "notes.txt").touch()
    refusal(lambda: open_dataset(tmp_path), tmp_path, "no house list", ".png, .npy, .yaml, .yml")
    (tmp_path / "test").mkdir()
    np.save(tmp_path / "test" / "yard.npy", yard)
    np.save(tmp_path / "loose.npy", yard)
    refusal(lambda: open_dataset(tmp_path), tmp_path / "loose.npy", "in none of them", "train, val, test")
    (tmp_path / "loose.npy").rename(tmp_path / "test" / "my yard.npy")
    refusal(lambda: open_dataset(tmp_path), tmp_path, "'my yard'", "letters")
    (tmp_path / "train").mkdir()
    (tmp_path / "test" / "my yard.npy").rename(tmp_path / "train" / "yard.npy")
    refusal(lambda: open_dataset(tmp_path), tmp_path / "test" / "yard.npy", "same name", "unique")


def test_a_map_of_no_use_in_a_folder_is_left_out_by_name(tmp_path, yard):
    np.save(tmp_path / "yard.npy", yard)
    np.save(tmp_path / "closed.npy", np.where(yard == FRONT_DOOR, GRASS, yard))
    houses = open_dataset(tmp_path).houses
    assert [(house.name, why_no_episode(house)) for house in houses] == [
        ("closed", "it has no front door"), ("yard", None),
    ]  # fmt: skip
    assert {start.house for start in sample_starts(houses, 3, seed=0)} == {"yard"}


def test_what_may_not_be_read_is_named(tmp_path, yard, monkeypatch):
    np.save(tmp_path / "yard.npy", yard)

    def deny(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "iterdir", deny)
    for read in (map_dataset, open_dataset):
        refusal(lambda read=read: read(tmp_path), tmp_path, "cannot be read", "Permission denied")
    with pytest.raises(InputError):
        read_map(tmp_path)
