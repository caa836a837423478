"""Maps from OpenStreetMap extracts: a small one drawn by hand, in every format, and one clear line for every fault."""

import gzip
import math

import numpy as np
import osmium
import pytest

from dc2g_jax._src.grid.ground import connected_to_goal
from dc2g_jax._src.grid.sampling import resize_nearest, sample_grid
from dc2g_jax._src.grid.terrain import (
    CLASS_NAMES,
    DRIVEWAY,
    FENCE,
    FRONT_DOOR,
    GRASS,
    HOUSE,
    PATH,
    ROAD,
    SIDEWALK,
    TREE,
    UNKNOWN,
)  # fmt: skip
from dc2g_jax.osm._shapes import sidewalk_sides, street_width
from dc2g_jax.osm.extract import Extract, read_extract
from dc2g_jax.osm.neighborhood import BuildingMap, Neighborhood
from tests.support.hamlet import LATITUDE, LONGITUDE, METERS_A_DEGREE, Drawing, hamlet, with_tags
from tests.support.refusals import refusal


def read(folder, text: str) -> Extract:
    (folder / "hamlet.osm").write_text(text)
    return read_extract(folder / "hamlet.osm")


def neighborhood(extract: Extract, **changed) -> Neighborhood:
    return Neighborhood(extract, **{"meters": 60.0, "cells": 50, "seed": 0, "only_mapped": False, **changed})


def maps_of(extract: Extract, **changed) -> dict[str, BuildingMap | str]:
    drawn = neighborhood(extract, **changed)
    return {building.name: drawn.map_of(building) for building in drawn.buildings}


def classes_at(drawn: BuildingMap, extract: Extract, points: list[tuple[float, float]]) -> list[str]:
    """Names of the classes of points of the hamlet on a map of 60 m."""
    scale = METERS_A_DEGREE * np.array([math.cos(math.radians(LATITUDE)), -1])
    center = (np.array([drawn.longitude, drawn.latitude]) - (LONGITUDE, LATITUDE)) * scale
    pixels = (np.array(points) - center + 30) * len(drawn.classes) / 60
    return [CLASS_NAMES[drawn.classes[int(y), int(x)]] for x, y in pixels]


def test_what_is_mapped_is_where_it_is_mapped(tmp_path):
    extract = read(tmp_path, hamlet().text())
    drawn = maps_of(extract, only_mapped=True)
    assert drawn["way4"] == "no front door is mapped"
    house = drawn["way2"]
    assert isinstance(house, BuildingMap)
    points = {
        (-20, -20): "house", (-24, -16): "house", (-27, -20): "grass", (-20, 0): "road", (-20, 3.5): "road",
        (-20, -3.5): "road", (-10, 5): "sidewalk", (-10, -5): "grass", (-20, -9): "path", (-22, -9): "grass",
        (-20, -14): "front_door", (-8, -20): "tree", (-30, -34): "fence", (17, -25): "grass",
    }  # fmt: skip
    inside = [point for point in points if abs(point[0] + 20) < 29]
    assert dict(zip(inside, classes_at(house, extract, inside), strict=True)) == {p: points[p] for p in inside}
    assert not house.added.any()
    assert abs(house.latitude - LATITUDE) < 30 / METERS_A_DEGREE


def test_a_node_without_a_place_is_left_out(tmp_path):
    text = hamlet().text()
    placeless = '<node id="999" version="2"><tag k="natural" v="tree"/></node>'
    extract = read(tmp_path, text.replace("<way", placeless + "<way", 1))
    assert len(extract.spots) == len(read(tmp_path, text).spots)


