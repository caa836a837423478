"""Loading houses: the golden grids cell for cell, and one clear line for everything that can be wrong."""

import dataclasses
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dc2g_jax import families
from dc2g_jax._src.files.class_images import read_class_image, read_palette, write_class_image
from dc2g_jax._src.grid.terrain import CLASS_COLORS, CLASS_NAMES, FRONT_DOOR, HOUSE, PATH, ROAD
from dc2g_jax._src.readers import houses as houses_module
from dc2g_jax._src.readers._download import NetworkUnavailable
from dc2g_jax._src.readers.houses import House, HouseDataset, group_of, load_dataset, open_dataset
from dc2g_jax._src.runtime.errors import InputError
from tests.files.pngs import chunk, png
from tests.support.houses import save_dataset
from tests.support.places import PUBLISHED, SHARED
from tests.support.refusals import refusal

GOLDEN = SHARED / "golden"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")

PALETTE_TEXT = "class,r,g,b\n" + "\n".join(
    f"{name},{r},{g},{b}" for name, (r, g, b) in zip(CLASS_NAMES, CLASS_COLORS, strict=True)
)


def drawing(seed: int = 0, height: int = 60, width: int = 70) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, len(CLASS_NAMES), (height, width)).astype(np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    images = [
        ("n000m000h000", "train", drawing(0)),
        ("n000m000h001", "train", drawing(1)),
        ("n001m003h000", "val", drawing(2)),
        ("n001m003h001", "test", drawing(3)),
        ("n002m000h000", "test", drawing(4)),
    ]
    return save_dataset(images, tmp_path / "mine")


@pytest.fixture
def palette(tmp_path: Path):
    path = tmp_path / "palette.csv"
    path.write_text(PALETTE_TEXT)
    return read_palette(path)


def first_image(folder: Path) -> Path:
    return folder / "full_semantic" / "train" / "worldn000m000h000.png"


# --- what is read ---------------------------------------------------------------------------------------


@needs_shared
def test_golden_images_give_the_golden_grids_cell_for_cell():
    golden = np.load(GOLDEN / "grids.npz")
    dataset = load_dataset(GOLDEN / "houses_50")
    assert dataset.source == "folder"
    assert len(dataset.houses) == len(golden["house"]) == 77
    for name, split, terrain in zip(golden["house"], golden["split"], golden["terrain"], strict=True):
        house = dataset.house(str(name))
        assert house.split == split
        np.testing.assert_array_equal(house.terrain, terrain, err_msg=name)
    assert tuple(golden["class_names"]) == CLASS_NAMES


@needs_shared
def test_published_images_differ_from_the_golden_grids_only_in_15_houses():
    golden = np.load(GOLDEN / "grids.npz")
    dataset = load_dataset(PUBLISHED)
    assert (dataset.name, dataset.source) == ("driveways_bing_iros19", "published")
    assert [len(dataset.split(split)) for split in ("train", "val", "test")] == [31, 4, 42]
    grids = dict(zip(golden["house"], golden["terrain"], strict=True))
    cells = {house.name: int((house.terrain != grids[house.name]).sum()) for house in dataset.houses}
    assert sum(count > 0 for count in cells.values()) <= 15
    assert sum(cells.values()) <= 83
    assert not any(house.terrain.flags.writeable for house in dataset.houses)


@needs_shared
def test_one_changed_byte_is_no_longer_the_published_dataset(tmp_path):
    for path in sorted(PUBLISHED.glob("full_semantic/*/*")) + sorted(PUBLISHED.glob("*.csv")):
        copy = tmp_path / "copy" / path.relative_to(PUBLISHED)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    assert load_dataset(tmp_path / "copy").source == "published"
    with (tmp_path / "copy" / "testing_houses.csv").open("a") as file:
        file.write("\n")
    dataset = load_dataset(tmp_path / "copy")
    assert (dataset.name, dataset.source) == ("copy", "folder")


def test_save_and_load_give_the_classes_back(folder):
    dataset = load_dataset(folder, cells=60)
    assert (dataset.name, dataset.source) == ("mine", "folder")
    assert [house.name for house in dataset.split("test")] == ["n001m003h001", "n002m000h000"]
    terrain = dataset.house("n001m003h000").terrain
    assert terrain.shape == (60, 60)
    assert terrain.dtype == np.uint8
    rows, columns = np.arange(60), (70 * (2 * np.arange(60) + 1) - 1) // 120
    sampled = drawing(2)[np.ix_(rows, columns)]
    np.testing.assert_array_equal(terrain[terrain != PATH], sampled[terrain != PATH])
    np.testing.assert_array_equal(terrain == FRONT_DOOR, sampled == FRONT_DOOR)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), height=st.integers(1, 40), width=st.integers(1, 40))
