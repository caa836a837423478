import gzip
import math

import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.indoor.houses.dataset import indoor_houses
from dc2g_jax.indoor.houses.plans import MARGIN, world_from_plan
from dc2g_jax.indoor.houses.procthor import house_plan, read_procthor
from dc2g_jax.indoor.houses.worlds import IndoorWorld
from dc2g_jax.indoor.maps.classes import BED, BEDROOM, KITCHEN, OTHER, PLANT, TABLE, TELEVISION
from tests.support import house_lines
from tests.support.refusals import refusal
from tests.support.two_rooms import rooms_cut_off

BOXES = {asset: (entry["type"], *entry["box"]) for asset, entry in house_lines.BOXES.items()}


@pytest.fixture(scope="module")
def world() -> IndoorWorld:
    return world_from_plan(house_plan(house_lines.house(), BOXES), 0.1)


def cells_of(cells: np.ndarray) -> set[tuple[int, int]]:
    """Cells as (decimeters right of x = 0, decimeters above z = 0) of their middles."""
    rows, columns = np.nonzero(cells)
    first = round(MARGIN * 10 - 0.5)
    top = 30 + first
    return {(int(column) - first, top - int(row)) for row, column in zip(rows, columns, strict=True)}


def block(x: tuple[int, int], z: tuple[int, int]) -> set[tuple[int, int]]:
    return {(i, j) for i in range(x[0], x[1] + 1) for j in range(z[0], z[1] + 1)}


def test_walls_are_one_cell_thick_and_the_inner_door_alone_is_open(world):
    outer = block((0, 50), (0, 30)) - block((1, 49), (1, 29))
    # The hole is 0.5 to 1.5 m below z = 3.
    assert cells_of(world.walls) == outer | (block((30, 30), (0, 30)) - block((30, 30), (15, 25)))


def test_a_turned_bed_lies_across(world):
    # 1 x 2 m turned by 90 degrees around (1.05, 0.55): x from 0.05 to 2.05, z from 0.05 to 1.05.
    assert cells_of(world.classes == BED) == block((1, 20), (1, 10))
    assert np.unique(world.heights[world.classes == BED]) == pytest.approx(0.6)


def test_a_box_turned_by_an_eighth_is_a_diamond(world):
    half = 0.15 * math.sqrt(2)
    diamond = {(i, j) for i, j in block((36, 44), (16, 24)) if abs(i / 10 - 4) + abs(j / 10 - 2) <= half}
    assert cells_of(world.classes == OTHER) == diamond


def test_turns_are_clockwise_from_above():
    plain = house_lines.house()
    plain["objects"] = [plain["objects"][0]]
    plain["objects"][0]["rotation"]["y"] = 30
    plain["objects"][0]["position"] = {"x": 1.5, "y": 0.3, "z": 1.5}
    rows, columns = np.nonzero(world_from_plan(house_plan(plain, BOXES), 0.1).classes == BED)
    # Unity turns to the right: the far end of a bed along z moves to larger x, and up is toward smaller rows.
    assert np.corrcoef(columns, -rows)[0, 1] > 0.3


def test_a_child_covers_its_own_part_of_the_parent(world):
    table, plant = block((42, 48), (2, 6)), block((45, 47), (3, 5))
    assert cells_of(world.classes == PLANT) == plant
    assert cells_of(world.classes == TABLE) == table - plant
    assert np.unique(world.heights[world.classes == PLANT]) == pytest.approx(1.3)
    assert cells_of(world.classes == PLANT) == plant


def test_a_thin_television_has_the_cells_of_its_room_beside_the_wall(world):
    assert cells_of(world.classes == TELEVISION) == block((9, 21), (29, 29))


def test_what_is_left_out(world):
    # The cup, the picture on the wall, and the crate outside.
    assert sorted(world.object_kinds.tolist()) == sorted([BED, TABLE, PLANT, TELEVISION, OTHER])


def test_rooms_free_floor_and_places(world):
    assert world.room_kinds.tolist() == [0, BEDROOM, KITCHEN]
    assert set(np.unique(world.rooms[world.free])) == {1, 2}
    np.testing.assert_array_equal(world.free, (world.rooms > 0) & (world.heights == 0))
    assert not (world.free | world.obstacle)[[0, -1]].any()
    for kind, (x, y) in ((BED, (1.05, 0.55)), (PLANT, (4.6, 0.4))):
        rows, columns = np.nonzero(world.classes == kind)
        assert np.mean(columns + 0.5) * 0.1 == pytest.approx(x + MARGIN, abs=0.051)
        assert np.mean(rows + 0.5) * 0.1 == pytest.approx(3 - y + MARGIN, abs=0.051)
    assert set(world.rooms[(world.classes == BED)].tolist()) == {1}


