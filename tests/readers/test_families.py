"""Families of maps: those without classes, and datasets gathered from several."""

import numpy as np
import pytest

from dc2g_jax._src.grid.ground import connected_to_goal
from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, OCCUPIED, TRAVERSABLE
from dc2g_jax._src.readers import families
from dc2g_jax._src.readers.families import family_of, field_of_view_of, gather
from dc2g_jax._src.readers.houses import House, HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import why_no_episode
from dc2g_jax.families import plain
from dc2g_jax.families.plain import PLAIN, plain_maps, with_door
from dc2g_jax.indoor.houses import dataset as indoor
from tests.support.hamlet import Drawing, hamlet
from tests.support.maps import drawn
from tests.support.refusals import refusal

YARD = drawn("####D# ..#.P. ..##P. SSSSSS RRRRRR")


@pytest.mark.parametrize("kind", PLAIN)
def test_plain_maps(kind):
    maps = plain_maps(kind)
    assert [split for _, split, _ in maps] == ["val"] * 100 + ["test"] * 100
    assert len({classes.tobytes() for _, _, classes in maps}) == len({name for name, _, _ in maps}) == 200
    for name, _, classes in maps:
        assert set(np.unique(classes)) == {FREE, OCCUPIED, FRONT_DOOR}, name
        assert np.sum(classes == FRONT_DOOR) == 1
        np.testing.assert_array_equal(connected_to_goal(classes), TRAVERSABLE[classes])
    assert all(np.array_equal(one[2], again[2]) for one, again in zip(maps, plain_maps(kind), strict=True))
    assert any(not np.array_equal(one[2], other[2]) for one, other in zip(maps, plain_maps(kind, 1), strict=True))


def test_some_mazes_have_a_single_way_to_every_place():
    """In corridors of one width on a grid of squares, a tree has one opening less than squares."""
    trees = 0
    for seed in range(20):
        free = plain.draw_maze(np.random.default_rng(seed))
        wide = next(wide for wide in range(2, 6) if not any(free[1 + wide :: wide + 1, 1 + wide :: wide + 1].ravel()))
        squares = 49 // (wide + 1)
        corners = 1 + (wide + 1) * np.arange(squares)
        assert free[np.ix_(corners, corners)].all()
        openings = np.sum(free[np.ix_(corners, corners[1:] - 1)]) + np.sum(free[np.ix_(corners[1:] - 1, corners)])
        assert openings >= squares**2 - 1
        trees += openings == squares**2 - 1
    assert 3 < trees < 20


def test_a_map_with_little_ground_is_no_map():
    free = np.zeros((10, 10), bool)
    free[0], free[2:4] = True, True
    drawn_map = with_door(free, np.random.default_rng(0))
    assert not TRAVERSABLE[drawn_map[0]].any()
    free[2:4] = False
    assert with_door(free, np.random.default_rng(0)) is None


def test_floor_plans(monkeypatch):
    monkeypatch.setattr(indoor, "_MAPS", 2)
    dataset = open_dataset("floor_plans")
    assert [house.split for house in dataset.houses] == ["val", "val", "test", "test"]
    for house in dataset.houses:
        assert house.terrain.shape == (50, 50)
        assert why_no_episode(house) is None
        assert np.any(TRAVERSABLE[house.terrain[-4:]]) or np.any(TRAVERSABLE[house.terrain[:, -4:]])


def test_a_folder_of_extracts_is_a_dataset(tmp_path):
    pytest.importorskip("osmium")
    (tmp_path / "hamlet.osm").write_text(hamlet().text())
    dataset = open_dataset(tmp_path)
    assert dataset.name == tmp_path.name
    assert dataset.houses
    for house in dataset.houses:
        assert (house.split, house.terrain.shape, why_no_episode(house)) == ("test", (50, 50), None)
        assert house.name.startswith("hamlet-way")
    remote = Drawing()
    remote.way(1, [(0, 0), (80, 0)], "highway=residential")
    remote.box(2, 0, -500, 12, -490, "building=house")
    (tmp_path / "hamlet.osm").write_text(remote.text())
    refusal(lambda: open_dataset(tmp_path), tmp_path, "street in reach", "other extracts")


# --- gathering ------------------------------------------------------------------------------------------


def two_sizes() -> HouseDataset:
    small = [House(f"small{number}", "val", YARD) for number in range(3)]
    large = [House(f"large{number}", "val", np.vstack([YARD, YARD[-1:]])) for number in range(5)]
    return HouseDataset("mine", "folder", (*small, *large, House("shut", "val", YARD[:, :3])))


def no_dataset() -> None:
    pass


MINE = f"{__name__}:two_sizes"


def test_families_have_one_size_and_their_maps_are_spread():
    assert [house.name for house in gather([MINE], "val", 3, 36).houses] == [
        "mine/large0",
        "mine/large2",
        "mine/large4",
    ]
    assert [house.name for house in gather([MINE], "val", 9, 35).houses] == [f"mine/small{n}" for n in range(3)]
    both = gather([MINE, "mazes"], "val", 2, 2500).houses
    assert [family_of(house.name) for house in both] == ["mine", "mine", "mazes", "mazes"]


def test_a_family_with_a_field_of_view(tmp_path, monkeypatch):
    assert [house.name for house in gather([f"{MINE}@67.5"], "val", 1, 36).houses] == ["mine@67.5/large0"]
    assert field_of_view_of("mine@67.5") == ("mine", 67.5)
    assert field_of_view_of("mine@home") == ("mine@home", None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "maps@2024").mkdir()
    assert field_of_view_of("maps@2024") == ("maps@2024", None)


def test_families_that_cannot_be_gathered(monkeypatch):
    refusal(lambda: gather([MINE, MINE], "val", 1, 99), "mine", "rename it")
    refusal(lambda: gather([MINE], "val", 1, 5), "mine", "--most-cells")
    refusal(lambda: gather([MINE], "test", 1, 99), "mine", "leave the family out")
    refusal(lambda: gather([f"{__name__}:no_dataset"], "val", 1, 99), ":no_dataset'", "give a HouseDataset")
    refusal(lambda: gather(["no_such_family"], "val", 1, 99), "'no_such_family'", "mazes")
    monkeypatch.setattr(families, "open_dataset", lambda location: two_sizes())
    refusal(lambda: gather(["published"], "val", 1, 99), "published", "mine", "leave it out")