def test_a_written_class_image_reads_back_equal(tmp_path_factory, seed, height, width):
    place = tmp_path_factory.mktemp("image")
    (place / "palette.csv").write_text(PALETTE_TEXT)
    classes = drawing(seed, height, width)
    write_class_image(place / "image.png", classes)
    np.testing.assert_array_equal(read_class_image(place / "image.png", read_palette(place / "palette.csv")), classes)


def test_classes_are_mapped_by_name_whatever_the_order_of_rows(folder):
    before = load_dataset(folder)
    header, *rows = (folder / "labels_colors.csv").read_text().splitlines()
    (folder / "labels_colors.csv").write_text("\n".join([header, *rows[::-1], "hedge,1,2,3"]))
    after = load_dataset(folder)
    for one, other in zip(before.houses, after.houses, strict=True):
        np.testing.assert_array_equal(one.terrain, other.terrain)


@pytest.mark.parametrize("alias", ["_boundary_", "_background_"])
def test_aliases_mean_unknown_and_the_first_class_with_a_color_has_it(tmp_path, alias):
    (tmp_path / "palette.csv").write_text(f"class,r,g,b\n{alias},9,9,9\nroad,5,5,5\ngrass,5,5,5\ntree,9,9,9\n")
    (tmp_path / "image.png").write_bytes(png(np.array([[[9, 9, 9], [5, 5, 5]]], np.uint8), 2))
    classes = read_class_image(tmp_path / "image.png", read_palette(tmp_path / "palette.csv"))
    assert classes.tolist() == [[0, ROAD]]


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
def test_palette_images_of_every_depth(tmp_path, palette, depth):
    count = min(2**depth, 16)
    indices = np.arange(32).reshape(2, 16) % count
    bits = np.unpackbits(indices.astype(np.uint8)[..., None], axis=-1)[..., 8 - depth :]
    colors = CLASS_COLORS[::-1][:count]
    (tmp_path / "a.png").write_bytes(
        png(np.packbits(bits.reshape(2, -1), axis=1), 3, depth, (b"PLTE", colors.tobytes()))
    )
    np.testing.assert_array_equal(read_class_image(tmp_path / "a.png", palette), 15 - indices)


