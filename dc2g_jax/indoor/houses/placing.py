"""Placement of furniture in a room: along walls, in corners or away from them, without blocking a robot.

Placed furniture never moves. Every door keeps a free square on both sides, and pieces that are used from the front,
such as a couch, keep their front free. A piece that would cut off floor from a robot is not placed.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from dc2g_jax.grid import component_numbers
from dc2g_jax.indoor.houses.layouts import Layout
from dc2g_jax.indoor.houses.plans import MARGIN, Furniture, Segment, world_from_plan
from dc2g_jax.indoor.maps.cost_maps import ROBOT_RADIUS, inflated

#: Side of the cells with which reachability is checked, meters.
CHECK_CELLS = 0.1

#: Distance from the center line of a wall to the back of a piece against it, meters.
_BEHIND = 0.07

#: Free space in front of a door, and between two pieces, meters.
_BEFORE_DOOR, _BETWEEN = 0.9, 0.02

_ATTEMPTS = 10


class Rectangle(NamedTuple):
    """Left, lower, right and upper border, meters."""

    left: float
    lower: float
    right: float
    upper: float

    def overlaps(self, other: "Rectangle", gap: float = 0.0) -> bool:
        """Whether two rectangles are nearer to each other than a gap."""
        return (
            self.left < other.right + gap
            and other.left < self.right + gap
            and self.lower < other.upper + gap
            and other.lower < self.upper + gap
        )


class Wall(NamedTuple):
    """A straight wall seen from its room.

    Attributes:
      start: one end.
      along: unit vector to the other end.
      inward: unit vector into the room.
      length: meters.
    """

    start: tuple[float, float]
    along: tuple[int, int]
    inward: tuple[int, int]
    length: float


def bounds(piece: Furniture) -> Rectangle:
    """The axis-aligned bounding rectangle of a piece."""
    cosine, sine = abs(math.cos(piece.angle)), abs(math.sin(piece.angle))
    across = (piece.width * cosine + piece.depth * sine) / 2
    up = (piece.width * sine + piece.depth * cosine) / 2
    return Rectangle(piece.x - across, piece.y - up, piece.x + across, piece.y + up)


def in_front(piece: Furniture, along: float, ahead: float) -> tuple[float, float]:
    """A point relative to a piece: `along` to the side along its back, and `ahead` in front of its center."""
    cosine, sine = math.cos(piece.angle), math.sin(piece.angle)
    return piece.x + along * cosine - ahead * sine, piece.y + along * sine + ahead * cosine


class Floor:
    """The floor of a house in cells, and which of them are free."""

    def __init__(self, layout: Layout) -> None:
        world = world_from_plan(layout.plan, CHECK_CELLS)
        corners = np.array(layout.plan.walls).reshape(-1, 2)
        self.free, self.rooms = np.asarray(world.free).copy(), np.asarray(world.rooms)
        self._left, self._top = float(corners[:, 0].min()) - MARGIN, float(corners[:, 1].max()) + MARGIN

    def cells(self, area: Rectangle, reach: float = 0.0) -> tuple[slice, slice]:
        """The cells whose center lies in a rectangle or within `reach` of it."""
        left, right = ((x - self._left) / CHECK_CELLS - 0.5 for x in (area.left - reach, area.right + reach))
        upper, lower = ((self._top - y) / CHECK_CELLS - 0.5 for y in (area.upper + reach, area.lower - reach))
        rows = slice(max(math.ceil(upper), 0), max(math.floor(lower) + 1, 0))
        return rows, slice(max(math.ceil(left), 0), max(math.floor(right) + 1, 0))


class RoomSketch:
    """A room that is being furnished.

    Args:
      rng: random number generator.
      layout: the house.
      number: number of the room.
      floor: floor of the house, updated with every piece.

    Attributes:
      kind: type of the room.
      pieces: furniture placed so far.
    """

    def __init__(self, rng: np.random.Generator, layout: Layout, number: int, floor: Floor) -> None:
        self.rng, self.kind, self.pieces = rng, layout.plan.rooms[number].kind, list[Furniture]()
        self._squares, self._unit, self._floor = layout.squares[number], layout.unit, floor
        self._walls = _walls_of(layout, number)
        corners = layout.plan.rooms[number].outline
        area = Rectangle(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
        self._window = floor.cells(area, 3 * CHECK_CELLS)
        inside = floor.rooms == number + 1
        doors = [door for door in layout.plan.doors if np.any(inside[floor.cells(_widened(door, CHECK_CELLS))])]
        for door in doors:
            # The path to a door has to stay open too.
            opening = floor.cells(_widened(door, CHECK_CELLS))
            inside[opening] = floor.free[opening]
        self._inside = inside[self._window]
        self._kept = [_widened(door, _BEFORE_DOOR) for door in doors]
        self._taken = list[Rectangle]()

    def against_wall(
        self, item: Furniture, *, corner: float = 0.0, front: float = 0.0, wall: Wall | None = None
    ) -> Furniture | None:
        """Place a piece with its back to a wall.

        Args:
          item: the piece, wherever it is.
          corner: share of the attempts at an end of the wall.
          front: free space in front of the piece, meters.
          wall: the wall; any if `None`.

        Returns:
          The piece, or `None` if it does not fit.
        """
        walls = [w for w in ([wall] if wall else self._walls) if w.length >= item.width + 2 * _BEHIND]
        if not walls:
            return None
        shares = np.cumsum([w.length for w in walls])
        for _ in range(_ATTEMPTS):
            chosen = walls[int(np.searchsorted(shares, self.rng.uniform(0, shares[-1])))]
            least, most = _BEHIND + item.width / 2, chosen.length - _BEHIND - item.width / 2
            at = self.rng.choice((least, most)) if self.rng.random() < corner else self.rng.uniform(least, most)
            middle = zip(chosen.start, chosen.along, chosen.inward, strict=True)
            x, y = (start + along * float(at) + inward * (_BEHIND + item.depth / 2) for start, along, inward in middle)
            piece = item._replace(x=x, y=y, angle=math.atan2(-chosen.inward[0], chosen.inward[1]))
            if self.place(piece, front=front):
                return piece
        return None

    def anywhere(self, item: Furniture) -> Furniture | None:
        """Place a piece anywhere on the floor, along or across; `None` if it does not fit."""
        squares = sorted(self._squares)
        for _ in range(_ATTEMPTS):
            column, row = squares[int(self.rng.integers(len(squares)))]
            x, y = (column + self.rng.uniform()) * self._unit, (row + self.rng.uniform()) * self._unit
            piece = item._replace(x=x, y=y, angle=float(self.rng.integers(2)) * math.pi / 2)
            if self.place(piece):
                return piece
        return None

    def opposite(self, piece: Furniture) -> Wall | None:
        """The wall that a piece faces."""
        ahead = in_front(piece, 0, 1)
        facing = round(ahead[0] - piece.x), round(ahead[1] - piece.y)
        found = []
        for wall in self._walls:
            distance = (wall.start[0] - piece.x) * facing[0] + (wall.start[1] - piece.y) * facing[1]
            at = (piece.x - wall.start[0]) * wall.along[0] + (piece.y - wall.start[1]) * wall.along[1]
            if wall.inward == (-facing[0], -facing[1]) and distance > 0 and 0 < at < wall.length:
                found.append((distance, wall))
        return min(found)[1] if found else None

    def on(self, piece: Furniture, item: Furniture) -> None:
        """Place a small object on top of a piece."""
        along = max((piece.width - item.width) / 2, 0.0) * self.rng.uniform(-0.9, 0.9)
        back = max((piece.depth - item.depth) / 2, 0.0) * self.rng.uniform(-0.9, 0.3)
        x, y = in_front(piece, along, back)
        self.pieces.append(item._replace(x=x, y=y, angle=piece.angle, top=piece.top + item.top))

    def place(self, piece: Furniture, *, front: float = 0.0, table: Furniture | None = None) -> bool:
        """Place a piece, unless it does not fit or some floor would be cut off.

        Args:
          piece: the piece.
          front: free space in front of it, meters.
          table: a table below which it may extend.
        """
        area = bounds(piece)
        allowed = bounds(table) if table else None
        ahead = [_front(piece, front)] if front else []
        if not all(self._holds(part) for part in (area, *ahead)):
            return False
        if any(area.overlaps(other) for other in self._kept):
            return False
        if any(area.overlaps(other, _BETWEEN) for other in self._taken if other != allowed):
            return False
        if any(part.overlaps(other) for part in ahead for other in self._taken):
            return False
        place = self._floor.cells(area)
        before = self._floor.free[place].copy()
        self._floor.free[place] = False
        if not self._is_one():
            self._floor.free[place] = before
            return False
        self._taken.append(area)
        self._kept += ahead
        self.pieces.append(piece)
        return True

    def _holds(self, area: Rectangle) -> bool:
        """Whether a rectangle is inside the room."""
        columns = range(math.floor(area.left / self._unit), math.floor(area.right / self._unit) + 1)
        rows = range(math.floor(area.lower / self._unit), math.floor(area.upper / self._unit) + 1)
        return all(square in self._squares for square in itertools.product(columns, rows))

    def _is_one(self) -> bool:
        """Whether a robot can drive between all cells of the room in which it fits, including the doors."""
        cells: Bool[np.ndarray, "h w"] = (
            ~inflated(~self._floor.free[self._window], ROBOT_RADIUS, CHECK_CELLS) & self._inside
        )
        return int(component_numbers(cells).max()) == 1


def _front(piece: Furniture, reach: float) -> Rectangle:
    x, y = in_front(piece, 0, (piece.depth + reach) / 2)
    return bounds(piece._replace(x=x, y=y, depth=reach))


def _widened(door: Segment, reach: float) -> Rectangle:
    """The rectangle of a door, extended by `reach` on both of its sides."""
    (x0, y0), (x1, y1) = door
    across, up = (reach, 0.0) if x0 == x1 else (0.0, reach)
    return Rectangle(min(x0, x1) - across, min(y0, y1) - up, max(x0, x1) + across, max(y0, y1) + up)


def _walls_of(layout: Layout, number: int) -> list[Wall]:
    """The walls of a room, including those with doors, without open borders."""
    outline = layout.plan.rooms[number].outline
    walls = []
    for (x0, y0), (x1, y1) in zip(outline.tolist(), np.roll(outline, -1, axis=0).tolist(), strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        along = round((x1 - x0) / length), round((y1 - y0) / length)
        side = Rectangle(min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1))
        is_upright = along[0] == 0
        if not any(
            _widened(border, 0.0).overlaps(side, gap=0.01) and (border.start[0] == border.end[0]) == is_upright
            for border in layout.open
        ):
            walls.append(Wall((x0, y0), along, (-along[1], along[0]), length))
    return walls
