"""From tags of OpenStreetMap to shapes in the layers of a sketch, in meters."""

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from dc2g_jax.families import PictureFrame, Points, Polygons, Sketch, ribbon, stroke
from dc2g_jax.osm.extract import Area, Extract, Line, Tags, is_street

#: Widths of streets where they are not mapped, meters; of others than these, and of a lane.
_STREET_WIDTHS = {"service": 4.5, "pedestrian": 6.0, "residential": 7.5, "living_street": 6.0, "unclassified": 7.0}
_OTHER_STREET_WIDTH, _LANE_WIDTH = 10.0, 3.2

#: Width of a sidewalk along a street, meters.
_SIDEWALK_WIDTH = 1.8

#: Value of `natural` or `highway` -> layer and radius of nodes.
_NODES = {"tree": ("tree", 1.6), "turning_circle": ("road", 7.0)}

#: Tag -> layer and width of ways other than streets. The first tag that a way has counts. Robots climb no steps.
_WAYS = {
    ("tunnel", "building_passage"): ("court_path", 2.5), ("service", "driveway"): ("driveway", 3.2),
    ("footway", "crossing"): ("crossing", 2.5), ("footway", "traffic_island"): ("crossing", 2.5),
    ("footway", "sidewalk"): ("pavement", 2.0), ("highway", "footway"): ("path", 1.4),
    ("highway", "path"): ("path", 1.2), ("highway", "bridleway"): ("path", 1.4), ("highway", "track"): ("path", 2.4),
    ("highway", "cycleway"): ("pavement", 2.0), ("highway", "service"): ("road", 4.0),
    ("highway", "motorway"): ("blocked", 12.0), ("highway", "motorway_link"): ("blocked", 7.0),
}  # fmt: skip

#: Tag -> layer and width of other lines.
_LINES = {
    ("barrier", "fence"): ("fence", 0.3), ("barrier", "wall"): ("fence", 0.4),
    ("barrier", "retaining_wall"): ("fence", 0.4), ("barrier", "hedge"): ("bush", 1.0),
    ("natural", "tree_row"): ("tree", 3.0), ("waterway", "river"): ("blocked", 8.0),
    ("waterway", "stream"): ("blocked", 2.0), ("waterway", "canal"): ("blocked", 6.0),
    ("railway", "rail"): ("blocked", 3.5), ("railway", "light_rail"): ("blocked", 3.5),
}  # fmt: skip

#: Tag -> layer of areas.
_AREAS = {
    ("natural", "water"): "blocked", ("leisure", "swimming_pool"): "blocked", ("natural", "scrub"): "bush",
    ("natural", "shrubbery"): "bush", ("barrier", "hedge"): "bush", ("natural", "wood"): "tree",
    ("landuse", "forest"): "tree",
}  # fmt: skip

#: Values of `highway` and `area:highway` for walking, and for nothing that can be driven on.
_WALKED = ("footway", "pedestrian", "path", "cycleway", "sidewalk", "crossing")
_CLOSED = ("traffic_island", "prohibited", "steps", "elevator", "platform", "construction", "proposed")

#: Cells that a strip is wide at least: one to be sampled without gaps, more for ground that must stay connected.
SAMPLED, CONNECTED = 1.0, 1.45


@dataclass(frozen=True, eq=False)
class Patch:
    """Polygons in one layer of a sketch.

    Attributes:
      layer: the layer.
      outer: polygons, meters.
      inner: holes in them.
    """

    layer: str
    outer: Polygons
    inner: Polygons = field(default_factory=list)


def fill(sketch: Sketch, shapes: Iterable[Patch]) -> None:
    """Fill shapes into a sketch."""
    whole: dict[str, Polygons] = {}
    for shape in shapes:
        if shape.inner:
            mask = sketch.mask(shape.outer) & (1 - sketch.mask(shape.inner))
            sketch.masks[shape.layer] = sketch.masks.get(shape.layer, np.zeros_like(mask)) | mask
        else:
            whole.setdefault(shape.layer, []).extend(shape.outer)
    sketch.add_all(whole)


def square_view(center: Points, meters: float, cells: int) -> PictureFrame:
    """The picture of a square around a point, with about 8 pixels a meter and a whole number of pixels a cell."""
    pixels = cells * max(2, round(8 * meters / cells))
    return PictureFrame(0.0, np.asarray(center) - meters / 2, pixels / meters, pixels, pixels)


