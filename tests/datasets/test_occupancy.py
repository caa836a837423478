"""ROS occupancy maps: thresholds, frames and grids against plain loops, and one clear line for every fault."""

import math

import numpy as np
import pytest

from dc2g_jax.datasets.maps import Goal, draw_map, read_map
from dc2g_jax.datasets.occupancy import read_occupancy_map
from dc2g_jax.grid.terrain import FRONT_DOOR, HOUSE, ROAD, UNKNOWN
from tests.support.occupancy import save
from tests.support.refusals import refusal


def random_grays(seed: int, height: int = 17, width: int = 23) -> np.ndarray:
    return np.random.default_rng(seed).choice([0, 89, 90, 205, 206, 254, 255], (height, width)).astype(np.uint8)


@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("thresholds", [(0.196, 0.65), (0.25, 0.65), (0.0, 1.0), (0.5, 0.5)])
def test_thresholds_are_map_servers(tmp_path, negate, thresholds):
    grays = np.arange(256, dtype=np.uint8).reshape(8, 32)
    path = save(tmp_path, grays, negate=negate, free_thresh=thresholds[0], occupied_thresh=thresholds[1])
    terrain = draw_map(path)
    for gray, found in zip(grays.ravel(), terrain.ravel(), strict=True):
        occupancy = int(gray) / 255 if negate else (255 - int(gray)) / 255
        wanted = HOUSE if occupancy > thresholds[1] else ROAD if occupancy < thresholds[0] else UNKNOWN
        assert found == wanted


def test_the_gray_of_the_unknown_that_counts_as_free_is_doubted(tmp_path):
    grays = np.array([[0, 205, 254]], np.uint8)
    assert read_occupancy_map(save(tmp_path, grays)).doubt is None
    doubt = read_occupancy_map(save(tmp_path, grays, free_thresh=0.25)).doubt
    assert doubt is not None
    assert doubt.startswith("1 pixels are gray 205")
    assert "0.25" in doubt
    assert "write 0.196" in doubt


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, -0.3, 2.5])
def test_a_pixels_center_in_the_map_frame_lies_in_its_cell(tmp_path, yaw):
    height, width, resolution, x0, y0 = 17, 23, 0.05, -3.2, 7.0
    found = read_occupancy_map(save(tmp_path, random_grays(0), resolution=resolution, origin=[x0, y0, yaw]))
    for row in range(height):
        for column in range(width):
            right, up = (column + 0.5) * resolution, (height - row - 0.5) * resolution
            x = x0 + right * math.cos(yaw) - up * math.sin(yaw)
            y = y0 + right * math.sin(yaw) + up * math.cos(yaw)
            assert found.cell(x, y, width, height) == (column, row)
            coarse = (2 * column + 1) * 5 // (2 * width), 2 - (2 * (height - row) - 1) * 3 // (2 * height)
            assert found.cell(x, y, 5, 3) == coarse


@pytest.mark.parametrize("grid", [(23, 17), (7, 5), (22, 16), (1, 1), (23, 2)])
def test_a_coarser_cell_is_free_only_if_all_it_touches_is(tmp_path, grid):
    columns, rows = grid
    grays = random_grays(1)
    grays[4:13, 5:20] = 254
    path = save(tmp_path, grays)
    fine, coarse = draw_map(path), draw_map(path, cells=grid)
    height, width = fine.shape
    assert coarse.shape == (rows, columns)
    for row in range(rows):
        for column in range(columns):
            touched = fine[
                math.floor(row * height / rows + 1e-9) : math.ceil((row + 1) * height / rows - 1e-9),
                math.floor(column * width / columns + 1e-9) : math.ceil((column + 1) * width / columns - 1e-9),
            ]
            wanted = ROAD if np.all(touched == ROAD) else HOUSE if np.any(touched == HOUSE) else UNKNOWN
            assert coarse[row, column] == wanted


def test_goals_in_meters_and_in_cells(tmp_path):
    grays = np.full((40, 60), 254, np.uint8)
    path = save(tmp_path, grays, origin=[-1.0, -0.5, 0.0])
    terrain = read_map(path, goals=[Goal(-0.99, -0.49, "metres"), Goal(3, 2)])
    assert np.argwhere(terrain == FRONT_DOOR).tolist() == [[2, 3], [39, 0]]
    coarse = read_map(path, goals=[Goal(1.99, 1.49, "metres")], cells=(6, 4))
    assert np.argwhere(coarse == FRONT_DOOR).tolist() == [[0, 5]]
    refusal(
        lambda: read_map(path, goals=[Goal(1e308, -1e308, "metres")]),
        "in meters lies far off the map",
    )
    refusal(
        lambda: read_map(path, goals=[Goal(-1.01, 0, "metres")]),
        path, "goal (-1.01, 0) in meters lies at column -1", "off the map of 60 x 40 cells",
    )  # fmt: skip


