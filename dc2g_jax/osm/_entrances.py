"""Doors, walkways and driveways of buildings: doors as mapped, and what is not mapped, added procedurally."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage, spatial

from dc2g_jax.families import (
    PictureFrame,
    Placement,
    Points,
    Polygons,
    door_outline,
    rectangle,
    resample,
    stroke,
    tapered,
    uniform,
    walkway,
)
from dc2g_jax.grid import DRIVEWAY, HOUSE, NOTHING, ROAD, TRAVERSABLE, ClassImage, connected_to
from dc2g_jax.osm._shapes import CONNECTED, Patch, street_width
from dc2g_jax.osm.extract import Area, Line, Spot

#: Values of `entrance` through which nobody calls, and of `building` that nobody calls at.
_SIDE_ENTRANCES = ("no", "emergency", "exit", "garage", "service", "fire")
_FRONT_ENTRANCES = ("main", "home", "staircase")
_SHEDS = (
    "garage", "garages", "carport", "shed", "roof", "no", "ruins", "greenhouse", "hut", "parking", "construction",
    "service", "bridge", "tank", "transformer_tower", "container", "allotment_house", "barn",
)  # fmt: skip
_GARAGES = ("garage", "garages", "carport")

#: Square meters: least of a building with a front door, of one that stands alone and is called just a building, and of
#: a garage that is not called one; most of a house with a driveway.
_LEAST_GROUND, _LEAST_HOUSE, _LEAST_GARAGE, _MOST_GROUND = 30.0, 80.0, 15.0, 400.0

#: Meters from a building's outline to an entrance that belongs to it.
_ON_OUTLINE = 0.75

#: Meters between points of facades and of streets; how much farther from the street than the nearest a door may be.
_FACADE_STEP, _STREET_STEP, _SETBACK_SPREAD = 1.5, 2.0, 2.5

#: Share of suitable houses that get a driveway, their distance to the street, and from door to driveway, meters.
_DRIVEWAYS, _DRIVEWAY_LENGTH, _DRIVEWAY_ASIDE = 0.85, (3.5, 45.0), (3.5, 12.0)


@dataclass(frozen=True, eq=False)
class Entry:
    """How a building is entered.

    Attributes:
      doors: outlines of its front doors.
      mapped: whether the doors are mapped.
      added: driveway and walkway, which are not.
    """

    doors: Polygons
    mapped: bool
    added: list[Patch] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Facades:
    """Points along a building's walls.

    Attributes:
      points: meters [n 2].
      outward: unit normals [n 2].
    """

    points: Points
    outward: Points

    def frame(self, index: int, point: Points | None = None) -> Placement:
        """The frame of a house whose front runs along x there, with the street toward negative y."""
        x, y = self.outward[index]
        return Placement(self.points[index] if point is None else point, float(np.arctan2(y, x) + np.pi / 2))


class Uses:
    """What the buildings of a neighborhood are used for, by their tags, sizes and neighbors.

    Small ones that stand alone, without an address or a use, are taken for garages and sheds.
    """

    def __init__(self, buildings: Sequence[Area]) -> None:
        corners = np.round(np.concatenate([building.corners for building in buildings]), 2)
        unique, counts = np.unique(corners, axis=0, return_counts=True)
        self._shared = set(map(tuple, unique[counts > 1].tolist()))

    def has_front_door(self, building: Area) -> bool:
        """Whether people call at a building."""
        named = building.tags["building"] not in _SHEDS and _ground(building) >= _LEAST_GROUND
        return named and not self._is_outbuilding(building)

    def is_garage(self, building: Area) -> bool:
        """Whether cars are kept in a building."""
        unnamed = self._is_outbuilding(building) and _ground(building) >= _LEAST_GARAGE
        return building.tags["building"] in _GARAGES or unnamed

    def _is_outbuilding(self, building: Area) -> bool:
        unnamed = building.tags["building"] == "yes" and "addr:housenumber" not in building.tags
        if not unnamed or _ground(building) >= _LEAST_HOUSE:
            return False
        return not any(tuple(corner) in self._shared for corner in np.round(building.corners, 2).tolist())


def _ground(building: Area) -> float:
    """Square meters within the outer rings."""
    return sum(abs(_doubled_ground(ring)) / 2 for ring in building.outer)


def _doubled_ground(ring: Points) -> float:
    x, y = ring.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def facades(building: Area) -> Facades:
    """Points along the walls of a building, none at a corner."""
    points, outward = [], []
    for ring in building.outer:
        edges = np.roll(ring, -1, axis=0) - ring
        lengths = np.hypot(*edges.T)
        sign = np.sign(_doubled_ground(ring))
        for start, edge, length in zip(ring, edges, lengths, strict=True):
            if length > 0:
                count = max(round(length / _FACADE_STEP), 1)
                points.append(start + (np.arange(count)[:, None] + 0.5) / count * edge)
                outward.append(np.broadcast_to(sign * np.array([edge[1], -edge[0]]) / length, (count, 2)))
    return Facades(np.concatenate(points), np.concatenate(outward))


@dataclass(frozen=True, eq=False)
class StreetPoints:
    """Points along streets, to be asked for the nearest.

    Attributes:
      points: meters [n 2].
      half_widths: half the width of the street at each [n].
      names: name of the street of each [n].
      main: whether it is a street, not an alley or another service road [n].
    """

    points: Points
    half_widths: Float[np.ndarray, "n"]
    names: np.ndarray
    main: Bool[np.ndarray, "n"]

    @functools.cached_property
    def by_kind(self) -> tuple["StreetPoints", "StreetPoints"]:
        """Those of streets, and those of alleys and other service roads."""
        return self.where(self.main), self.where(~self.main)

    @functools.cached_property
    def _tree(self) -> spatial.KDTree:
        return spatial.KDTree(self.points)

    def where(self, chosen: Bool[np.ndarray, "n"]) -> "StreetPoints":
        """Some of the points, maybe none."""
        return StreetPoints(self.points[chosen], self.half_widths[chosen], self.names[chosen], self.main[chosen])

    def nearest(self, points: Points) -> tuple[Float[np.ndarray, "k"], Points]:
        """Meters from each point [k 2] to the nearest street's edge, and the nearest point in its middle [k 2]."""
        distance, index = self._tree.query(points)
        return distance - self.half_widths[index], self.points[index]