def test_interlaced_and_opaque_rgba_images_and_embedded_extras(tmp_path, palette):
    classes = drawing(5, 11, 13)
    rgba = np.dstack([CLASS_COLORS[classes], np.full(classes.shape, 255, np.uint8)])
    (tmp_path / "rgba.png").write_bytes(png(rgba, 6))
    rgb = CLASS_COLORS[classes]
    passes = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
    raw = b"".join(b"\0" + row.tobytes() for x, y, dx, dy in passes for row in rgb[y::dy, x::dx] if row.size)
    header = struct.pack(">2I5B", 13, 11, 8, 2, 0, 0, 1)
    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(raw)), (b"IEND", b"")]
    (tmp_path / "interlaced.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts))
    (tmp_path / "extras.png").write_bytes(
        png(rgb, 2, 8, (b"gAMA", struct.pack(">I", 22222)), (b"tEXt", b"Title\0x")) + b"bytes behind the end"
    )
    for name in ("rgba", "interlaced", "extras"):
        np.testing.assert_array_equal(read_class_image(tmp_path / f"{name}.png", palette), classes)


def test_byte_order_mark_crlf_blank_lines_and_no_last_line_end(folder):
    for name in ("labels_colors.csv", "testing_houses.csv"):
        text = (folder / name).read_text().rstrip("\n").replace("\n", "\r\n\r\n")
        (folder / name).write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert len(load_dataset(folder).split("test")) == 2


def test_a_dataset_may_have_one_split_only(tmp_path):
    dataset = load_dataset(save_dataset([("a-1", "test", drawing())], tmp_path / "one"))
    assert [len(dataset.split(split)) for split in ("train", "val", "test")] == [0, 0, 1]
    assert not (tmp_path / "one" / "training_houses.csv").exists()


@pytest.mark.parametrize(
    ("name", "split", "group"),
    [
        ("n001m000h000", "train", "train"),
        ("n001m003h000", "val", "val"),
        ("n001m003h001", "test", "same_neighborhood"),
        ("n002m000h000", "test", "new_neighborhood"),
        ("n004m000h000", "test", "urban"),
        ("p004m000h000", "test", "urban"),
        ("n003m000h000", "test", "test"),
        ("x", "test", "test"),
        ("x", "spare", "spare"),
    ],
)
def test_groups(name, split, group):
    assert group_of(House(name, split, np.zeros((1, 1), np.uint8))) == group


def test_close_names_are_offered(folder):
    dataset = load_dataset(folder)
    refusal(lambda: dataset.house("n000m000h01"), "mine", "'n000m000h01'", "n000m000h001")
    refusal(lambda: dataset.house("zzz"), "mine", "'zzz'", "give one of", "--dataset")
    refusal(lambda: dataset.split("training"), "mine", "'training'", "train, val, test")


# --- what is refused ------------------------------------------------------------------------------------


def test_truncated_anywhere_or_changed_anywhere_is_refused(folder):
    path = first_image(folder)
    whole = path.read_bytes()
    for size in [*range(0, len(whole), 97), len(whole) - 1, len(whole) - 12]:
        path.write_bytes(whole[:size])
        refusal(lambda: load_dataset(folder), path, "PNG")
    for position in range(0, len(whole), 41):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x55]) + whole[position + 1 :])
        refusal(lambda: load_dataset(folder), path, "PNG")


def test_truncated_messages_name_the_remedy(folder, capfd):
    path = first_image(folder)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refusal(lambda: load_dataset(folder), path, "truncated", "again")
    assert capfd.readouterr() == ("", "")


def test_missing_pixel_rows_behind_intact_check_sums_are_refused(tmp_path, palette):
    rows = np.zeros((4, 6), np.uint8)
    path = tmp_path / "a.png"
    full = np.insert(rows, 0, 0, axis=1).tobytes()
    path.write_bytes(png(rows, 2, idat=full[:-3]))
    refusal(lambda: read_class_image(path, palette), path, "truncated", "25 of 28 bytes")
    path.write_bytes(png(rows, 2, idat=full + b"\0"))
    refusal(lambda: read_class_image(path, palette), path, "more of 28 bytes")
    path.write_bytes(png(rows, 2, idat=b"\7" + full[1:]))
    refusal(lambda: read_class_image(path, palette), path, "damaged", "unrecognized data")


def test_a_file_that_is_no_png(folder):
    path = first_image(folder)
    path.write_bytes(b"GIF89a and so on")
    refusal(lambda: load_dataset(folder), path, "47 49 46", "not an intact PNG", "save")
    path.write_bytes(b"")
    refusal(lambda: load_dataset(folder), path, "empty", "PNG")
    path.unlink()
    path.mkdir()
    refusal(lambda: load_dataset(folder), path, "cannot be read", "give")


@pytest.mark.parametrize(
    ("color_type", "depth", "shape", "words"),
    [
        (0, 8, (4, 4), "8-bit grayscale;"),
        (4, 8, (4, 8), "8-bit grayscale with alpha"),
        (2, 16, (4, 24), "16-bit RGB"),
        (0, 16, (4, 8), "16-bit grayscale"),
    ],
)
def test_other_kinds_of_png_are_refused(tmp_path, palette, color_type, depth, shape, words):
    path = tmp_path / "a.png"
    path.write_bytes(png(np.zeros(shape, np.uint8), color_type, depth))
    refusal(lambda: read_class_image(path, palette), path, words, "save it as palette or 8-bit RGB or 8-bit RGBA PNG")