def test_spellings_that_other_tools_write(tmp_path):
    path = save(tmp_path, random_grays(2), mode="trinary", resolution="5e-2", negate="false")
    assert read_occupancy_map(path).resolution == 0.05
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert read_occupancy_map(path).free.shape == (17, 23)
    absolute = tmp_path / "elsewhere.yaml"
    absolute.write_text(path.read_text().replace("lab.pgm", str(tmp_path / "lab.pgm")))
    assert read_occupancy_map(absolute).free.shape == (17, 23)


@pytest.mark.parametrize(
    ("facts", "mentions"),
    [
        ({"resolution": None}, ["lacks resolution", "a ROS map needs image, resolution"]),
        ({"image": None, "negate": None}, ["lacks image, negate"]),
        ({"resolution": 0}, ["resolution is 0.0", "meters of a pixel"]),
        ({"resolution": "fine"}, ["resolution has 'fine'", "not a number"]),
        ({"resolution": ".inf"}, ["resolution has inf", "not a number"]),
        ({"resolution": True}, ["resolution has True", "not a number"]),
        ({"origin": [0, 0]}, ["origin is [0, 0]", "[x, y, yaw]"]),
        ({"origin": "[0, 0, north]"}, ["origin has 'north'", "not a number"]),
        ({"free_thresh": 0.7}, ["free_thresh is 0.7", "occupied_thresh 0.65", "0 to 1"]),
        ({"occupied_thresh": 65}, ["occupied_thresh 65.0", "0 to 1"]),
        ({"negate": 2}, ["negate is 2", "0 where white is free"]),
        ({"mode": "scale"}, ["mode is 'scale'", "trinary"]),
        ({"image": "missing.pgm"}, ["missing.pgm: cannot be read", "lab.yaml names it"]),
    ],
)
def test_bad_facts(tmp_path, facts, mentions):
    path = save(tmp_path, random_grays(3), **facts)
    refusal(lambda: read_map(path), tmp_path, *mentions)


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        (b"", ["holds no keys"]),
        (b"- image\n", ["holds no keys"]),
        (b"image: [lab\nresolution: 1\n", ["line 2", "is not YAML", "repair"]),
        (b"image: \xff\n", ["offset 7", "not UTF-8"]),
        (b"image: \x00\n", ["is not YAML", "repair"]),
        (b"image: 2026-13-45\n", ["is not YAML", "month", "repair"]),
        (b"image: " + b"[" * 5000, ["is not YAML", "recursion", "repair"]),
    ],
)
def test_files_that_are_no_yaml(tmp_path, text, mentions):
    (tmp_path / "lab.yaml").write_bytes(text)
    refusal(lambda: read_map(tmp_path / "lab.yaml"), tmp_path / "lab.yaml", *mentions)


def test_a_missing_file(tmp_path):
    refusal(lambda: read_map(tmp_path / "lab.yaml"), tmp_path / "lab.yaml", "cannot be read", "give")


@pytest.mark.parametrize(
    ("data", "mentions"),
    [
        (b"", ["starts with nothing", "P5", "save the map as PGM"]),
        (b"P2\n2 1\n255\n0 1\n", ["50 32", "binary PGM"]),
        (b"\x89PNG\r\n\x1a\n", ["89 50 4e 47", "binary PGM"]),
        (b"P5\n2 2\n65535\n12345678", ["2 x 2 pixels of 0 to 65535", "0 to 255"]),
        (b"P5\n0 2\n255\n", ["0 x 2 pixels"]),
        (b"P5\n2 2\n255\n123", ["wrong size", "2 x 2 pixels need 4 bytes, but 3 follow"]),
        (b"P5 2 2 255 12345", ["wrong size", "need 4 bytes, but 5 follow"]),
    ],
)
def test_bad_pictures(tmp_path, data, mentions):
    path = save(tmp_path, random_grays(4))
    (tmp_path / "lab.pgm").write_bytes(data)
    refusal(lambda: read_map(path), tmp_path / "lab.pgm", *mentions)