def test_doors_and_driveways_are_added_and_marked(tmp_path):
    extract = read(tmp_path, hamlet().text())
    before, added = maps_of(extract, only_mapped=True)["way2"], maps_of(extract)
    assert set(added) == {"way2", "way4"}  # no map of a shed
    house = added["way4"]
    assert isinstance(house, BuildingMap)
    grid = sample_grid(house.classes, 50)
    connected = connected_to_goal(grid)
    assert np.any(connected & (grid == ROAD))
    assert np.all(connected[grid == FRONT_DOOR])
    own = set(np.unique(house.added)) - {UNKNOWN}
    assert {FRONT_DOOR, PATH} <= own <= {FRONT_DOOR, PATH, DRIVEWAY}
    assert np.all((house.added == UNKNOWN) | (house.added == house.classes))
    # The door faces the street, to the south.
    rows, columns = np.nonzero(house.added == FRONT_DOOR)
    assert np.mean(house.classes[rows.min() - 5, columns] == HOUSE) > 0.5
    assert np.mean(house.classes[rows.max() + 5, columns] == HOUSE) == 0
    # Where nothing is added, the map is as without additions.
    mapped = added["way2"]
    assert np.array_equal(np.where(mapped.added, 0, mapped.classes), np.where(mapped.added, 0, before.classes))


def test_additions_depend_on_the_seed_and_mapped_ground_does_not(tmp_path):
    extract = read(tmp_path, hamlet().text())
    first, again, other = (maps_of(extract, seed=seed)["way4"] for seed in (0, 0, 1))
    assert np.array_equal(first.classes, again.classes)
    assert not np.array_equal(first.classes, other.classes)
    kept = (first.added == UNKNOWN) & (other.added == UNKNOWN)
    assert np.array_equal(first.classes[kept], other.classes[kept])


def test_all_formats_read_alike(tmp_path):
    text = hamlet().text()
    plain = read(tmp_path, text)
    (tmp_path / "hamlet.osm.gz").write_bytes(gzip.compress(text.encode()))
    with osmium.SimpleWriter(str(tmp_path / "hamlet.osm.pbf")) as writer:
        for element in osmium.FileProcessor(str(tmp_path / "hamlet.osm")):
            writer.add(element)
    expected = maps_of(plain)["way4"].classes
    for name in ("hamlet.osm.gz", "hamlet.osm.pbf"):
        extract = read_extract(tmp_path / name)
        assert np.allclose(extract.center, plain.center)
        assert np.array_equal(maps_of(extract)["way4"].classes, expected), name


def test_narrow_things_appear_on_coarse_grids(tmp_path):
    extract = read(tmp_path, hamlet().text())
    drawn = maps_of(extract, cells=20)["way4"]
    grid = sample_grid(drawn.classes, 20)
    assert len(drawn.classes) % 20 == 0
    assert np.any(connected_to_goal(grid) & (grid == ROAD))
    house = resize_nearest(maps_of(extract, cells=20, only_mapped=True)["way2"].classes, 20, 20)
    assert {FENCE, TREE, SIDEWALK, PATH} <= set(np.unique(house))


def courtyard(way_tags: str) -> Drawing:
    """A building around a courtyard, as a relation, whose outer way may have tags too."""
    drawing = hamlet()
    drawing.box(7, 30, -34, 60, -10, way_tags)
    drawing.box(8, 38, -28, 52, -18, "")
    drawing.elements.append(
        '<relation id="9" version="1"><member type="way" ref="7" role="outer"/><member type="way" ref="8" '
        f'role="inner"/>{with_tags("type=multipolygon building=apartments")}</relation>'
    )
    return drawing


def test_courtyards_are_open(tmp_path):
    extract = read(tmp_path, courtyard("").text())
    drawn = maps_of(extract)["relation9"]
    assert classes_at(drawn, extract, [(45, -23), (34, -23), (45, -31)]) == ["grass", "house", "house"]