def street_points(streets: Sequence[Line]) -> StreetPoints:
    """Points along streets, at least one street."""
    lines = [resample(line.points, _STREET_STEP) for line in streets]
    counts = [len(line) for line in lines]
    return StreetPoints(
        points=np.concatenate(lines),
        half_widths=np.repeat([street_width(line.tags) / 2 for line in streets], counts),
        names=np.repeat([line.tags.get("name", "") for line in streets], counts),
        main=np.repeat([line.tags["highway"] != "service" for line in streets], counts),
    )


class Site:
    """A building and the picture around it, as far as it is known.

    Attributes:
      building: the building.
      walls: its walls.
      streets: the streets.
      view: the frame of the picture.
      classes: its class indices.
      cell: side of a cell of its grid, meters: nothing is too narrow to appear there.
    """

    def __init__(
        self, building: Area, streets: StreetPoints, view: PictureFrame, classes: ClassImage, cell: float
    ) -> None:
        self.building, self.walls, self.streets = building, facades(building), streets
        self.view, self.classes, self.cell = view, classes, cell
        self._connected = connected_to(classes == ROAD, TRAVERSABLE[classes])

    @functools.cached_property
    def _nearest(self) -> np.ndarray:
        """Row and column of the nearest connected pixel of each pixel [2 H W]."""
        return ndimage.distance_transform_edt(~self._connected, return_distances=False, return_indices=True)

    def at(self, points: Points) -> np.ndarray:
        """Classes at points [n 2]; house beyond the edge."""
        x, y = self.view.to_pixels(points).T
        return np.asarray(ndimage.map_coordinates(self.classes, [y, x], order=0, cval=HOUSE))

    def clear(self, start: Points, end: Points) -> bool:
        """Whether nothing stands between two points [2]."""
        count = int(np.hypot(*(end - start)) / 0.25) + 2
        return not np.any(np.isin(self.at(np.linspace(start, end, count)), (HOUSE, NOTHING)))

    def nearest_ground(self, point: Points) -> Points | None:
        """The nearest point [2] of ground that leads to a street, `None` if there is none."""
        if not np.any(self._connected):
            return None
        x, y = np.clip(self.view.to_pixels(point[None])[0], 0, (self.view.width - 1, self.view.height - 1))
        row, column = self._nearest[:, y, x]
        return np.array([column + 0.5, row + 0.5]) / self.view.scale + self.view.corner