def test_transparency_is_refused(tmp_path, palette):
    path = tmp_path / "a.png"
    path.write_bytes(png(np.zeros((2, 8), np.uint8), 6))
    refusal(lambda: read_class_image(path, palette), path, "not opaque", "without transparency")
    path.write_bytes(png(np.ones((2, 2), np.uint8), 3, 8, (b"PLTE", b"\0" * 6), (b"tRNS", b"\xff\x80")))
    refusal(lambda: read_class_image(path, palette), path, "not opaque")
    path.write_bytes(png(np.zeros((2, 6), np.uint8), 2, 8, (b"tRNS", b"\0" * 6)))
    refusal(lambda: read_class_image(path, palette), path, "not opaque")


def test_the_first_of_the_classes_of_a_color_has_it(tmp_path):
    (tmp_path / "palette.csv").write_text("class,r,g,b\nroad,1,2,3\ngrass,1,2,3\nhouse,4,5,6\n")
    (tmp_path / "a.png").write_bytes(png(np.array([[1, 2, 3, 4, 5, 6]], np.uint8), 2))
    found = read_class_image(tmp_path / "a.png", read_palette(tmp_path / "palette.csv"))
    assert found.tolist() == [[ROAD, HOUSE]]


def test_an_index_outside_the_files_own_palette(tmp_path, palette):
    path = tmp_path / "a.png"
    path.write_bytes(png(np.full((2, 2), 3, np.uint8), 3, 8, (b"PLTE", CLASS_COLORS[:3].tobytes())))
    refusal(lambda: read_class_image(path, palette), path, "index 3", "palette of 3 colors")


def test_a_color_outside_the_palette(folder):
    path = first_image(folder)
    picture = cv2.imread(str(path))
    picture[7, 5] = (3, 120, 2)
    cv2.imwrite(str(path), picture)
    message = refusal(lambda: load_dataset(folder), path, "x=5, y=7", "(2, 120, 3)", "'grass' (0, 128, 0)", "repaint")
    assert "more" not in message
    picture[9] = (3, 120, 2)
    cv2.imwrite(str(path), picture)
    refusal(lambda: load_dataset(folder), path, "70 more")
    indices = np.full((60, 60), 1, np.uint8)
    path.write_bytes(png(indices, 3, 8, (b"PLTE", bytes([0, 0, 0, 129, 0, 0]))))
    refusal(lambda: load_dataset(folder), path, "x=0, y=0", "(129, 0, 0)", "'front_door' (128, 0, 0)")


def test_a_class_the_package_does_not_know_is_refused_where_it_is_drawn(folder):
    csv = folder / "labels_colors.csv"
    words = csv.read_text()
    csv.write_text(words.replace("grass", "lawn"))
    refusal(lambda: load_dataset(folder), folder / "full_semantic", "'lawn'", csv.name, "rename", "house, sidewalk")
    csv.write_text(words.replace("grass", "gras"))
    assert refusal(lambda: load_dataset(folder), "'gras'", csv.name).endswith("rename it to grass")


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        ("", ["is empty", "class,r,g,b"]),
        ("class,r,g,b\n", ["no rows", "class,r,g,b"]),
        ("class,r,g,b,r\nroad,1,2,3,4\n", ["names 'r' twice", "leave one"]),
        ("class,r,g\nroad,1,2\n", ["lacks the column 'b'", "class,r,g,b"]),
        ("road,1,2,3\n", ["'class'", "class,r,g,b"]),
        ("class,r,g,b\nroad,1,x,3\n", ["line 2", "'x'", "'g'", "'road'", "0 to 255"]),
        ("class,r,g,b\nroad,1,-2,3\n", ["line 2", "-2:", "0 to 255"]),
        ("class,r,g,b\nroad,1,2,256\n", ["line 2", "256:", "0 to 255"]),
        ("class,r,g,b\nroad,1,2.0,3\n", ["line 2", "'2.0'", "0 to 255"]),
        ("class,r,g,b\nroad,1,,3\n", ["line 2", "'g'", "fill it in"]),
        ("class,r,g,b\nroad,1\n", ["line 2", "'g'", "fill it in"]),
        ("class,r,g,b\nroad,1,2,3,4\n", ["line 2", "5 values for 4 columns", "repair"]),
    ],
)
def test_bad_palette_files(folder, text, mentions):
    path = folder / "labels_colors.csv"
    path.write_text(text)
    refusal(lambda: load_dataset(folder), path, *mentions)