def test_a_building_on_a_relation_and_its_outer_way_is_one(tmp_path):
    """The map is that of the relation, whose courtyard is open, with the address of the way."""
    extract = read(tmp_path, courtyard("building=yes addr:housenumber=5").text())
    assert set(maps_of(extract)) == {"way2", "way4", "relation9"}
    (building,) = [building for building in extract.buildings if building.name == "relation9"]
    assert building.tags == {"building": "apartments", "addr:housenumber": "5"}
    alone = read(tmp_path, courtyard("").text())
    assert np.array_equal(maps_of(extract)["relation9"].classes, maps_of(alone)["relation9"].classes)


def test_what_is_underground_or_indoors_is_not_drawn(tmp_path):
    drawing = hamlet()
    for number, tags in enumerate(("tunnel=yes", "layer=-1", "indoor=yes", "location=underground"), 20):
        drawing.way(number, [(-38, -10), (-26, -10)], f"highway=service {tags}")
    extract = read(tmp_path, drawing.text())
    drawn = maps_of(extract, only_mapped=True)["way2"]
    assert classes_at(drawn, extract, [(-32, -10)]) == ["grass"]
    drawing.way(30, [(-38, -10), (-26, -10)], "highway=service")
    extract = read(tmp_path, drawing.text())
    assert classes_at(maps_of(extract, only_mapped=True)["way2"], extract, [(-32, -10)]) == ["road"]


def test_buildings_far_from_streets_or_walled_in_are_left_out(tmp_path):
    drawing = hamlet()
    drawing.box(10, -70, -95, -60, -85, "building=house")
    drawing.box(11, 12, -43, 22, -33, "building=house addr:housenumber=5")  # behind 4
    drawing.box(12, -10, -32, 9, -10, "building=yes addr:housenumber=2")
    drawing.box(13, 25, -52, 45, -10, "building=yes addr:housenumber=4")
    drawn = maps_of(read(tmp_path, drawing.text()))
    assert drawn["way10"] == "no street is near enough to be on its map"
    assert drawn["way11"] == "no wall faces a street with nothing between"


def test_outlines_of_any_kind(tmp_path):
    """Round, with hundreds of corners, with repeated points, and too small for a map."""
    drawing = hamlet()
    turns = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    circle = [drawing.node(-50 + 3 * math.cos(turn), -14 + 3 * math.sin(turn)) for turn in turns]
    drawing.way(16, [*circle, circle[0]], "building=garage")
    corner = drawing.node(30, -20)
    drawing.way(17, [corner, (30, -10), (30, -10), (42, -10), (42, -20), corner], "building=house")
    drawing.box(18, 50, -12, 50.1, -11.9, "building=yes")
    drawing.way(19, [(44, -20), (44, -20)], "highway=footway")
    drawn = maps_of(read(tmp_path, drawing.text()))
    assert set(drawn) == {"way2", "way4", "way17"}
    assert all(isinstance(one, BuildingMap) for one in drawn.values())


def test_only_a_place(tmp_path):
    drawing = hamlet()
    drawing.way(14, [(500, -100), (500, 100)], "highway=residential")
    drawing.box(15, 510, -6, 522, 6, "building=house")
    (tmp_path / "hamlet.osm").write_text(drawing.text())
    east = LONGITUDE + 505 / (METERS_A_DEGREE * math.cos(math.radians(LATITUDE)))
    extract = read_extract(tmp_path / "hamlet.osm", (LATITUDE, east), 120.0)
    assert [building.name for building in neighborhood(extract, around=True).buildings] == ["way15"]


@pytest.mark.parametrize(
    ("tags", "width"),
    [
        ({"highway": "residential"}, 7.5), ({"highway": "residential", "width": "5.5 m"}, 5.5),
        ({"highway": "primary", "lanes": "4"}, 13.8), ({"highway": "service", "width": "narrow"}, 4.5),
        ({"highway": "service", "width": "0"}, 2.5), ({"highway": "trunk", "width": "12'"}, 10.0),
    ],
)  # fmt: skip
def test_street_widths(tags, width):
    assert street_width(tags) == pytest.approx(width)


