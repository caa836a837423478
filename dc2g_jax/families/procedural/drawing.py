"""Drawing tools of the procedural neighborhoods: geometry in meters and a layered sketch in pixels.

Shapes lie in a plane measured in meters. A shape is a list of polygons, each float [k 2] (x, y). A `PictureFrame`
selects the rotated rectangle of the plane that becomes the image. A `Sketch` fills polygons into masks, one per layer.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from dc2g_jax.families.procedural._filling import fill_polygons
from dc2g_jax.grid import ClassImage, terrain
from dc2g_jax.runtime import check_number

Points = npt.NDArray[np.float64]
Polygons = list[Points]
Range = tuple[float, float]

_ATTEMPTS = 100

#: Layer -> terrain class, in painting order: later layers cover earlier ones. Pavement minus verge is sidewalk.
LAYERS: dict[str, int] = {
    "blocked": terrain.NOTHING,
    "bush": terrain.BUSH,
    "tree": terrain.TREE,
    "fence": terrain.FENCE,
    "path": terrain.PATH,
    "pavement": terrain.SIDEWALK,
    "driveway": terrain.DRIVEWAY,
    "pavement_over_driveway": terrain.SIDEWALK,
    "road": terrain.ROAD,
    "crossing": terrain.SIDEWALK,
    "island": terrain.GRASS,
    "car": terrain.CAR,
    "house": terrain.HOUSE,
    "court": terrain.GRASS,
    "court_path": terrain.PATH,
    "door": terrain.FRONT_DOOR,
}


def first_usable(
    draw: Callable[[np.random.Generator], ClassImage | None], seed: int, key: tuple[int, ...], what: str
) -> ClassImage:
    """Draw again and again, each time with random numbers of its own, until something usable comes out.

    Args:
      draw: draws a map; `None` if it is not usable.
      seed: a non-negative integer.
      key: sets these random numbers apart from those of other drawings of this seed.
      what: what is drawn, for the message.

    Raises:
      InputError: the seed is not a whole number of at least 0.
      RuntimeError: 100 drawings in a row turn out unusable.
    """
    check_number("seed", seed, whole=True, least=0)
    for attempt in range(_ATTEMPTS):
        drawn = draw(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*key, attempt))))
        if drawn is not None:
            return drawn
    raise RuntimeError(f"no usable {what} within {_ATTEMPTS} drawings of seed {seed}")


def uniform(rng: np.random.Generator, limits: Range) -> float:
    """A uniformly distributed number between two limits."""
    return float(rng.uniform(*limits))


def choose(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    """One name, drawn in proportion to its weight."""
    shares = np.array(list(weights.values()))
    return list(weights)[int(np.searchsorted(np.cumsum(shares), rng.uniform(0, shares.sum())))]


@dataclass(frozen=True)
class Placement:
    """A coordinate frame: local points are optionally mirrored (x -> -x), rotated by `angle` and translated."""

    origin: Points
    angle: float
    mirrored: bool = False

    def place(self, points: npt.ArrayLike) -> Points:
        """Local points [... 2] in the parent coordinates of this frame, [... 2]."""
        local = np.asarray(points, dtype=float)
        x, y = (-local[..., 0] if self.mirrored else local[..., 0]), local[..., 1]
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        return np.stack([x * cosine - y * sine, x * sine + y * cosine], axis=-1) + self.origin

    def place_all(self, shape: Iterable[Points]) -> Polygons:
        """Every polygon of a shape in the parent coordinates."""
        polygons = list(shape)
        if not polygons:
            return []
        return np.split(self.place(np.concatenate(polygons)), np.cumsum([len(one) for one in polygons])[:-1])


def random_turn(rng: np.random.Generator, aligned: float, spread: float) -> float:
    """Rotation of an image, radians: within about `spread` of a quarter turn for a share `aligned`, else any angle."""
    if rng.random() < aligned:
        return float(rng.integers(4)) * np.pi / 2 + rng.normal(0, spread)
    return uniform(rng, (0, 2 * np.pi))


def rectangle(left: float, bottom: float, right: float, top: float) -> Points:
    """Corners of an upright rectangle, [4 2]."""
    return np.array([(left, bottom), (right, bottom), (right, top), (left, top)], dtype=float)


def jitter(rng: np.random.Generator, points: Points, amount: float) -> Points:
    """Points moved by normally distributed noise, as in outlines drawn by hand."""
    return points + rng.normal(0.0, amount, points.shape)


def disc(
    rng: np.random.Generator, center: npt.ArrayLike, radius: float, unevenness: float = 0.03, corners: int | None = None
) -> Points:
    """A circle as if outlined by hand: a polygon [corners 2], with 10 to 24 corners by default."""
    count = int(rng.integers(10, 25)) if corners is None else corners
    angles = 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count
    radii = radius * (1 + rng.normal(0, unevenness, count))
    return np.asarray(center, dtype=float) + np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)


def smooth(points: npt.ArrayLike, rounds: int) -> Points:
    """A polyline with its corners cut `rounds` times (Chaikin's algorithm); the ends do not move."""
    line = np.asarray(points, dtype=float)
    for _ in range(rounds):
        near, far = 0.75 * line[:-1] + 0.25 * line[1:], 0.25 * line[:-1] + 0.75 * line[1:]
        line = np.concatenate([line[:1], np.stack([near, far], axis=1).reshape(-1, 2)[1:-1], line[-1:]])
    return line


def traveled(line: Points) -> Points:
    """Distance from the start of a polyline [n 2] at each of its points, [n]."""
    steps = np.hypot(*np.diff(line, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def resample(line: Points, spacing: float) -> Points:
    """A polyline with a point about every `spacing` meters; the ends do not move."""
    distance = traveled(line)
    at = np.linspace(0, distance[-1], max(2, round(distance[-1] / spacing) + 1))
    return np.stack([np.interp(at, distance, line[:, 0]), np.interp(at, distance, line[:, 1])], axis=-1)


def left_normals(line: Points) -> Points:
    """Unit normals to the left of a polyline [n 2], [n 2]."""
    direction = np.gradient(line, axis=0)
    length = np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-9)
    return np.stack([-direction[:, 1] / length, direction[:, 0] / length], axis=-1)


def ribbon(line: Points, left: npt.ArrayLike, right: npt.ArrayLike) -> Polygons:
    """The strip from `left` to `right` meters beside a polyline [n 2], as quadrilaterals that share edges.

    Offsets are positive to the left and negative to the right; each is one number or [n].
    """
    normals = left_normals(line)
    one, other = (line + normals * np.broadcast_to(offset, len(line))[:, None] for offset in (left, right))
    return list(np.stack([one[:-1], one[1:], other[1:], other[:-1]], axis=1))


def stroke(line: Points, width: npt.ArrayLike) -> Polygons:
    """A polyline drawn with a pen of the given full width, one number or [n]."""
    half = np.asarray(width) / 2
    return ribbon(line, half, -half)


def wobble(rng: np.random.Generator, count: int, amount: float) -> Points:
    """A slowly varying random offset of about `amount` at each of `count` points, [count]."""
    knots = rng.normal(0, amount, count // 6 + 2)
    return np.interp(np.linspace(0, len(knots) - 1, count), np.arange(len(knots)), knots)


@dataclass(frozen=True)
class PictureFrame:
    """The frame of the image: points are rotated by `angle`, translated by -`corner` and scaled to pixels."""

    angle: float
    corner: Points
    scale: float
    height: int
    width: int

    def to_pixels(self, points: Points) -> npt.NDArray[np.int32]:
        """Points in meters [k 2] as pixels (column, row), int32 [k 2]."""
        turned = Placement(-self.corner, self.angle).place(points)
        return np.clip(np.rint(turned * self.scale), -30000, 30000).astype(np.int32)


def view_around(
    rng: np.random.Generator, shape: Sequence[Points], angle: float, margins: Range, pixels_per_meter: Range
) -> PictureFrame:
    """The view that contains a shape, with a random margin in meters on each side.

    The sides of the image have 200 to 930 pixels. No side is more than `longest` times the other, a ratio drawn for
    each image from 1.25 to 2.4.
    """
    turned = Placement(np.zeros(2), angle).place(np.concatenate(list(shape)))
    low = turned.min(axis=0) - rng.uniform(*margins, 2)
    high = turned.max(axis=0) + rng.uniform(*margins, 2)
    extent = high - low
    longest = 1.25 + 1.15 * uniform(rng, (0, 1)) ** 1.5
    missing = np.maximum(np.max(extent) / longest - extent, 0)
    corner, extent = low - missing * rng.uniform(0, 1, 2), extent + missing
    scale = uniform(rng, pixels_per_meter)
    scale = min(max(scale, 205 / extent.min()), 925 / extent.max())
    width, height = (round(float(side) * scale) for side in extent)
    return PictureFrame(angle, corner, scale, height, width)


@dataclass
class Sketch:
    """An unfinished image: one mask per layer of `LAYERS`, and the mask `verge`, which removes sidewalk."""

    view: PictureFrame
    masks: dict[str, ClassImage] = field(default_factory=dict)

    def mask(self, shape: Iterable[Points]) -> ClassImage:
        """The pixels that a shape covers, uint8 [H W] of 0 and 1."""
        canvas = np.zeros((self.view.height, self.view.width), np.uint8)
        self._fill(canvas, shape)
        return canvas

    def add(self, layer: str, shape: Iterable[Points]) -> None:
        """Fill a shape into a layer."""
        self._fill(self.masks.setdefault(layer, self.mask(())), shape)

    def add_all(self, shapes: Mapping[str, Iterable[Points]]) -> None:
        """Fill shapes into the layers of their names."""
        for layer, shape in shapes.items():
            self.add(layer, shape)

    def add_clear(self, layer: str, shape: Iterable[Points]) -> None:
        """Fill polygons into a layer one by one, except those that touch what the layer already contains."""
        self.add(layer, [])
        for polygon in shape:
            mask = self.mask([polygon])
            if self.overlap(mask, layer) == 0:
                self.masks[layer] |= mask

    def overlap(self, mask: ClassImage, *layers: str) -> float:
        """Share of a mask's pixels that the layers already cover; 0 for an empty mask."""
        total = int(np.count_nonzero(mask))
        if total == 0:
            return 0.0
        taken = np.zeros_like(mask)
        for layer in layers:
            if layer in self.masks:
                taken |= self.masks[layer]
        return int(np.count_nonzero(mask & taken)) / total

    def classes(self) -> ClassImage:
        """The finished image: class indices, uint8 [H W]."""
        picture = np.full((self.view.height, self.view.width), terrain.GRASS, np.uint8)
        for layer, index in LAYERS.items():
            if layer not in self.masks:
                continue
            mask = self.masks[layer].astype(bool)
            if layer == "house":
                mask = self._without_slits(self.masks[layer])
            if layer.startswith("pavement") and "verge" in self.masks:
                mask &= ~self.masks["verge"].astype(bool)
            picture[mask] = index
        return picture

    def _without_slits(self, mask: ClassImage) -> npt.NDArray[np.bool_]:
        """A mask with its gaps of less than about 0.8 m closed."""
        size = max(round(0.8 * self.view.scale), 1) | 1
        dilated = ndimage.maximum_filter(mask, size, mode="constant", cval=0)
        return ndimage.minimum_filter(dilated, size, mode="constant", cval=1).astype(bool)

    def _fill(self, canvas: ClassImage, shape: Iterable[Points]) -> None:
        polygons = list(shape)
        if not polygons:
            return
        sizes = np.array([len(polygon) for polygon in polygons])
        starts = np.cumsum(sizes) - sizes
        pixels = self.view.to_pixels(np.concatenate(polygons))
        inside = (np.maximum.reduceat(pixels, starts) >= 0).all(axis=1)
        inside &= (np.minimum.reduceat(pixels, starts) < (self.view.width, self.view.height)).all(axis=1)
        if inside.any():  # most shapes lie beside the picture
            fill_polygons(canvas, pixels[np.repeat(inside, sizes)], sizes[inside])
