"""Maps of the buildings of an OpenStreetMap extract: each with its street, its neighbors, and a door to reach."""

import functools
import itertools
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from scipy import spatial

from dc2g_jax.datasets import House, HouseDataset, sampled
from dc2g_jax.families import PictureFrame, Sketch, resample
from dc2g_jax.grid import FRONT_DOOR, ROAD, TRAVERSABLE, UNKNOWN, ClassImage, connected_to, resize_nearest, sample_grid
from dc2g_jax.osm._entrances import Entry, Site, Uses, add_driveway, facades, is_entrance, plan_entry, street_points
from dc2g_jax.osm._shapes import Patch, fill, mapped_shapes, sidewalk_sides, sidewalks, square_view, street_width
from dc2g_jax.osm.extract import EXTRACT_ENDINGS, Area, Extract, Line, read_extract
from dc2g_jax.runtime import InputError

_Item = TypeVar("_Item", Area, Patch)

#: Share of the streets without mapped sidewalks that get some, and the kinds of streets that may.
_SIDEWALKS, _WITH_SIDEWALKS = 0.7, ("residential", "unclassified", "tertiary", "secondary", "primary")

#: Meters around a building in which its driveway and walkway are looked for, at most.
_GROUNDS = 25.0

#: Meters from the edge of a street within which a mapped sidewalk is its own; margin around what a map shows, meters.
_BESIDE, _MARGIN = 8.0, 4.0


@dataclass(frozen=True, eq=False)
class BuildingMap:
    """The map of a building.

    Attributes:
      latitude: latitude of the map's center, degrees.
      longitude: its longitude.
      classes: class indices, uint8 [H W], north up.
      added: those that are not mapped but added, 0 elsewhere, uint8 [H W].
    """

    latitude: float
    longitude: float
    classes: ClassImage
    added: ClassImage


class _Index(Generic[_Item]):
    """Areas or patches, to be asked for those in a picture."""

    def __init__(self, items: Sequence[_Item]) -> None:
        corners = [np.concatenate(item.outer) for item in items]
        self._items: Sequence[_Item] = items
        self._low = np.array([points.min(axis=0) for points in corners]).reshape(-1, 2)
        self._high = np.array([points.max(axis=0) for points in corners]).reshape(-1, 2)

    def within(self, view: PictureFrame, margin: float = 0.0) -> list[_Item]:
        """Those whose bounds reach into a picture, or the margin around it, meters."""
        corner = view.corner + np.array([view.width, view.height]) / view.scale + margin
        near = np.all((self._low <= corner) & (self._high >= view.corner - margin), axis=1)
        return list(itertools.compress(self._items, near))