@pytest.mark.parametrize(
    ("tags", "sides"),
    [
        ({}, None), ({"sidewalk": "both"}, (True, True)), ({"sidewalk": "left"}, (True, False)),
        ({"sidewalk": "separate"}, (False, False)), ({"sidewalk:right": "yes"}, (False, True)),
    ],
)  # fmt: skip
def test_sidewalk_sides(tags, sides):
    assert sidewalk_sides(tags) == sides


@pytest.mark.parametrize(
    ("name", "data", "mentions"),
    [
        ("a.osm", b"", ["is empty", "again"]),
        ("a.osm", b'<osm version="0.6"></osm>', ["no buildings and no streets", "extract of a neighborhood"]),
        ("a.osm", hamlet().text().encode()[:900], ["damaged or cut off", "again"]),
        ("a.osm.gz", gzip.compress(hamlet().text().encode())[:300], ["damaged or cut off", "again"]),
        ("a.osm.pbf", b"no protocol buffer", ["damaged or cut off", "again"]),
        ("a.osm", b"<html>no such page</html>", ["damaged or cut off", "html"]),
        ("a.geojson", b"{}", ["is no OpenStreetMap extract", ".osm.pbf"]),
        ("a.osm", b'<osm version="0.6"><node id="1" version="1" lat="5934000.2" lon="565000"/></osm>',
         ["is not in degrees", "5934000.2", "WGS 84"]),
        ("a.osm", hamlet().text().replace(f'lat="{LATITUDE + 20 / METERS_A_DEGREE:.7f}"', 'lat="93"').encode(),
         ["latitude 93", "WGS 84"]),
        ("a.osm", hamlet().text().replace('"highway"', '"way"').encode(), ["no streets"]),
        ("a.osm", hamlet().text().replace('"building"', '"structure"').encode(), ["no buildings"]),
        ("a.osm", hamlet().text().replace(f'lon="{LONGITUDE:.7f}"', 'lon="0"').encode(), ["too far for one plane"]),
    ],
)  # fmt: skip
def test_files_that_are_no_extracts(tmp_path, name, data, mentions):
    (tmp_path / name).write_bytes(data)
    refusal(lambda: read_extract(tmp_path / name), tmp_path / name, *mentions)


def test_a_clipped_extract(tmp_path):
    """Ways without their nodes."""
    text = "".join(element for element in hamlet().elements if not element.startswith("<node"))
    (tmp_path / "a.osm").write_text(f'<osm version="0.6">{text}</osm>')
    refusal(
        lambda: read_extract(tmp_path / "a.osm"), "no buildings and no streets", "ways that lack nodes: 6", "whole ways"
    )
    # A street that is cut off at the edge is drawn as far as it goes.
    whole, cut = hamlet(), hamlet()
    cut.elements.remove(next(element for element in cut.elements if element.startswith('<node id="3"')))
    extract = read(tmp_path, cut.text())
    assert extract.incomplete == 1
    assert len(read(tmp_path, whole.text()).streets) == 1
    refusal(lambda: read_extract(tmp_path / "missing.osm"), "missing.osm", "no such file")
    refusal(lambda: read_extract(tmp_path / "hamlet.osm", (93.0, 0.0)), "--around", "latitude 93", "degrees")
    refusal(lambda: read_extract(tmp_path / "hamlet.osm", (10.0, 0.0), 100.0), "within 100 m of 10 0", "no buildings")


def test_real_extracts(shared_files):
    """Each has a map of a building with a door that a street leads to."""
    files = shared_files("datasets/osm", "*.osm.gz")
    assert len(files) == 10
    for file in files:
        drawn = neighborhood(read_extract(file))
        first = next(one for one in map(drawn.map_of, drawn.buildings) if isinstance(one, BuildingMap))
        grid = sample_grid(first.classes, 50)
        assert np.any(connected_to_goal(grid) & (grid == ROAD))
        assert np.any(grid == HOUSE)
        assert np.any(grid == GRASS)
