"""PNG files, decoded by Pillow after checks of their chunks.

If rows are missing and the checksums are right, Pillow silently fills them with zeros; of two palettes it takes the
last; and it truncates 16-bit colors to 8 bits. Each of these would give a wrong map, so such files are rejected. Sizes
are checked before anything is decompressed.
"""

import collections
import io
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from dc2g_jax._src.files.atomic import replacing
from dc2g_jax._src.files.reading import TEXT, read_bytes
from dc2g_jax._src.runtime.errors import InputError

#: Pixels of a part of an image, see `bands`.
_PIXELS_AT_ONCE = 2**22

#: Most pixels of an image. Decoded, it then takes less than half a gigabyte.
MOST_PIXELS = 60_000_000

#: Width, height, bits, color type, compression, filters and interlacing.
_HEADER = struct.Struct(">2I5B")
_PALETTE = 3
_COLOR_TYPES = {0: "grayscale", 2: "RGB", _PALETTE: "palette", 4: "grayscale with alpha", 6: "RGBA"}
_CHANNELS = {0: 1, 2: 3, _PALETTE: 1, 4: 2, 6: 4}
#: First column, first row, column step and row step of each pass of an interlaced image.
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_png(path: Path, kinds: Collection[str], what: str, *, size: tuple[int, int] | None = None) -> Image.Image:
    """Read an image. Embedded text, color profiles and other metadata are ignored.

    Args:
        path: the file.
        kinds: accepted kinds: "palette", or bits per channel and channels, such as "8-bit RGB", "8-bit RGBA",
            "16-bit grayscale".
        what: content of the image, for the message about a wrong kind or size.
        size: width and height that the image must have; `None` for any with at most `MOST_PIXELS` pixels.

    Returns:
        The decoded image. Pixels of a palette image are indices into its palette.

    Raises:
        InputError: the file is missing, not a PNG, truncated, damaged, or of another kind or size; kind and size are
            checked before decoding.
    """
    data = read_bytes(path, "give a readable PNG file", at_most=TEXT)
    if not data.startswith(_SIGNATURE):
        found = f"starts with {data[:8].hex(' ')}" if data else "is empty"
        raise InputError(f"{path}: {found}, which is not an intact PNG file; save the picture as PNG again")
    try:
        chunks = _read_chunks(data)
        width, height, depth, color_type, _, _, _ = header = _HEADER.unpack(chunks[b"IHDR"])
        channels = _COLOR_TYPES.get(color_type, f"color type {color_type}")
        kind = channels if color_type == _PALETTE else f"{depth}-bit {channels}"
        if kind not in kinds:
            raise InputError(f"{path}: is {kind}; save it as {' or '.join(kinds)} PNG ({what})")
        if size is not None and size != (width, height):
            raise InputError(f"{path}: is {width} x {height} pixels, not {size[0]} x {size[1]}; give {what}")
        if not 0 < width * height <= MOST_PIXELS:
            raise InputError(f"{path}: has {width} x {height} pixels; save a PNG of 1 to {MOST_PIXELS} pixels in all")
        _check_pixel_data(header, chunks.pop(b"IDAT"))
        picture = Image.open(io.BytesIO(data), formats=("PNG",))
        picture.load()
        if kind == "palette":
            _check_indices(picture)
        return picture
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{path}: damaged PNG (its chunks contradict each other); export the file again") from None
    except Exception as error:  # damaged files raise many kinds of errors
        raise InputError(f"{path}: damaged or truncated PNG ({error}); copy or export the file again") from None


def bands(picture: Image.Image) -> Iterator[tuple[slice, Image.Image]]:
    """The rows of an image in a few parts. What is computed from pixels takes many times their memory."""
    rows_at_once = max(1, _PIXELS_AT_ONCE // picture.width)
    for top in range(0, picture.height, rows_at_once):
        bottom = min(top + rows_at_once, picture.height)
        yield slice(top, bottom), picture.crop((0, top, picture.width, bottom))


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write an image atomically: uint8 or uint16 [H W] as grayscale, or uint8 [H W 3] as RGB.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as unfinished:
        Image.fromarray(pixels).save(unfinished, "PNG")


def _read_chunks(data: bytes) -> dict[bytes, bytes]:
    """Contents of the chunks by name, with checksums verified and the pieces of pixel data joined."""
    chunks = collections.defaultdict(list)
    position, view = len(_SIGNATURE), memoryview(data)
    while b"IEND" not in chunks:
        if position + 12 > len(data):
            raise ValueError("it ends early")
        length, name = struct.unpack_from(">I4s", data, position)
        if position + 12 + length > len(data):
            raise ValueError(f"it declares {length} bytes where {len(data) - position} are left")
        content, end = view[position + 8 : position + 8 + length], position + 12 + length
        if zlib.crc32(view[position + 4 : end - 4]) != int.from_bytes(view[end - 4 : end]):
            raise ValueError(f"the checksum of its chunk {name.decode('ascii', 'replace')} is wrong")
        chunks[name].append(content)
        position = end
    if b"acTL" in chunks:
        raise ValueError("it is animated")
    for name in (b"IHDR", b"PLTE", b"tRNS"):
        if len(chunks[name]) > 1:
            raise ValueError(f"it has {len(chunks[name])} chunks {name.decode()}")
    return {name: b"".join(pieces) for name, pieces in chunks.items()}


def _check_pixel_data(header: tuple[int, ...], data: bytes) -> None:
    """Check that the pixel data have exactly the size that the header states."""
    width, height, depth, color_type, _, _, interlaced = header
    expected = 0
    for x, y, step_x, step_y in _ADAM7 if interlaced else ((0, 0, 1, 1),):
        columns, rows = -(-(width - x) // step_x), -(-(height - y) // step_y)
        if columns > 0 and rows > 0:  # each row begins with the number of its filter
            expected += rows * (1 + (columns * depth * _CHANNELS[color_type] + 7) // 8)
    stream = zlib.decompressobj()
    found = len(stream.decompress(data, expected + 1))
    if found != expected or not stream.eof:
        raise ValueError(f"it holds {found if found <= expected else 'more'} of {expected} bytes of pixel data")


def _check_indices(picture: Image.Image) -> None:
    colors = len(picture.getpalette() or []) // 3
    highest = int(np.asarray(picture).max())
    if highest >= colors:
        raise ValueError(f"a pixel has index {highest} of a palette of {colors} colors")