class Neighborhood:
    """The buildings of an extract, of which maps can be drawn.

    Args:
      extract: the extract.
      meters: side of the maps.
      cells: columns and rows of the grid that they are sampled to.
      seed: seed of what is added.
      only_mapped: whether to add nothing.
      around: whether to draw only buildings on whose maps the extract's center is.

    Attributes:
      buildings: those with a front door, mapped or not.
    """

    def __init__(
        self, extract: Extract, *, meters: float, cells: int, seed: int, only_mapped: bool, around: bool = False
    ) -> None:
        self._extract, self._meters, self._cells = extract, meters, cells
        self._seed, self._only_mapped = seed, only_mapped
        self._mapped = _Index(mapped_shapes(extract, meters / cells))
        self._streets = street_points(extract.streets)
        self._entrances = list(filter(is_entrance, extract.spots))
        self._sidewalks = _Index([] if only_mapped else self._added_sidewalks())
        self._uses = uses = Uses(extract.buildings)
        self.buildings = [area for area in extract.buildings if uses.has_front_door(area)]
        if around:
            self.buildings = [one for one in self.buildings if self._shows_origin(one)]
        self._entered = _Index([one for one in extract.buildings if uses.has_front_door(one) or uses.is_garage(one)])
        self._entry = functools.cache(self._planned_entry)  # neighbors show it too

    def _shows_origin(self, building: Area) -> bool:
        view = self._view(building)
        return view is not None and bool(np.all((view.corner <= 0) & (view.corner >= -self._meters)))

    def _random(self, name: str) -> np.random.Generator:
        return np.random.default_rng([self._seed, zlib.crc32(name.encode())])

    def _added_sidewalks(self) -> list[Patch]:
        """Sidewalks along streets of which it is not mapped whether they have some."""
        walks = [line.points for line in self._extract.lines if line.tags.get("footway") == "sidewalk"]
        mapped = spatial.KDTree(np.concatenate([resample(points, 2.0) for points in walks])) if walks else None
        shapes: list[Patch] = []
        for line in self._extract.streets:
            usual = line.tags["highway"] in _WITH_SIDEWALKS and sidewalk_sides(line.tags) is None
            beside = mapped is not None and _has_beside(line, mapped)
            if usual and not beside and self._random(line.name).random() < _SIDEWALKS:
                shapes += sidewalks(line, (True, True), self._meters / self._cells)
        return shapes

    def _view(self, building: Area) -> PictureFrame | None:
        """The picture of a building with its street; `None` if the street is too far away.

        Of a building that does not fit with its street, only what is nearest to the street is shown.
        """
        corners, walls = building.corners, facades(building).points
        distance, street = self._streets.nearest(walls)
        nearest = int(np.argmin(distance))
        shown = np.vstack([corners, street[nearest]])
        low, high = shown.min(axis=0), shown.max(axis=0)
        center = (low + high) / 2
        if np.max(high - low) > self._meters - 2 * _MARGIN:
            center = walls[nearest]
            if distance[nearest] > self._meters / 2 - _MARGIN:
                return None
        return square_view(center, self._meters, self._cells)

    def _planned_entry(self, building: Area) -> Entry | str:
        view = self._view(building)
        if view is None:
            return "no street is near enough to be on its map"
        sketch = Sketch(view)
        fill(sketch, [*self._mapped.within(view), *self._sidewalks.within(view)])
        site = Site(building, self._streets, view, sketch.classes(), self._meters / self._cells)
        rng = self._random(building.name)
        if self._uses.has_front_door(building):
            return plan_entry(site, self._entrances, rng, self._only_mapped)
        return Entry([], False, [] if self._only_mapped else add_driveway(site, rng, None)[0])

    def map_of(self, building: Area) -> BuildingMap | str:
        """The map of a building, or the reason why there is none.

        Doors of neighbors that cannot be reached on this map are left out of it.
        """
        entry, view = self._entry(building), self._view(building)
        if isinstance(entry, str) or view is None:
            return str(entry)
        around = [one for one in map(self._entry, self._entered.within(view, _GROUNDS)) if isinstance(one, Entry)]
        mapped = Sketch(view)
        fill(mapped, self._mapped.within(view))
        whole = Sketch(view, {layer: mask.copy() for layer, mask in mapped.masks.items()})
        fill(whole, [*self._sidewalks.within(view), *(shape for one in around for shape in one.added)])
        doors = [(door, one) for one in around for door in one.doors]
        whole.add("door", [door for door, _ in doors])
        grid = sample_grid(whole.classes(), self._cells)
        reached = (grid == FRONT_DOOR) & connected_to(grid == ROAD, TRAVERSABLE[grid])
        doors = [
            (door, one) for door, one in doors if np.any(resize_nearest(whole.mask([door]), *grid.shape) & reached)
        ]
        if not any(one is entry for _, one in doors):
            return f"its door cannot be reached from the street on {self._cells} x {self._cells} cells"
        whole.masks["door"] = whole.mask(door for door, _ in doors)
        mapped.add("door", [door for door, one in doors if one.mapped])
        classes = whole.classes()
        center = view.corner + self._meters / 2
        added = np.where(classes == mapped.classes(), np.uint8(UNKNOWN), classes)
        return BuildingMap(*self._extract.degrees(center), classes, added)


def extract_dataset(folder: str | os.PathLike[str]) -> HouseDataset | None:
    """Draw the buildings of a folder of OpenStreetMap extracts, all in the split `test`; `None` if it has no extracts.

    Buildings without a street in reach are left out. The maps are 60 m wide, in 50 x 50 cells. What is not mapped is
    added, with seed 0.

    Raises:
      InputError: an extract cannot be read, or no building has a street in reach.
    """
    files = sorted(path for ending in EXTRACT_ENDINGS for path in Path(folder).glob(f"*{ending}"))
    if not files:
        return None
    houses: list[House] = []
    for path in files:
        here = Neighborhood(read_extract(path), meters=60.0, cells=50, seed=0, only_mapped=False)
        for building in here.buildings:
            drawn = here.map_of(building)
            if isinstance(drawn, BuildingMap):
                name = f"{path.name.partition('.')[0]}-{building.name}"
                houses.append(House(name, "test", sampled(name, drawn.classes, 50)))
    if not houses:
        raise InputError(f"{folder}: no building of its extracts has a street in reach; give other extracts")
    return HouseDataset(Path(folder).resolve().name, "folder", tuple(houses))


def _has_beside(line: Line, mapped: spatial.KDTree) -> bool:
    distance, _ = mapped.query(resample(line.points, 4.0))
    return bool(np.mean(distance < street_width(line.tags) / 2 + _BESIDE) > 0.3)
