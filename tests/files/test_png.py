"""What Pillow would show although it is damaged is refused, and nothing is decoded before its size is known."""

import os
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest

from dc2g_jax._src.files.png import read_png, write_png
from tests.files.pngs import chunk, png
from tests.support.refusals import refusal

KINDS = ("palette", "8-bit RGB", "8-bit RGBA", "8-bit grayscale", "16-bit grayscale")
PIXELS = np.random.default_rng(0).integers(0, 256, (5, 4, 3)).astype(np.uint8)
COLORS = bytes(range(12))


def read(path) -> np.ndarray:
    return np.asarray(read_png(path, KINDS, "anything"))


@pytest.mark.parametrize(
    "pixels", [PIXELS, PIXELS[..., 0], PIXELS[..., 0].astype(np.uint16) * 257, PIXELS[::-1, ::2]], ids=str
)
def test_what_is_written_comes_back(tmp_path, pixels):
    write_png(tmp_path / "a.png", pixels)
    found = read(tmp_path / "a.png")
    assert found.dtype == pixels.dtype
    np.testing.assert_array_equal(found, pixels)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
def test_indices_of_a_palette_of_any_depth(tmp_path, depth):
    indices = np.random.default_rng(depth).integers(0, 2, (3, 8)).astype(np.uint8)
    bits = (indices[..., None] >> np.arange(depth)[::-1] & 1).reshape(3, -1)
    (tmp_path / "a.png").write_bytes(png(np.packbits(bits, axis=1), 3, depth, (b"PLTE", COLORS)))
    np.testing.assert_array_equal(read(tmp_path / "a.png"), indices)


@pytest.mark.parametrize(
    "whole",
    [
        png(PIXELS, 2, 8, (b"tEXt", b"Title\0x")),
        png(PIXELS[..., 0] & 3, 3, 8, (b"PLTE", COLORS), (b"tRNS", b"\xff")),
        png(PIXELS[..., 0], 0, 16),
    ],
    ids=["RGB", "palette", "16 bits"],
)
def test_no_byte_can_be_missing_and_no_bit_can_be_other(tmp_path, whole, capfd):
    path = tmp_path / "a.png"
    path.write_bytes(whole)
    read(path)
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        refusal(lambda: read(path), path, "PNG")
    for bit in range(8 * len(whole)):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        refusal(lambda: read(path), path, "PNG")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("whole", "mentions"),
    [
        (png(PIXELS[..., 0] & 1, 3, 8, (b"PLTE", COLORS[:6]), (b"PLTE", COLORS[6:])), ["2 chunks PLTE"]),
        (png(PIXELS[..., 0] & 1, 3, 8, (b"PLTE", COLORS), (b"tRNS", b"\xff"), (b"tRNS", b"\0")), ["2 chunks tRNS"]),
        (png(PIXELS, 2, 8, (b"IHDR", struct.pack(">2I5B", 2, 3, 8, 2, 0, 0, 0))), ["2 chunks IHDR"]),
        (png(PIXELS, 2, 8, (b"acTL", bytes(8))), ["animated"]),
        (png(PIXELS[..., 0], 3), ["palette of 0 colors"]),
        (png(PIXELS[..., 0] & 1 | 4, 3, 8, (b"PLTE", COLORS)), ["index 5", "palette of 4 colors"]),
        (png(PIXELS, 2, idat=b""), ["0 of 65 bytes"]),
        (png(PIXELS, 2, idat=b"\0" * 52), ["52 of 65 bytes"]),
        (png(PIXELS, 2, idat=b"\0" * 66), ["more of 65 bytes"]),
        (png(PIXELS, 2, idat=b"\7" + b"\0" * 64), ["unrecognized data"]),
        (png(PIXELS[:, :0], 2), ["has 0 x 5 pixels"]),
    ],
    ids=str,
)
def test_contradictions_behind_right_check_sums(tmp_path, whole, mentions):
    path = tmp_path / "a.png"
    path.write_bytes(whole)
    refusal(lambda: read(path), path, *mentions)


@pytest.mark.parametrize(
    ("color_type", "depth", "kind"),
    [(0, 1, "1-bit grayscale"), (4, 8, "8-bit grayscale with alpha"), (2, 16, "16-bit RGB"), (6, 16, "16-bit RGBA")],
)
def test_other_kinds(tmp_path, color_type, depth, kind):
    path = tmp_path / "a.png"
    path.write_bytes(png(np.zeros((4, 24), np.uint8), color_type, depth))
    refusal(lambda: read(path), path, f"is {kind};", "palette or 8-bit RGB", "anything")


def claiming(width: int, height: int, pixel_data: bytes) -> bytes:
    header = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    parts = [(b"IHDR", header), (b"IDAT", pixel_data), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


def test_an_enormous_picture_is_refused_before_it_is_decoded(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(claiming(10**6, 10**6, b""))
    refusal(lambda: read(path), path, "1000000 x 1000000 pixels", "1 to 60000000 pixels")


@pytest.mark.skipif(sys.platform != "linux", reason="limits memory as Linux does")
@pytest.mark.parametrize(
    ("size", "zeros", "mention"),
    [
        ((11585, 11585), 11585 * 34756, "has 11585 x 11585 pixels"),
        ((7000, 7000), 0, "0 of 147007000 bytes"),
        ((8, 8), 10**9, "more of 200 bytes"),
    ],
    ids=["large picture", "large header", "large data"],
)
def test_no_memory_is_taken_for_pixels_that_are_not_there_or_not_wanted(tmp_path, size, zeros, mention):
    path = tmp_path / "a.png"
    path.write_bytes(claiming(*size, zlib.compress(bytes(zeros), 9)))
    code = (
        "import resource, pathlib\n"
        "from dc2g_jax._src.files.png import read_png\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try:\n"
        f"    read_png(pathlib.Path({str(path)!r}), ('8-bit RGB',), '')\n"
        "except ValueError as error:\n"
        "    print(error)\n"
        "print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024, 'MB')\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
    assert mention in told[0]
    assert int(told[1].split()[0]) < 30


def test_a_flipped_bit_of_a_length_takes_no_memory(tmp_path):
    path, whole = tmp_path / "a.png", png(PIXELS[..., 0], 0, 16)
    for bit in (0x40, 0x80):
        changed = bytearray(whole)
        changed[whole.index(b"IDAT") - 4] ^= bit
        path.write_bytes(changed)
        refusal(lambda: read(path), path, f"declares {(bit << 24) + len(whole) - 57} bytes")


def test_a_picture_of_a_known_size_is_refused_by_its_header(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(claiming(8000, 8000, zlib.compress(bytes(8))))
    refusal(
        lambda: read_png(path, KINDS, "anything", size=(8, 6)), path, "is 8000 x 8000 pixels, not 8 x 6; give anything"
    )


@pytest.mark.parametrize(("kind", "make"), [("folder", os.mkdir), ("pipe", os.mkfifo)])
def test_what_is_not_a_file(tmp_path, kind, make):
    make(tmp_path / "a.png")
    refusal(lambda: read(tmp_path / "a.png"), tmp_path / "a.png", kind, "not a file")


def test_names_that_no_file_has(tmp_path):
    refusal(lambda: read(tmp_path / "a\0.png"), "a?.png", "not the name of a file")
    refusal(lambda: read(tmp_path / ("a" * 300)), "aaa ... ", "name too long")
