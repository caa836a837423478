"""ROS occupancy maps: thresholds, frames and grids against plain loops, and one clear line for every fault."""

import math

import numpy as np
import pytest
from PIL import Image

from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, OCCUPIED, UNKNOWN
from dc2g_jax._src.readers.maps import Goal, draw_map, read_map
from dc2g_jax._src.readers.occupancy import read_occupancy_map
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
        wanted = OCCUPIED if occupancy > thresholds[1] else FREE if occupancy < thresholds[0] else UNKNOWN
        assert found == wanted


def test_the_gray_of_the_unknown_that_counts_as_free_is_doubted(tmp_path):
    grays = np.array([[0, 205, 254]], np.uint8)
    assert read_occupancy_map(save(tmp_path, grays)).doubts == ()
    (doubt,) = read_occupancy_map(save(tmp_path, grays, free_thresh=0.25)).doubts
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
            wanted = FREE if np.all(touched == FREE) else OCCUPIED if np.any(touched == OCCUPIED) else UNKNOWN
            assert coarse[row, column] == wanted


def test_goals_in_meters_and_in_cells(tmp_path):
    grays = np.full((40, 60), 254, np.uint8)
    path = save(tmp_path, grays, origin=[-1.0, -0.5, 0.0])
    terrain = read_map(path, goals=[Goal(-0.99, -0.49, "meters"), Goal(3, 2)])
    assert np.argwhere(terrain == FRONT_DOOR).tolist() == [[2, 3], [39, 0]]
    coarse = read_map(path, goals=[Goal(1.99, 1.49, "meters")], cells=(6, 4))
    assert np.argwhere(coarse == FRONT_DOOR).tolist() == [[0, 5]]
    refusal(lambda: read_map(path, goals=[Goal(1e308, -1e308, "meters")]), "in meters lies far off the map")
    refusal(
        lambda: read_map(path, goals=[Goal(-1.01, 0, "meters")]),
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
        ({"resolution": 0}, ["resolution 0.0:", "meters of a pixel"]),
        ({"resolution": "fine"}, ["resolution 'fine':", "give a number"]),
        ({"resolution": ".inf"}, ["resolution inf:", "give a number"]),
        ({"resolution": True}, ["resolution True:", "give a number"]),
        ({"origin": [0, 0]}, ["origin is [0, 0]", "[x, y, yaw]"]),
        ({"origin": "[0, 0, north]"}, ["origin 'north':", "give a number"]),
        ({"free_thresh": 0.7}, ["occupied_thresh 0.65:", "from 0.7 to 1"]),
        ({"occupied_thresh": 65}, ["occupied_thresh 65.0:", "from 0.196 to 1"]),
        ({"negate": 2}, ["negate is 2", "0 where white is free"]),
        ({"mode": "Scale"}, ["no mode is called 'Scale'", "trinary, scale, raw"]),
        ({"mode": 3}, ["no mode is called 3", "trinary, scale, raw"]),
        ({"origin": "[[[[[0, 0, 0]]]]]"}, ["origin is [[[[...]]]]", "[x, y, yaw]"]),
        ({"resolution": "[" + "9, " * 500 + "9]"}, ["resolution [9, 9, 9", "give a number"]),
        ({"resolution": "0x" + "f" * 9000}, ["resolution a number of 36000 bits", "give a number"]),
        ({"image": 7}, ["image is 7", "name of a PGM or PNG"]),
        ({"image": '"a\\0b"'}, ["not the name of a file", "lab.yaml names"]),
        ({"image": "missing.pgm"}, ["missing.pgm: no such file", "lab.yaml names"]),
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
        (b"image: &a [x, x]\nresolution: *a\n", ["aliases are not read", "repair"]),
        (b"image: 2026-13-45\n", ["is not YAML", "month", "repair"]),
        (b"image: " + b"[" * 5000, ["is not YAML", "nested too deeply", "repair"]),
    ],
)
def test_files_that_are_no_yaml(tmp_path, text, mentions):
    (tmp_path / "lab.yaml").write_bytes(text)
    refusal(lambda: read_map(tmp_path / "lab.yaml"), tmp_path / "lab.yaml", *mentions)


