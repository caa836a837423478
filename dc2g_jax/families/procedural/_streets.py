"""Streets of the procedural neighborhoods: roads, turning circles, sidewalks and curbs."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dc2g_jax.families.procedural.drawing import (
    Placement,
    Points,
    Range,
    Sketch,
    choose,
    disc,
    left_normals,
    ribbon,
    traveled,
    uniform,
    wobble,
)

_REACH = 150.0  # meters of road on either side of the origin of a street
_STEP = 3.0  # meters between the points of a road's center line


@dataclass(frozen=True, eq=False)
class Curb:
    """A road edge [n 2] with lots to its left, and the position of one lot along it (meters)."""

    line: Points
    position: float

    def at(self, offset: float) -> Placement:
        """The frame on the curb `offset` meters beyond the lot: x along the curb, y away from the road."""
        distance = traveled(self.line)
        place = min(max(self.position + offset, 0.0), float(distance[-1]))
        index = min(int(np.searchsorted(distance, place, side="right")) - 1, len(self.line) - 2)
        step = self.line[index + 1] - self.line[index]
        share = (place - distance[index]) / max(float(distance[index + 1] - distance[index]), 1e-9)
        return Placement(self.line[index] + share * step, float(np.arctan2(step[1], step[0])))


@dataclass(frozen=True)
class Sidewalks:
    """Layout of sidewalks: width of the grass between curb and sidewalk, sidewalk width (meters), sides.

    A verge of 0.3 m or less is not drawn.
    """

    verge: float
    width: float
    left: bool
    right: bool
    over_driveways: bool


@dataclass
class Streets:
    """Public roads as (center line [n 2], half widths [n]) and turning circles as (center [2], radius).

    `bulges` are circles that round off a junction and have no sidewalk around them.
    `curbs` lists road edges; the main lot lies along the first.
    """

    roads: list[tuple[Points, Points]] = field(default_factory=list)
    circles: list[tuple[Points, float]] = field(default_factory=list)
    bulges: list[tuple[Points, float]] = field(default_factory=list)
    islands: list[Points] = field(default_factory=list)
    curbs: list[Curb] = field(default_factory=list)

    def add_road(self, line: Points, half_width: npt.ArrayLike) -> None:
        """Add a road, with one half width or one per point [n], and the curbs on both sides."""
        half_widths = np.broadcast_to(np.asarray(half_width, dtype=float), len(line))
        self.roads.append((line, half_widths))
        normals = left_normals(line) * half_widths[:, None]
        for edge in (line + normals, (line - normals)[::-1]):
            self.curbs.append(Curb(edge, float(traveled(edge)[-1]) / 2))

    def draw(self, sketch: Sketch, sidewalks: Sidewalks | None, rng: np.random.Generator) -> None:
        """Fill roads, islands and sidewalks into the sketch."""
        for line, half_widths in self.roads:
            left, right = (half_widths * (1 + wobble(rng, len(line), 0.05)) for _ in range(2))
            sketch.add("road", ribbon(line, left, -right))
            sketch.add("road", [disc(rng, line[0], half_widths[0])])
        for center, radius in (*self.circles, *self.bulges):
            sketch.add("road", [disc(rng, center, radius)])
        sketch.add("island", self.islands)
        if sidewalks is not None:
            self._draw_sidewalks(sketch, sidewalks, rng)

    def _draw_sidewalks(self, sketch: Sketch, sidewalks: Sidewalks, rng: np.random.Generator) -> None:
        layer = "pavement_over_driveway" if sidewalks.over_driveways else "pavement"
        for line, half_widths in self.roads:
            for present, sign in ((sidewalks.left, 1), (sidewalks.right, -1)):
                inner = half_widths + sidewalks.verge + np.abs(wobble(rng, len(line), 0.3))
                outer = inner + sidewalks.width * (1 + wobble(rng, len(line), 0.08))
                if present:
                    sketch.add(layer, ribbon(line, sign * outer, 0.0))
                if sidewalks.verge > 0.3:
                    sketch.add("verge", ribbon(line, sign * inner, 0.0))
        for center, radius in self.circles:
            verge = radius + sidewalks.verge
            sketch.add(layer, [disc(rng, center, verge + sidewalks.width, 0.01, corners=40)])
            if sidewalks.verge > 0.3:
                sketch.add("verge", [disc(rng, center, verge, 0.01, corners=40)])


def wander(rng: np.random.Generator, heading: float, bend: float) -> Points:
    """A line [n 2] from the origin whose heading drifts by about `bend` radians per 100 m."""
    count = int(_REACH / _STEP)
    turns = (wobble(rng, count, bend) + rng.normal(0, bend)) * _STEP / 100
    headings = heading + np.cumsum(turns)
    steps = _STEP * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def lay_streets(rng: np.random.Generator, kinds: dict[str, float], road_width: Range, lot_width: float) -> Streets:
    """Streets of one kind: straight, curved, circle (cul-de-sac), tee, corner, crossing, fork, knuckle."""
    kind = choose(rng, kinds)
    half = uniform(rng, road_width) / 2
    streets = Streets()
    if kind == "circle":
        _lay_circle(rng, streets, half)
        return streets
    bend = {"straight": 0.05, "curved": 1.3, "knuckle": 0.6, "fork": 0.4}.get(kind, 0.25)
    ahead, behind = wander(rng, 0.0, bend), wander(rng, np.pi, bend)
    main = np.concatenate([behind[:0:-1], ahead])  # through the origin, where its direction is +x
    streets.add_road(main, half)
    middle = len(main) // 2
    if kind == "knuckle":
        along = int(rng.integers(-6, 7))
        center = main[middle + along] + left_normals(main)[middle + along] * uniform(rng, (0.3, 1.2)) * half
        streets.circles.append((center, half * uniform(rng, (1.6, 2.4))))
    for side in {"tee": (-1,), "fork": (-1,), "corner": (1,), "crossing": (-1, 1)}.get(kind, ()):
        away = lot_width * uniform(rng, (0.45, 0.75)) if side == 1 else uniform(rng, (-0.6, 1.2)) * lot_width
        at = middle + round(away / _STEP) * (1 if rng.random() < 0.5 else -1)
        slant = uniform(rng, (0.5, 0.9)) if kind == "fork" else uniform(rng, (0.85, 1.15))
        side_road = wander(rng, side * np.pi / 2 * slant, bend) + main[at]
        streets.add_road(side_road, half * uniform(rng, (0.75, 1.1)))
        if rng.random() < 0.5:  # rounded corners at the junction
            streets.bulges.append((main[at], half * uniform(rng, (1.1, 1.5))))
    return streets


def _lay_circle(rng: np.random.Generator, streets: Streets, half_width: float) -> None:
    """Add a cul-de-sac at the origin. The main lot lies at +y; the road leaves elsewhere and is often flared."""
    radius = half_width * uniform(rng, (1.7, 3.4))
    angles = np.linspace(1.5 * np.pi, -0.5 * np.pi, 61)  # clockwise, so that lots lie to the left
    edge = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    streets.curbs.append(Curb(edge, float(traveled(edge)[-1]) / 2))
    streets.circles.append((np.zeros(2), radius))
    heading = -np.pi / 2 + float(rng.choice((-1, 1))) * uniform(rng, (0.0, 2.0))
    road = wander(rng, heading, 0.9)
    mouth = radius * uniform(rng, (1.2, 2.6))
    flare = np.interp(traveled(road), (0.7 * radius, mouth), (uniform(rng, (1.0, 1.7)), 1.0))
    streets.add_road(road, half_width * flare)
    if rng.random() < 0.15:
        streets.islands.append(disc(rng, (0.0, 0.0), radius * uniform(rng, (0.25, 0.5))))