@pytest.mark.parametrize("cell_size", [0.05, 0.07, 0.13])
def test_other_cells_see_the_same_house(cell_size):
    other = world_from_plan(house_plan(house_lines.house(), BOXES), cell_size)
    assert rooms_cut_off(other) == []
    assert other.free.sum() * cell_size**2 == pytest.approx(4.9 * 2.9 - 2.9 * 0.1 - 2 - 0.24 - 0.09, rel=0.08)


def without(name: str, place: int | None = None) -> dict:
    broken = house_lines.house()
    entry = broken if place is None else broken["objects"][place]
    del entry[name]
    return broken


def changed(value: object, *path: str | int) -> dict:
    broken = house_lines.house()
    entry = broken
    for step in path[:-1]:
        entry = entry[step]
    entry[path[-1]] = value
    return broken


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("{'rooms'", "not JSON"),
        ("[]", "list"),
        ("[" * 100_000, "not JSON"),
        (without("rooms"), "'rooms'"),
        (without("rotation", 0), "'rotation'"),
        (changed([], "rooms"), "0 rooms"),
        (changed("Garage", "rooms", 0, "roomType"), "Garage"),
        (changed("nowhere", "doors", 0, "wall0"), "nowhere"),
        (changed("throne", "objects", 1, "assetId"), "throne"),
        (changed(["x"], "objects", 1, "assetId"), "table of boxes"),
        (changed(float("nan"), "objects", 1, "position", "x"), "nan"),
        (changed(1e6, "walls", 1, "polygon", 0, "x"), "1000000"),
        (changed(True, "walls", 1, "polygon", 0, "x"), "True"),
        (changed(7, "objects", 1, "children"), "children"),
    ],
)
def test_a_malformed_line_is_named(tmp_path, line, said):
    path = house_lines.write(tmp_path, house_lines.house(), "", line, house_lines.house())
    refusal(lambda: read_procthor(path), f"{path}: line 3 is not a house", said, "repair or delete the line")
    path = house_lines.write(tmp_path, house_lines.house(), "", "", house_lines.house())
    assert [number for number, _ in read_procthor(path)] == [1, 4]


def test_what_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no house"):
        read_procthor(house_lines.write(tmp_path, ""))
    with pytest.raises(InputError, match="no such file"):
        read_procthor(tmp_path / "val.jsonl")
    with gzip.open(tmp_path / "test.jsonl.gz", "wb", 1) as file:
        for _ in range(20):
            file.write(bytes(2**20))
    with pytest.raises(InputError, match="line 1 has more than 16777216 bytes"):
        read_procthor(tmp_path / "test.jsonl.gz")
    damaged = tmp_path / "val.jsonl.gz"
    damaged.write_bytes(gzip.compress(b"x" * 5000)[:-9])
    with pytest.raises(InputError, match="cannot be read"):
        read_procthor(damaged)
    (tmp_path / "asset_boxes.json").write_text('{"a": {"type": "Bed", "box": [1, 2]}}')
    with pytest.raises(InputError, match="asset 'a'"):
        read_procthor(damaged)
    (tmp_path / "asset_boxes.json").unlink()
    with pytest.raises(InputError, match=r"asset_boxes\.json: no such file"):
        read_procthor(damaged)


def test_splits_are_files(tmp_path):
    house_lines.write(tmp_path, house_lines.house(), house_lines.house())
    houses = indoor_houses(tmp_path, "train", cell_size=0.1)
    assert [house.name for house in houses] == ["train-1", "train-2"]
    with pytest.raises(InputError, match="less than 3"):
        indoor_houses(tmp_path, "train", count=3)
    with pytest.raises(InputError, match=r"no test\.jsonl\.gz or test\.jsonl"):
        indoor_houses(tmp_path, "test")
    with pytest.raises(InputError, match="no split"):
        indoor_houses(tmp_path, "tests")


@pytest.fixture(scope="module")
def sample(shared) -> list:
    folder = shared / "datasets" / "procthor_tiny"
    if not folder.is_dir():
        pytest.skip("../shared/datasets/procthor_tiny is absent")
    return [house for split in ("train", "val", "test") for house in indoor_houses(folder, split, cell_size=0.1)]


def test_all_houses_of_the_sample_are_closed(sample):
    assert len(sample) == 60
    for house in sample:
        world = house.world
        # From free floor no step, not even a diagonal one, leads outside.
        grown = np.pad(world.free, 1)
        around = [np.roll(grown, (i, j), (0, 1))[1:-1, 1:-1] for i in (-1, 0, 1) for j in (-1, 0, 1)]
        assert not np.any(np.any(around, axis=0) & (world.rooms == 0) & ~world.obstacle), house.name
        assert np.isin(np.arange(1, len(world.room_kinds)), world.rooms).all(), house.name


def test_every_room_of_the_sample_can_be_reached(sample):
    assert {house.name: rooms_cut_off(house.world) for house in sample if rooms_cut_off(house.world)} == {}