def strip(line: Points, width: float) -> Polygons:
    """A line [n 2] drawn with a round pen of the given width."""
    turns = 2 * np.pi * np.arange(12) / 12
    pen = width / 2 * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    pieces = [piece for ends in itertools.pairwise(line) for piece in stroke(np.array(ends), width)]
    return pieces + [point + pen for point in line]


def street_width(tags: Tags) -> float:
    """Width of a street, meters: as mapped, by its lanes, or usual for its kind."""
    usual = _STREET_WIDTHS.get(tags.get("highway", ""), _OTHER_STREET_WIDTH)
    lanes = tags.get("lanes", "")
    if lanes.isdecimal():
        usual = max(int(lanes), 1) * _LANE_WIDTH + 1.0
    mapped = re.match(r"\d+(\.\d+)?(?=$| ?m$)", tags.get("width", ""))
    return min(max(float(mapped[0]) if mapped else usual, 2.5), 30.0)


def sidewalk_sides(tags: Tags) -> tuple[bool, bool] | None:
    """Whether a street has a sidewalk to its left and right; `None` where that is not mapped."""
    whole = tags.get("sidewalk", tags.get("sidewalk:both"))
    if whole is None and not tags.keys() & {"sidewalk:left", "sidewalk:right"}:
        return None
    left, right = (
        whole in ("both", "yes", side) or tags.get(f"sidewalk:{side}") == "yes" for side in ("left", "right")
    )
    return left, right


def sidewalks(line: Line, sides: tuple[bool, bool], cell: float) -> list[Patch]:
    """Sidewalks along a street, on its left and right."""
    half, beside = street_width(line.tags) / 2, max(_SIDEWALK_WIDTH, CONNECTED * cell)
    if all(sides):
        return [Patch("pavement", strip(line.points, 2 * (half + beside)))]
    if not any(sides):
        return []
    side = 1 if sides[1] else -1  # y grows downward: what ribbons call left is to the right
    return [Patch("pavement", ribbon(line.points, side * (half + beside), 0.0))]


def mapped_shapes(extract: Extract, cell: float) -> list[Patch]:
    """All that an extract maps, except for entrances.

    Args:
      extract: the extract.
      cell: side of a cell of the maps, meters: nothing is too narrow to appear there.
    """
    shapes = [shape for area in extract.areas for shape in _area_shapes(area)]
    shapes += [shape for line in extract.lines for shape in _line_shapes(line, cell)]
    for spot in extract.spots:
        kind = spot.tags.get("natural", spot.tags.get("highway"))
        if kind in _NODES:
            layer, radius = _NODES[kind]
            shapes.append(Patch(layer, strip(spot.point[None], 2 * radius)))
    return shapes


def _line_shapes(line: Line, cell: float) -> list[Patch]:
    tags, sides = line.tags, None
    found = [_WAYS[key, value] for key, value in _WAYS if tags.get(key) == value][:1]
    # A street with another tag of the table is a street first, but not where it passes through a building.
    if is_street(tags) and tags.get("tunnel") != "building_passage":
        found, sides = [("road", street_width(tags))], sidewalk_sides(tags)
    elif not found and tags.get("bridge", "no") == "no":
        found = [_LINES[tag] for tag in tags.items() if tag in _LINES]
    shapes = []
    for layer, width in found:
        least = (SAMPLED if layer in ("path", "fence", "bush", "tree") else CONNECTED) * cell
        shapes.append(Patch(layer, strip(line.points, max(width, least))))
    return shapes + sidewalks(line, sides, cell) if sides else shapes


def _area_shapes(area: Area) -> list[Patch]:
    tags = area.tags
    paved = tags.get("area:highway", tags.get("highway"))
    layer = next((_AREAS[tag] for tag in tags.items() if tag in _AREAS), None)
    if "building" in tags:
        layer = None if tags["building"] in ("roof", "no") else "house"
    elif paved is not None:
        layer = None if paved in _CLOSED else "pavement" if paved in _WALKED else "road"
    elif tags.get("amenity") == "parking":
        layer = "driveway" if tags.get("parking", "surface") in ("surface", "street_side", "lane") else None
    return [] if layer is None else [Patch(layer, area.outer, area.inner)]