def test_missing_palette_file(folder):
    path = folder / "labels_colors.csv"
    path.unlink()
    refusal(lambda: load_dataset(folder), path, "no such file", "class,r,g,b")
    path.mkdir()
    refusal(lambda: load_dataset(folder), path, "cannot be read", "class,r,g,b")


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        (b"", ["is empty", "house_id"]),
        (b"\n\n", ["is empty", "house_id"]),
        (b"house_id\n", ["no rows", "house_id"]),
        (b"name\nn000m000h000\n", ["'name'", "'house_id'"]),
        (b"house_id\nn009m000h000\nn009m000h000\n", ["line 3", "'n009m000h000'", "line 2", "delete"]),
        (b"house_id\nn001m003h000\n", ["line 2", "'n001m003h000'", "validation_houses.csv", "one split"]),
        (b"house_id\n../n000m000h000\n", ["line 2", "'../n000m000h000'", "letters"]),
        (b'house_id\n"a\nb"\n', ["line 3", "'a\\nb'", "letters"]),
        (b"house_id,lot\n,3\n", ["line 2", "'house_id'", "fill it in"]),
        (b"house_id\nn000\xe9\n", ["line 2: byte 0xe9", "UTF-8"]),
        ("house_id\nn000\n".encode("utf-16"), ["line 1: byte 0xff", "UTF-8"]),
    ],
)
def test_bad_house_lists(folder, text, mentions):
    path = folder / "testing_houses.csv"
    path.write_bytes(text)
    refusal(lambda: load_dataset(folder), path, *mentions)


def test_a_listed_house_without_an_image(folder):
    path = first_image(folder)
    path.unlink()
    refusal(lambda: load_dataset(folder), path, "training_houses.csv", "line 2", "'n000m000h000'", "add the image")


def test_images_without_their_list(folder):
    (folder / "training_houses.csv").unlink()
    refusal(lambda: load_dataset(folder), folder / "training_houses.csv", "no such file", "full_semantic/train")


def test_paths_that_are_no_dataset(folder, tmp_path):
    refusal(lambda: load_dataset(tmp_path / "nowhere"), tmp_path / "nowhere", "is not a folder", "labels_colors.csv")
    refusal(lambda: load_dataset(folder / "labels_colors.csv"), "is not a folder", "give a folder")
    (tmp_path / "empty").mkdir()
    refusal(lambda: load_dataset(tmp_path / "empty"), tmp_path / "empty", "empty", "labels_colors.csv")
    (tmp_path / "empty" / "notes.txt").write_text("x")
    refusal(lambda: load_dataset(tmp_path / "empty"), "no house list", "testing_houses.csv", "house_id")


def test_what_may_not_be_read_is_named(folder, monkeypatch):
    def deny(path, *_args):
        raise PermissionError(13, "Permission denied", str(path))

    for method in ("open", "exists", "iterdir"):
        with monkeypatch.context() as patch:
            patch.setattr(Path, method, deny)
            refusal(lambda: load_dataset(folder), folder, "cannot be read", "Permission denied")


def test_two_houses_of_one_name_are_refused():
    house = House("n000m000h000", "train", np.full((4, 4), ROAD, np.uint8))
    with pytest.raises(InputError, match="mine: 2 houses are called 'n000m000h000'; names must be unique"):
        HouseDataset("mine", "folder", (house, dataclasses.replace(house, split="test")))


def test_houses_are_told_apart_by_what_they_hold():
    house = House("n000m000h000", "train", np.zeros((2, 3), np.uint8))
    other = np.zeros((2, 3), np.uint8)
    other[0, 1] = 4
    changed = [{"name": "a"}, {"split": "val"}, {"terrain": other}, {"terrain": np.zeros((3, 2), np.uint8)}]
    houses = [house, *(dataclasses.replace(house, **change) for change in changed)]
    digests = [HouseDataset("mine", "folder", (one,)).sha256 for one in houses]
    assert len(set(digests)) == len(houses)
    assert HouseDataset("moved", "folder", (house,)).sha256 == digests[0]


def test_wrong_grid_size(folder):
    refusal(lambda: load_dataset(folder, cells=61), first_image(folder), "wrong grid size", "70 x 60", "61", "60 cells")
    refusal(lambda: load_dataset(folder, cells=0), folder, "0 cells", "at least 1")
    write_class_image(first_image(folder), drawing(0, 200, 49))
    refusal(lambda: load_dataset(folder), first_image(folder), "wrong grid size", "49 x 200", "50 x 50", "larger")


