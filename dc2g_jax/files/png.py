"""PNG files, checked to the last byte before they are decoded.

Image libraries hand out what they could decode of a damaged file and fill the rest in silently, which would
make a wrong map. So structure, check sums and the amount of pixel data are verified first.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dc2g_jax.errors import InputError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGB, _PALETTE, _RGBA = 2, 3, 6
_COLOR_TYPES = {0: "greyscale", _RGB: "RGB", _PALETTE: "palette", 4: "greyscale with alpha", _RGBA: "RGBA"}
_CHANNELS = {_RGB: 3, _PALETTE: 1, _RGBA: 4}
#: First column, first row, column step and row step of each pass of an interlaced image.
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_MAX_PIXELS = 2**27


@dataclass(frozen=True, eq=False)
class Pixels:
    """A decoded picture.

    Attributes:
        samples: uint8 [H W] of indices into `colors`, or uint8 [H W 3] of RGB where `colors` is None.
        colors: uint8 [n 3], the file's own palette, or None.
    """

    samples: np.ndarray
    colors: np.ndarray | None


@dataclass(frozen=True)
class _Header:
    width: int
    height: int
    depth: int
    color_type: int
    interlaced: bool

    def passes(self) -> list[tuple[int, int]]:
        """Rows and bytes a row (its filter byte included) of each pass over the image."""
        steps = _ADAM7 if self.interlaced else ((0, 0, 1, 1),)
        bits = self.depth * _CHANNELS[self.color_type]
        sizes = []
        for x, y, step_x, step_y in steps:
            columns = -(-(self.width - x) // step_x)
            rows = -(-(self.height - y) // step_y)
            if columns > 0 and rows > 0:
                sizes.append((rows, 1 + (columns * bits + 7) // 8))
        return sizes


def read_png(path: Path) -> Pixels:
    """Read a palette, RGB or opaque RGBA picture with 8 bits a channel; embedded extras are ignored.

    Raises:
        InputError: the file is missing, is no PNG, is truncated or damaged, is of another kind (greyscale,
            16 bits), is not opaque, or points outside its own palette.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable PNG file") from None
    if not data.startswith(_SIGNATURE):
        found = f"starts with {data[:8].hex(' ')}" if data else "is empty"
        raise InputError(f"{path}: {found}, so it is not a PNG file; save the picture as PNG")
    try:
        chunks = _read_chunks(data)
        header = _read_header(chunks)
    except _Damage as damage:
        raise InputError(f"{path}: {damage}; copy or export the file again") from None
    _check_kind(path, header)
    try:
        _check_pixel_data(header, chunks)
        return _decode(header, chunks)
    except _Damage as damage:
        raise InputError(f"{path}: {damage}; copy or export the file again") from None
    except _Transparency as found:
        raise InputError(f"{path}: {found}; export it without transparency") from None


class _Damage(Exception):
    """The bytes are not an intact PNG."""


class _Transparency(Exception):
    """The picture is not opaque."""


def _read_chunks(data: bytes) -> dict[bytes, bytes]:
    """Contents by chunk type; the pieces of IDAT joined. Nothing may be missing; IEND must be there."""
    chunks: dict[bytes, list[bytes]] = {}
    position = len(_SIGNATURE)
    while b"IEND" not in chunks:
        if position + 12 > len(data):
            raise _Damage(f"truncated PNG: it ends after {len(data)} bytes, before its end mark (IEND)")
        length, kind = struct.unpack(">I4s", data[position : position + 8])
        end = position + 12 + length
        name = kind.decode("latin-1")
        if not (name.isascii() and name.isalpha()):
            raise _Damage(f"damaged PNG: no chunk starts at byte {position}")
        if end > len(data):
            raise _Damage(f"truncated PNG: it ends after {len(data)} of at least {end} bytes, in chunk {name}")
        content = data[position + 8 : end - 4]
        if zlib.crc32(kind + content) != int.from_bytes(data[end - 4 : end], "big"):
            raise _Damage(f"damaged PNG: wrong check sum of chunk {name} at byte {position}")
        chunks.setdefault(kind, []).append(content)
        position = end
    return {kind: b"".join(pieces) for kind, pieces in chunks.items()}