def _mapped_doors(site: Site, entrances: Sequence[Spot]) -> list[Placement]:
    """Frames of the entrances on a building's outline: of the main ones, or else of all."""
    if not entrances:
        return []
    distance, index = spatial.KDTree(site.walls.points).query([spot.point for spot in entrances])
    near = [
        i
        for i, meters in enumerate(distance)
        if meters < 3 * _FACADE_STEP and _on_outline(entrances[i].point, site.building)
    ]
    main = [i for i in near if entrances[i].tags["entrance"] in _FRONT_ENTRANCES] or near
    return [site.walls.frame(int(index[i]), entrances[i].point) for i in main]


def is_entrance(spot: Spot) -> bool:
    """Whether a node is an entrance for people that is used every day."""
    return spot.tags.get("entrance", "no") not in _SIDE_ENTRANCES


def _on_outline(point: Points, building: Area) -> bool:
    for ring in building.outer:
        edges = np.roll(ring, -1, axis=0) - ring
        share = np.clip(np.sum((point - ring) * edges, axis=1) / np.maximum(np.sum(edges**2, axis=1), 1e-9), 0, 1)
        if np.min(np.hypot(*(ring + share[:, None] * edges - point).T)) < _ON_OUTLINE:
            return True
    return False


def _front_of(site: Site, rng: np.random.Generator) -> int | None:
    """A place for a front door: a point of the walls that faces a street, with nothing between.

    The street of the address comes first, then any other, then alleys. The place is drawn from those nearly as close to
    the street as the closest. `None` if there is none.
    """
    address, streets = site.building.tags.get("addr:street", ""), site.streets
    of_address = streets.where((streets.names == address) & bool(address))
    for chosen in (of_address, *streets.by_kind):
        if len(chosen.points):
            distance, facing = _views(site, chosen)
            if np.any(facing):
                return int(
                    rng.choice(np.flatnonzero(facing & (distance <= np.min(distance[facing]) + _SETBACK_SPREAD)))
                )
    return None


def _views(site: Site, streets: StreetPoints) -> tuple[Float[np.ndarray, "k"], Bool[np.ndarray, "k"]]:
    """Meters from each point of the walls to the nearest street, and whether it faces it with nothing between."""
    walls = site.walls
    distance, street = streets.nearest(walls.points)
    toward = street - walls.points
    ahead = np.sum(toward * walls.outward, axis=1) > 0.5 * np.hypot(*toward.T)
    starts = walls.points + 0.7 * walls.outward
    return distance, np.array([a and site.clear(*ends) for a, *ends in zip(ahead, starts, street, strict=True)])


