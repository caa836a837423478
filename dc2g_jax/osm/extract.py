"""OpenStreetMap extracts, read by [pyosmium](https://osmcode.org/pyosmium/) and projected to meters.

The plane's x grows to the east and its y to the south, as columns and rows do. The projection is equirectangular.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dc2g_jax.families import Points
from dc2g_jax.files import check_file
from dc2g_jax.runtime import InputError, check_number, require_extra

#: What the license of the data asks to be named.
ATTRIBUTION = "(c) OpenStreetMap contributors, Open Database License (https://www.openstreetmap.org/copyright)"

#: File endings of extracts.
EXTRACT_ENDINGS = (".osm", ".osm.gz", ".osm.pbf")

#: Meters of a degree of latitude, and the most degrees that one plane spans.
_METERS_A_DEGREE, _MOST_DEGREES = 111_195.0, 1.0

#: Keys of the elements that are read.
_KEYS = (
    "highway", "area:highway", "building", "entrance", "barrier", "natural", "landuse", "leisure", "amenity", "railway",
    "waterway",
)  # fmt: skip

_EXPORT = "export it anew, as OpenStreetMap data in degrees (WGS 84)"

#: Coordinate of a node that the extract lacks.
_UNDEFINED = 2**31 - 1

Tags = Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Line:
    """A way that is no area.

    Attributes:
      name: `way` and its number.
      tags: its tags.
      points: its nodes, meters [n 2].
    """

    name: str
    tags: Tags
    points: Points


@dataclass(frozen=True, eq=False)
class Area:
    """A closed way or a multipolygon.

    Attributes:
      name: `way` or `relation` and its number.
      tags: its tags.
      outer: outer rings, meters, each [n 2]; the last point is not the first again.
      inner: rings of holes.
    """

    name: str
    tags: Tags
    outer: list[Points]
    inner: list[Points]

    @property
    def corners(self) -> Points:
        """The points of all outer rings, [n 2]."""
        return np.concatenate(self.outer)


@dataclass(frozen=True, eq=False)
class Spot:
    """A node with tags, at a point [2]."""

    tags: Tags
    point: Points


@dataclass(frozen=True, eq=False)
class Extract:
    """What an extract holds, on the ground and in the open.

    Attributes:
      center: latitude and longitude of the plane's origin, degrees.
      lines: ways; parts of which nodes are missing are left out.
      areas: areas that are complete.
      spots: nodes with tags.
      incomplete: number of ways that lack nodes, because the extract was clipped.
    """

    center: tuple[float, float]
    lines: list[Line]
    areas: list[Area]
    spots: list[Spot]
    incomplete: int

    @property
    def buildings(self) -> list[Area]:
        """The areas that are buildings."""
        return [area for area in self.areas if "building" in area.tags]

    @property
    def streets(self) -> list[Line]:
        """The ways that are public streets, see `is_street`."""
        return [line for line in self.lines if is_street(line.tags)]

    def degrees(self, point: Points) -> tuple[float, float]:
        """Latitude and longitude of a point of the plane [2]."""
        east, north = np.asarray(point) / _meters_a_degree(self.center[0])
        return self.center[0] + float(north), self.center[1] + float(east)


_STREETS = (
    "residential", "living_street", "unclassified", "tertiary", "tertiary_link", "secondary", "secondary_link",
    "primary", "primary_link", "trunk", "trunk_link", "road", "service", "pedestrian",
)  # fmt: skip

#: Values of `service` that are no streets.
_PRIVATE = ("driveway", "parking_aisle", "drive-through", "emergency_access")


def is_street(tags: Tags) -> bool:
    """Whether the tags are those of a street that houses are entered from."""
    return tags.get("highway") in _STREETS and tags.get("service") not in _PRIVATE


def read_extract(path: Path, around: tuple[float, float] | None = None, reach: float = math.inf) -> Extract:
    """Read an extract.

    Args:
      path: a file in one of the formats of `EXTRACT_ENDINGS`.
      around: latitude and longitude of the origin, degrees; the middle of all lines and areas if `None`.
      reach: with `around`, leave out what lies more meters away from the origin, to the east or to the south.

    Raises:
      InputError: pyosmium is not installed, the file is missing, damaged, of another kind or not in degrees, spans too
        much of the globe, or holds no buildings or no streets.
    """
    require_extra("osmium")
    if not path.name.lower().endswith(EXTRACT_ENDINGS):
        raise InputError(f"{path}: is no OpenStreetMap extract; give a file that ends in {', '.join(EXTRACT_ENDINGS)}")
    for name, degrees, most in zip(("latitude", "longitude"), around or (), (89, 180), strict=False):
        check_number(f"--around, {name}", degrees, least=-most, most=most, hint="degrees")
    check_file(path, "give an OpenStreetMap extract")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: is empty; download the extract again")
    import osmium

    reader = _Reader(path, around, reach)
    try:
        for element in osmium.FileProcessor(str(path)).with_areas().with_filter(osmium.filter.KeyFilter(*_KEYS)):
            reader.add(element)
    except osmium.InvalidLocationError as error:
        raise InputError(f"{path}: is not in degrees ({error}); {_EXPORT}") from None
    except InputError:
        raise
    except (RuntimeError, ValueError) as error:
        problem = " ".join(str(error).split())
        raise InputError(f"{path}: is damaged or cut off ({problem}); download the extract again") from None
    extract = _projected(reader, around)
    if not extract.buildings or not extract.streets:
        missing = " and no ".join(kind for kind in ("buildings", "streets") if not getattr(extract, kind))
        where = "" if around is None else f" within {reach:g} m of {around[0]:g} {around[1]:g}"
        lacking = f" (it was clipped, ways that lack nodes: {extract.incomplete:,})" if extract.incomplete else ""
        raise InputError(
            f"{path}: has no {missing}{where}{lacking}; give an extract of a neighborhood, with whole ways and all tags"
        )
    return extract


class _Reader:
    """What has been read so far. Points are longitude and latitude, degrees."""

    def __init__(self, path: Path, around: tuple[float, float] | None, reach: float) -> None:
        self.path = path
        self.lines: list[Line] = []
        self.areas: list[Area] = []
        self.spots: list[Spot] = []
        self.incomplete = 0
        self._box = None if around is None else (np.array(around[::-1]), reach / np.abs(_meters_a_degree(around[0])))

    def add(self, element: Any) -> None:
        """Add a node, way or area, unless it is underground, indoors or out of reach."""
        tags = dict(element.tags)
        if not _in_the_open(tags):
            return
        if element.is_node():
            point = self._runs(f"node {element.id}", [element.location])[0]
            if len(point) and self._in_reach(point):  # deleted nodes have no place
                self.spots.append(Spot(tags, point[0]))
        elif element.is_way():
            runs = self._runs(f"way {element.id}", [node.location for node in element.nodes])
            self.incomplete += sum(map(len, runs)) < len(element.nodes)
            if not (element.is_closed() and _is_area(tags)):
                lines = [Line(f"way{element.id}", tags, run) for run in runs if len(run) > 1]
                self.lines += [line for line in lines if self._in_reach(line.points)]
        elif element.is_area() and _is_area(tags):
            name = f"{'way' if element.from_way() else 'relation'}{element.orig_id()}"
            outer = list(element.outer_rings())
            inner = [hole for ring in outer for hole in element.inner_rings(ring)]
            rings = [
                [self._runs(name, [node.location for node in ring])[0][:-1] for ring in of] for of in (outer, inner)
            ]
            area = Area(name, tags, *rings)
            if self._in_reach(area.corners):
                self.areas.append(area)

    def _in_reach(self, points: Points) -> bool:
        if self._box is None:
            return True
        beyond = np.maximum(points.min(axis=0) - self._box[0], self._box[0] - points.max(axis=0))
        return bool(np.all(beyond <= self._box[1]))

    def _runs(self, name: str, locations: Iterable[Any]) -> list[Points]:
        """Longitude and latitude of each run of nodes that the extract has, each [n 2]; at least one, maybe empty."""
        runs: list[list[tuple[float, float]]] = [[]]
        for location in locations:
            if location.valid():
                runs[-1].append((location.lon, location.lat))
            elif location.x != _UNDEFINED:
                x, y = location.x / 1e7, location.y / 1e7
                raise InputError(f"{self.path}: {name} lies at longitude {x:g}, latitude {y:g}; {_EXPORT}")
            elif runs[-1]:
                runs.append([])
        return [np.array(run, float).reshape(-1, 2) for run in runs]


def _meters_a_degree(latitude: float) -> Points:
    """Meters to the east and to the south of a degree of longitude and of latitude, [2]."""
    return _METERS_A_DEGREE * np.array([math.cos(math.radians(latitude)), -1.0])


def _projected(reader: _Reader, around: tuple[float, float] | None) -> Extract:
    if around is None:
        drawn = [line.points for line in reader.lines] + [area.corners for area in reader.areas]
        points = np.concatenate(drawn or [np.zeros((1, 2))])
        low, high = points.min(axis=0), points.max(axis=0)
        if np.max(high - low) > _MOST_DEGREES:
            raise InputError(
                f"{reader.path}: reaches from longitude {low[0]:.2f} to {high[0]:.2f} and latitude {low[1]:.2f} to "
                f"{high[1]:.2f}, too far for one plane; give --around, or a smaller extract"
            )
        around = (float(low[1] + high[1]) / 2, float(low[0] + high[0]) / 2)
    origin, scale = np.array(around[::-1]), _meters_a_degree(around[0])

    def meters(degrees: Points) -> Points:
        return np.asarray((degrees - origin) * scale)

    return Extract(
        center=around,
        lines=[replace(line, points=meters(line.points)) for line in reader.lines],
        areas=[
            replace(area, outer=list(map(meters, area.outer)), inner=list(map(meters, area.inner)))
            for area in _buildings_once(reader.areas)
        ],
        spots=[replace(spot, point=meters(spot.point)) for spot in reader.spots],
        incomplete=reader.incomplete,
    )


def _buildings_once(areas: Iterable[Area]) -> list[Area]:
    """Areas, without ways whose buildings are relations too. These, which have the courtyards, get the ways' tags."""
    found: dict[object, Area] = {}
    for area in areas:
        outline = frozenset(map(tuple, area.corners)) if "building" in area.tags else area.name
        if outline in found:
            other, area = sorted((found[outline], area), key=lambda one: one.name.startswith("relation"))
            area = replace(area, tags={**other.tags, **area.tags})
        found[outline] = area
    return list(found.values())


def _in_the_open(tags: Tags) -> bool:
    """Whether something is neither underground nor indoors. A passage through a building is in the open."""
    tunnel = tags.get("tunnel", "no") not in ("no", "building_passage")
    below = any(tags.get(key, "").startswith("-") for key in ("layer", "level"))
    return not (tunnel or below or tags.get("location") in ("underground", "roof") or tags.get("indoor", "no") != "no")


def _is_area(tags: Tags) -> bool:
    """Whether a closed way with these tags is an area, not a line."""
    if "highway" in tags or "barrier" in tags:
        return tags.get("area") == "yes"
    return not any(key in tags for key in ("waterway", "railway")) and tags.get("building") != "no"