def test_what_cannot_be_saved(tmp_path):
    image, path = drawing(), tmp_path / "a.png"
    refusal(lambda: write_class_image(path, image + 16), path, "0 to 15", "class")
    refusal(lambda: write_class_image(path, image[0]), path, "[70]", "[H W]")


# --- which dataset is opened ----------------------------------------------------------------------------


@pytest.fixture
def lines(monkeypatch) -> list[str]:
    """Collected log lines, with nothing set in the environment and every download refused."""

    def refuse(*_args, **_options):
        raise NetworkUnavailable("example.org: Name or service not known")

    monkeypatch.delenv("DC2G_DATA", raising=False)
    monkeypatch.setattr(houses_module, "fetch_dataset", refuse)
    return []


@pytest.fixture
def few_procedural(monkeypatch) -> HouseDataset:
    dataset = HouseDataset("procedural", "procedural", ())
    monkeypatch.setattr(families, "procedural_dataset", lambda **_: dataset)
    return dataset


def test_location_comes_before_the_environment(folder, tmp_path, monkeypatch, lines, few_procedural):
    other = save_dataset([("a", "test", drawing())], tmp_path / "other")
    monkeypatch.setenv("DC2G_DATA", str(other))
    assert open_dataset(folder, log=lines.append).name == "mine"
    assert open_dataset(str(folder), cells=20, log=lines.append).houses[0].terrain.shape == (20, 20)
    assert open_dataset(log=lines.append).name == "other"
    assert open_dataset("procedural", log=lines.append) is few_procedural
    monkeypatch.setenv("DC2G_DATA", "procedural")
    assert open_dataset(log=lines.append) is few_procedural
    assert lines == []


def test_a_location_that_was_asked_for_is_never_replaced(folder, tmp_path, monkeypatch, lines, few_procedural):
    refusal(lambda: open_dataset(tmp_path / "gone", log=lines.append), tmp_path / "gone", "not a folder", "give")
    for location in ("", "~nobody-of-this-name/houses", "x" * 5000):
        refusal(lambda location=location: open_dataset(location), repr(location)[:150], "not a folder", "give")
    monkeypatch.setenv("DC2G_DATA", str(tmp_path / "gone"))
    refusal(lambda: open_dataset(log=lines.append), tmp_path / "gone", "DC2G_DATA", "give")
    assert lines == []


def test_without_network_one_line_and_the_procedural_houses(monkeypatch, lines, few_procedural, capsys):
    assert open_dataset(log=lines.append) is few_procedural
    (line,) = lines
    assert "\n" not in line
    for words in ("published", "Name or service not known", "procedural", "--dataset", "DC2G_DATA"):
        assert words in line
    monkeypatch.setenv("DC2G_DATA", "")
    open_dataset()
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", line + "\n")


def test_a_wrong_download_is_never_replaced(monkeypatch, lines, few_procedural):
    def mismatch():
        raise InputError("x.png: SHA-256 is a, expected b")

    monkeypatch.setattr(houses_module, "fetch_dataset", mismatch)
    refusal(lambda: open_dataset(log=lines.append), "SHA-256")
    assert lines == []


def test_a_fetched_dataset_is_loaded(folder, monkeypatch, lines):
    monkeypatch.setattr(houses_module, "fetch_dataset", lambda: folder)
    assert open_dataset(log=lines.append).name == "mine"
    assert lines == []


OWN = HouseDataset("own", "folder", (House("yard", "test", np.full((2, 2), ROAD, np.uint8)),))


def own():
    return OWN


def empty():
    return HouseDataset("empty", "folder", ())


def test_a_dataset_of_the_users_own_is_a_value_or_a_function():
    for name in ("OWN", "own"):
        assert open_dataset(f"{__name__}:{name}") is OWN
    give = "give a HouseDataset, or a function that returns one"
    refusal(lambda: open_dataset("math:pi"), "'math:pi'", "is 3.14", give)
    refusal(lambda: open_dataset("os:getcwd"), "'os:getcwd'", "returns '", give)
    refusal(lambda: open_dataset(f"{__name__}:empty"), ":empty'", "has no houses", "at least one")