def add_driveway(site: Site, rng: np.random.Generator, front: Placement | None) -> tuple[list[Patch], Points | None]:
    """A straight driveway from the street to a wall beside the front door, and where a walkway leaves it, [2].

    Detached houses and garages get one where none is mapped, if there is room for it.

    Args:
      site: the house or garage.
      rng: random number generator.
      front: frame of the front door; `None` for a garage.
    """
    walls = site.walls
    beside = site.at(np.concatenate([walls.points + reach * walls.outward for reach in (1.2, 2.5, 4.0)]))
    attached = np.mean(beside[: len(walls.points)] == HOUSE) > 0.12
    served = np.any((beside == DRIVEWAY) | (beside == ROAD))
    if (
        served
        or (front is not None and (attached or _ground(site.building) > _MOST_GROUND))
        or rng.random() > _DRIVEWAYS
    ):
        return [], None
    distance, facing = _views(site, site.streets)
    facing &= (distance > _DRIVEWAY_LENGTH[0]) & (distance < _DRIVEWAY_LENGTH[1])
    if front is not None:
        aside = np.hypot(*(walls.points - front.origin).T)
        facing &= (aside > _DRIVEWAY_ASIDE[0]) & (aside < _DRIVEWAY_ASIDE[1])
    for index in rng.permutation(np.flatnonzero(facing & (distance < np.min(distance[facing], initial=np.inf) + 4))):
        wall, frame = walls.points[index], walls.frame(int(index))
        street = site.streets.nearest(wall[None])[1][0]
        toward = (street - wall) / np.hypot(*(street - wall))
        mouth = wall + (distance[index] + 1.0) * toward
        side = 1.4 * np.array([-toward[1], toward[0]])
        if all(site.clear(wall + toward + s * side, mouth + s * side) for s in (-1, 1)):
            line = resample(np.array([mouth, wall + toward, frame.place((0, 0.5))]), 0.8)
            width = max(uniform(rng, (3.0, 5.0) if front is not None else (2.6, 3.4)), CONNECTED * site.cell)
            shape = tapered(rng, line, width, width, uniform(rng, (1.0, 1.5)))
            return [Patch("driveway", shape)], wall + uniform(rng, (1.0, 3.0)) * toward
    return [], None


def _add_walkway(site: Site, rng: np.random.Generator, door: Placement, start: Points | None) -> list[Patch] | None:
    """A walkway to a door, from a driveway, or straight from the nearest ground that leads to a street.

    Args:
      site: the building.
      rng: random number generator.
      door: frame of the door.
      start: where the walkway leaves a driveway; `None` if there is none.

    Returns:
      The walkway, nothing where the door needs none, `None` if nothing leads to the door.
    """
    width, threshold = max(uniform(rng, (0.9, 1.6)), site.cell), door.place((0, -0.7))
    if start is not None:
        shape = walkway(rng, (0.0, 0.0), door, start, width)
        if np.mean(site.at(np.concatenate(shape)) == HOUSE) < 0.2:
            return [Patch("path", shape)]
        if site.clear(threshold, start):
            return [Patch("path", stroke(np.array([start, threshold, door.origin]), width))]
    ends = [site.nearest_ground(threshold), site.streets.nearest(door.origin[None])[1][0]]
    for end in ends:
        if end is not None and site.clear(threshold, end):
            length = float(np.hypot(*(end - threshold)))
            if length < 0.5:
                return []
            beyond = end + 0.6 * (end - threshold) / length
            return [Patch("path", stroke(np.array([beyond, threshold, door.origin]), width))]
    return None


def plan_entry(site: Site, entrances: Sequence[Spot], rng: np.random.Generator, only_mapped: bool) -> Entry | str:
    """How a building is entered, or the reason why it is not.

    Args:
      site: the building.
      entrances: entrances of all buildings.
      rng: random number generator.
      only_mapped: whether to add nothing.
    """
    size = max(1.0, site.cell)
    doors = _mapped_doors(site, entrances)
    outlines = [door.place(size * rectangle(-1.2, -0.8, 1.2, 0.9)) for door in doors]
    if only_mapped:
        return Entry(outlines, mapped=True) if doors else "no front door is mapped"
    mapped = bool(doors)
    if not mapped:
        front = _front_of(site, rng)
        if front is None:
            return "no wall faces a street with nothing between"
        doors = [site.walls.frame(front)]
        outlines = [doors[0].place(door_outline(rng, (0.0, 0.0), size))]
    driveway, start = add_driveway(site, rng, doors[0])
    walks = [_add_walkway(site, rng, door, start if door is doors[0] else None) for door in doors]
    added = [shape for walk in walks if walk for shape in walk] + driveway
    reached = [outline for outline, walk in zip(outlines, walks, strict=True) if walk is not None]
    return Entry(reached, mapped, added) if reached else "no ground leads to its mapped doors"
