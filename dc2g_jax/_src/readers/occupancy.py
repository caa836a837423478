"""ROS occupancy maps, read like map_server reads them: a YAML file with metadata and a PGM or PNG image."""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt, UInt8

from dc2g_jax._src.files.png import MOST_PIXELS, bands, read_png
from dc2g_jax._src.files.reading import finite_number, read_bytes, read_yaml
from dc2g_jax._src.grid.map_frame import MapFrame
from dc2g_jax._src.grid.sampling import sample_conservatively
from dc2g_jax._src.grid.terrain import FREE, OCCUPIED, UNKNOWN
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number, short

#: File endings of occupancy maps.
YAML_ENDINGS = (".yaml", ".yml")

#: Percent of a pixel that is occupied.
_OCCUPIED = 100

_MODES = ("trinary", "scale", "raw")

_REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")

#: The gray value that map savers write for unknown pixels, and the usual threshold, with which it is not read as free.
_UNKNOWN_GRAY, _USUAL_FREE_THRESHOLD = 205, 0.196

#: Kinds of PNG files that are images of maps.
_PNG_KINDS = (
    "palette", "1-bit grayscale", "2-bit grayscale", "4-bit grayscale", "8-bit grayscale", "16-bit grayscale",
    "8-bit grayscale with alpha", "8-bit RGB", "8-bit RGBA",
)  # fmt: skip

#: Most bytes of the header of a PGM file, with its comments.
_LONGEST_HEADER = 2**16

_GAP = rb"(?:\s|#[^\r\n]*[\r\n])+"
_PGM_HEADER = re.compile(rb"P5" + _GAP + rb"(\d{1,6})" + _GAP + rb"(\d{1,6})" + _GAP + rb"(\d{1,5})\s")


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """An occupancy map.

    Attributes:
      free: pixels known to be free.
      occupied: pixels known to be occupied; pixels that are neither are unknown.
      resolution: meters per pixel.
      origin: where the image lies in the map frame.
      doubts: lines about what may be a mistake in the metadata, and about what was left out of the image.
    """

    free: Bool[np.ndarray, "h w"]
    occupied: Bool[np.ndarray, "h w"]
    resolution: float
    origin: MapFrame
    doubts: tuple[str, ...]

    def terrain(self, columns: int, rows: int) -> UInt8[np.ndarray, "{rows} {columns}"]:
        """The map as terrain: `FREE`, `OCCUPIED` or `UNKNOWN`, see `grid.terrain`.

        A cell is free only if all of its pixels are free, and occupied if any of its pixels is, so that no wall is lost
        on a coarser grid.
        """
        free, occupied, unknown = np.array([FREE, OCCUPIED, UNKNOWN], np.uint8)
        pixels = np.where(self.free, free, np.where(self.occupied, occupied, unknown))
        return sample_conservatively(pixels, columns, rows)

    def cell(self, x: float, y: float, columns: int, rows: int) -> tuple[int, int] | None:
        """Column and row of a point in the map frame, in meters, on a grid of this size over the map.

        They lie beyond the grid for points off the map. `None` if they are too large for numbers.
        """
        height, width = self.free.shape
        right, up = (meters / self.resolution for meters in self.origin.to_grid(x, y))
        if not (math.isfinite(right) and math.isfinite(up)):
            return None
        return math.floor(right * columns / width), rows - 1 - math.floor(up * rows / height)