def expected_value(pixel: tuple[int, ...], mode: str, negate: int, low: float, high: float) -> int:
    """The value that map_server gives a pixel, (gray,), (gray, alpha), (r, g, b) or (r, g, b, alpha): -1 or percent."""
    colors = pixel[:1] * 3 if len(pixel) < 3 else pixel[:3]
    alpha = pixel[-1] if len(pixel) in (2, 4) else None
    channels = [*colors, alpha] if mode == "trinary" and alpha is not None else colors
    shade = sum(channels) / len(channels) / 255
    occupancy = shade if negate else 1 - shade
    if mode == "raw":
        return round(shade * 255) if round(shade * 255) <= 100 else -1
    if mode == "scale" and alpha not in (None, 255):
        return -1
    if occupancy > high:
        return 100
    if occupancy < low:
        return 0
    return -1 if mode == "trinary" else round((occupancy - low) / (high - low) * 100)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_pictures_and_modes_are_map_servers(tmp_path, mode, negate, channels):
    rng = np.random.default_rng(channels)
    pixels = rng.integers(0, 256, (16, 24, channels)).astype(np.uint8)
    pixels[::2, ::2] = rng.choice([0, 100, 101, 205, 254, 255], (8, 12, 1))
    if channels in (2, 4):
        pixels[..., -1] = rng.choice([0, 254, 255, 255, 255], (16, 24))
    pixels[0, 0] = pixels[-1, -1] = 0  # known in any mode, if it is opaque
    if channels in (2, 4):
        pixels[[0, -1], [0, -1], -1] = 255
    path = save(
        tmp_path, pixels[..., 0], image="lab.png", mode=mode, negate=negate, free_thresh=0.2, occupied_thresh=0.7
    )
    Image.fromarray(pixels[..., 0] if channels == 1 else pixels).save(tmp_path / "lab.png")
    found = read_occupancy_map(path)
    assert found.free.shape == (16, 24)
    for row, column in np.ndindex(16, 24):
        value = expected_value(tuple(map(int, pixels[row, column])), mode, negate, 0.2, 0.7)
        assert (found.free[row, column], found.occupied[row, column]) == (0 <= value < 100, value == 100)


@pytest.mark.parametrize(
    ("mode", "dtype", "white"), [("P", np.uint8, 255), ("1", np.uint8, 255), ("", np.uint16, 65535)]
)
def test_other_pictures(tmp_path, mode, dtype, white):
    free = np.random.default_rng(1).random((12, 15)) < 0.5
    picture = Image.fromarray(np.where(free, white, 0).astype(dtype))
    path = save(tmp_path, free.astype(np.uint8), image="lab.png")
    (picture.convert(mode) if mode else picture).save(tmp_path / "lab.png")
    found = read_occupancy_map(path)
    assert np.array_equal(found.free, free)
    assert np.array_equal(found.occupied, ~free)


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_maps_that_are_mostly_unknown_are_cropped(tmp_path, yaw):
    grays = np.full((50, 70), 205, np.uint8)
    grays[12:30, 20:33] = 254
    grays[14, 25] = 0
    path = save(tmp_path, grays, origin=[2.0, 3.0, yaw])
    found = read_occupancy_map(path)
    assert found.free.shape == (18, 13)
    (doubt,) = found.doubts
    assert "columns 20 to 32 and rows 12 to 29" in doubt
    # A point of the map frame lies on the same pixel as before.
    right, up = (20 + 5.5) * 0.05, (50 - 14 - 0.5) * 0.05
    x, y = 2 + right * math.cos(yaw) - up * math.sin(yaw), 3 + right * math.sin(yaw) + up * math.cos(yaw)
    assert found.cell(x, y, 13, 18) == (5, 2)
    assert found.occupied[2, 5]
    grays[:, :40] = 254  # no longer most of it
    assert read_occupancy_map(save(tmp_path, grays)).free.shape == (50, 70)
    assert read_occupancy_map(save(tmp_path, np.full((5, 7), 205, np.uint8))).free.shape == (5, 7)


def test_an_image_that_never_ends(tmp_path):
    path = save(tmp_path, random_grays(3), image="/dev/zero")
    refusal(lambda: read_map(path), "/dev/zero: cannot be read", "a device", "lab.yaml names")


def test_a_missing_file(tmp_path):
    refusal(lambda: read_map(tmp_path / "lab.yaml"), tmp_path / "lab.yaml", "no such file", "give")


@pytest.mark.parametrize(
    ("data", "mentions"),
    [
        (b"", ["starts with nothing", "P5", "PNG"]),
        (b"P2\n2 1\n255\n0 1\n", ["50 32", "binary PGM"]),
        (b"\x89PNG\r\n\x1a\n", ["lab.pgm: ", "PNG"]),
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


def test_real_maps(shared_files):
    """All are read, and have ground to drive on."""
    files = shared_files("datasets/ros_maps", "*.yaml")
    assert len(files) == 8
    for file in files:
        assert np.any(draw_map(file) == FREE), file