def _read_header(chunks: dict[bytes, bytes]) -> _Header:
    content = chunks.get(b"IHDR", b"")
    if len(content) != 13:
        raise _Damage("damaged PNG: no proper header (IHDR)")
    width, height, depth, color_type, compression, filtering, interlace = struct.unpack(">2I5B", content)
    if not (width and height) or compression or filtering or interlace > 1 or color_type not in _COLOR_TYPES:
        raise _Damage(f"damaged PNG: impossible header {content.hex(' ')}")
    return _Header(width, height, depth, color_type, bool(interlace))


def _check_kind(path: Path, header: _Header) -> None:
    kind = f"{header.depth}-bit {_COLOR_TYPES[header.color_type]}"
    depths = (1, 2, 4, 8) if header.color_type == _PALETTE else (8,)
    if header.color_type not in _CHANNELS or header.depth not in depths:
        raise InputError(f"{path}: is a {kind} PNG; save it as a palette or 8-bit RGB PNG")
    if header.width * header.height > _MAX_PIXELS:
        raise InputError(
            f"{path}: is {header.width} x {header.height} pixels, more than {_MAX_PIXELS} in all; scale it down"
        )


def _check_pixel_data(header: _Header, chunks: dict[bytes, bytes]) -> None:
    """Decompress the pixel data: exactly as much as the header promises, with an intact check sum."""
    sizes = header.passes()
    expected = sum(rows * stride for rows, stride in sizes)
    stream = zlib.decompressobj()
    try:
        raw = stream.decompress(chunks.get(b"IDAT", b""), expected + 1)
    except zlib.error as error:
        raise _Damage(f"damaged PNG: its pixel data cannot be decompressed ({error})") from None
    if len(raw) > expected:
        raise _Damage(f"damaged PNG: it holds more than the {expected} bytes of pixel data its size asks for")
    if len(raw) < expected or not stream.eof:
        raise _Damage(f"truncated PNG: it holds {len(raw)} of {expected} bytes of pixel data")
    position = 0
    for rows, stride in sizes:
        filters = np.frombuffer(raw, np.uint8, rows * stride, position)[::stride]
        if filters.max() > 4:
            raise _Damage(f"damaged PNG: unknown row filter {filters.max()}")
        position += rows * stride


def _decode(header: _Header, chunks: dict[bytes, bytes]) -> Pixels:
    """Decode the essential chunks alone, so that no extra (gamma, rotation) can change a colour."""
    essential = [(b"IHDR", chunks[b"IHDR"]), (b"IDAT", chunks[b"IDAT"]), (b"IEND", b"")]
    if header.color_type == _PALETTE:
        # Entry i gets the grey i, so that the decoded picture shows the indices themselves.
        greys = np.repeat(np.arange(2**header.depth, dtype=np.uint8), 3)
        essential.insert(1, (b"PLTE", greys.tobytes()))
    packed = _SIGNATURE + b"".join(_chunk(kind, content) for kind, content in essential)
    try:
        picture = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None or picture.dtype != np.uint8 or picture.shape[:2] != (header.height, header.width):
        raise _Damage("damaged PNG: it cannot be decoded")
    if header.color_type == _PALETTE:
        return _indexed(picture if picture.ndim == 2 else picture[..., 0], chunks)
    if header.color_type == _RGBA and picture[..., 3].min() < 255:
        raise _Transparency("has pixels that are not opaque")
    if header.color_type == _RGB and b"tRNS" in chunks:
        raise _Transparency("has a colour that is marked as transparent")
    return Pixels(np.ascontiguousarray(picture[..., 2::-1]), None)


def _indexed(indices: np.ndarray, chunks: dict[bytes, bytes]) -> Pixels:
    table = chunks.get(b"PLTE", b"")
    colors = np.frombuffer(table[: len(table) // 3 * 3], np.uint8).reshape(-1, 3)
    if indices.max() >= len(colors):
        raise _Damage(f"damaged PNG: a pixel has index {indices.max()} of a palette of {len(colors)} colours")
    opacity = np.frombuffer(chunks.get(b"tRNS", b""), np.uint8)
    transparent = np.flatnonzero(opacity < 255)
    if np.isin(indices, transparent).any():
        raise _Transparency("has pixels that are not opaque")
    return Pixels(np.ascontiguousarray(indices), colors)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