def read_occupancy_map(path: Path) -> OccupancyMap:
    """Read a ROS map: `image`, `resolution`, `origin`, `negate`, `occupied_thresh`, `free_thresh` and `mode`.

    The modes are those of map_server of Navigation2: `trinary`, which is the default, `scale` and `raw`. In the last
    two, pixels have an occupancy in percent; unknown are those above 100 (`raw`) and transparent ones (`scale`). As in
    costmaps of Navigation2, 100 is occupied and less is free.

    A map that is mostly unknown is cropped to what is known.

    Raises:
      InputError: the YAML file or its image is missing, unreadable or damaged, a key is missing, or a value is invalid.
    """
    facts = _read_facts(path)
    image = path.parent / facts["image"]
    resolution = _number(path, "resolution", facts["resolution"])
    check_number(f"{path}: resolution", resolution, above=0, hint="(meters of a pixel, such as 0.05)")
    origin = facts["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise InputError(f"{path}: origin is {short(origin)}; give [x, y, yaw] in meters and radians")
    frame = MapFrame(*(_number(path, "origin", value) for value in origin))
    free_threshold, occupied_threshold = (_number(path, key, facts[key]) for key in ("free_thresh", "occupied_thresh"))
    check_number(f"{path}: free_thresh", free_threshold, least=0, most=1)
    check_number(f"{path}: occupied_thresh", occupied_threshold, least=free_threshold, most=1)
    if facts["negate"] not in (0, 1):
        raise InputError(f"{path}: negate is {short(facts['negate'])}; give 0 where white is free, 1 where black is")
    mode = facts.get("mode", "trinary")
    check_name("mode", mode, _MODES, f"({path})")
    levels, highest, opaque = _read_image(image, path, mode)
    shades = np.arange(highest + 1) / highest
    free, occupied = _known_levels(mode, shades, bool(facts["negate"]), free_threshold, occupied_threshold)
    doubts = []
    unknown_grays = int(np.sum(levels == _UNKNOWN_GRAY)) if highest == 255 and mode == "trinary" else 0
    if unknown_grays and free[_UNKNOWN_GRAY] and not facts["negate"]:
        doubts.append(
            f"{unknown_grays} pixels are gray {_UNKNOWN_GRAY}, which map savers write where nothing is known, but "
            f"free_thresh {free_threshold} makes them free; if that is not meant, write {_USUAL_FREE_THRESHOLD}"
        )
    pixels = OccupancyMap(free[levels] & opaque, occupied[levels] & opaque, resolution, frame, (*doubts,))
    return _cropped(pixels)


def _known_levels(
    mode: str, shades: Float[np.ndarray, "level"], negate: bool, free_threshold: float, occupied_threshold: float
) -> tuple[Bool[np.ndarray, "level"], Bool[np.ndarray, "level"]]:
    """Which shades of gray, from 0 to 1, are free, and which are occupied."""
    occupancy = shades if negate else 1 - shades
    if mode == "trinary":
        return occupancy < free_threshold, occupancy > occupied_threshold
    if mode == "scale":
        between = (occupancy - free_threshold) / max(occupied_threshold - free_threshold, np.finfo(float).tiny)
        percent = np.rint(np.clip(between, 0, 1) * _OCCUPIED)
    else:
        percent = np.rint(shades * 255)
    return percent < _OCCUPIED, percent == _OCCUPIED


def _cropped(pixels: OccupancyMap) -> OccupancyMap:
    """A map without the unknown rim, if most of it is unknown."""
    known = pixels.free | pixels.occupied
    if not 0 < np.sum(known) < known.size / 2:
        return pixels
    rows, columns = np.flatnonzero(np.any(known, axis=1)), np.flatnonzero(np.any(known, axis=0))
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    height, width = known.shape
    if (bottom - top, right - left) == (height, width):
        return pixels
    corner = pixels.origin.to_map(float(left * pixels.resolution), float((height - bottom) * pixels.resolution))
    doubt = (
        f"most of the map is unknown: of its {width} x {height} pixels, columns {left} to {right - 1} and rows {top} "
        f"to {bottom - 1} are kept; columns and rows count from there"
    )
    part = np.s_[top:bottom, left:right]
    return replace(
        pixels,
        free=pixels.free[part],
        occupied=pixels.occupied[part],
        origin=MapFrame(*corner, pixels.origin.yaw),
        doubts=(*pixels.doubts, doubt),
    )


def _read_facts(path: Path) -> dict[str, Any]:
    """The keys and values of the YAML file, checked to contain all required keys."""
    facts = read_yaml(path, "give the YAML file of a ROS map")
    if not isinstance(facts, dict):
        raise InputError(f"{path}: holds no keys and values; a ROS map needs {', '.join(_REQUIRED)}")
    missing = [key for key in _REQUIRED if facts.get(key) is None]
    if missing:
        raise InputError(f"{path}: lacks {', '.join(missing)}; a ROS map needs {', '.join(_REQUIRED)}")
    if not isinstance(facts["image"], str):
        raise InputError(f"{path}: image is {short(facts['image'])}; give the name of a PGM or PNG file")
    return facts


def _number(path: Path, key: str, value: object) -> float:
    """A number of the YAML file. YAML reads `5e-2` as text."""
    return finite_number(f"{path}: {key}", value, "write one such as 0.05")


def _read_image(
    path: Path, named_in: Path, mode: str
) -> tuple[UInt[np.ndarray, "h w"], int, Bool[np.ndarray, "#h #w"]]:
    """Levels of gray, the level of white, and which pixels are opaque enough to be known.

    The image, which the file `named_in` names, is a binary PGM or a PNG file. Transparency matters as in map_server: in
    the mode `trinary` it is averaged with the colors, in the mode `scale` all of a pixel has to be opaque, and in the
    mode `raw` it is ignored.
    """
    data = read_bytes(path, f"give the image that {named_in.name} names", at_most=MOST_PIXELS + _LONGEST_HEADER)
    opaque = np.ones((1, 1), bool)
    if not data.startswith(b"\x89PNG"):
        return _pgm_grays(path, data), 255, opaque
    picture = read_png(path, _PNG_KINDS, "free and occupied ground in shades of gray")
    if picture.mode.startswith("I"):
        return np.array(picture, np.uint16), 2**16 - 1, opaque
    transparent = "A" in picture.getbands() or "transparency" in picture.info
    counted = 4 if transparent and mode == "trinary" else 3
    levels = np.empty((picture.height, picture.width), np.uint16)
    if transparent and mode == "scale":
        opaque = np.empty(levels.shape, bool)
    for rows, band in bands(picture):
        channels = np.asarray(band.convert("RGBA" if transparent else "RGB"))
        levels[rows] = np.sum(channels[..., :counted], axis=-1, dtype=np.uint16)
        if opaque.size == levels.size:
            opaque[rows] = channels[..., 3] == 255
    return levels, counted * 255, opaque


def _pgm_grays(path: Path, data: bytes) -> UInt8[np.ndarray, "h w"]:
    """Gray values of a binary 8-bit PGM file, whose length is checked."""
    header = _PGM_HEADER.match(data)
    if header is None:
        raise InputError(
            f"{path}: starts with {data[:8].hex(' ') or 'nothing'}, so it is neither a binary PGM file (P5) nor a "
            "PNG file; save the map as one"
        )
    width, height, highest = (int(number) for number in header.groups())
    if highest != 255 or not (width and height):
        raise InputError(f"{path}: is {width} x {height} pixels of 0 to {highest}; save it as PGM of 0 to 255")
    found = len(data) - header.end()
    if found != width * height:
        raise InputError(
            f"{path}: wrong size: {width} x {height} pixels need {width * height} bytes, but {found} follow the "
            "header; save the map again"
        )
    return np.frombuffer(data, np.uint8, offset=header.end()).reshape(height, width)
