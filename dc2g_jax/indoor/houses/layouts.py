"""Layouts of houses: rooms on a coarse grid of squares, with the walls and doors between them.

Rooms grow as in Lopes et al., "A constrained growth method for procedural floor plan generation" (2010): first as
rectangles, then into the remaining squares, which makes some of them L-shaped. Of several attempts, the layout whose
doors connect the most plausible rooms is kept.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from dc2g_jax.indoor.houses.plans import HousePlan, Room, Segment
from dc2g_jax.indoor.maps.classes import BATHROOM, BEDROOM, KITCHEN, LIVING_ROOM

Square = tuple[int, int]

#: Number of rooms -> weight, and lists of rooms: those of ProcTHOR's training houses, and larger houses in their style.
_PROGRAMS: dict[int, tuple[float, tuple[str, ...]]] = {
    1: (0.12, ("L", "L", "B", "K")),
    2: (0.21, ("BW", "LK")),
    3: (0.16, ("LKB",)),
    4: (0.13, ("LKBW",)),
    5: (0.14, ("LKBBW",)),
    6: (0.08, ("LKBBWW",)),
    7: (0.08, ("LKBBBWW",)),
    8: (0.05, ("LKBBBWWW", "LLKBBBWW")),
    9: (0.02, ("LLKBBBWWW",)),
    10: (0.01, ("LLKBBBBWWW",)),
}
_KINDS = {"L": LIVING_ROOM, "K": KITCHEN, "B": BEDROOM, "W": BATHROOM}

#: Room type -> mean target area, square meters, and spread of its logarithm. Final rooms are as large as ProcTHOR's.
_AREAS = {BEDROOM: 26.0, BATHROOM: 12.5, KITCHEN: 27.0, LIVING_ROOM: 25.0}
_AREA_SPREAD = 0.28

#: Range of the side of a square, meters.
_UNITS = (1.6, 2.1)

#: Implausibility of a door between two types of rooms; `_STRANGE` for pairs that are not listed.
_DISTANCES = {
    frozenset((LIVING_ROOM, KITCHEN)): 0.0,
    frozenset((LIVING_ROOM,)): 0.5,
    frozenset((LIVING_ROOM, BEDROOM)): 1.0,
    frozenset((BEDROOM, BATHROOM)): 1.0,
    frozenset((LIVING_ROOM, BATHROOM)): 1.6,
    frozenset((KITCHEN, BEDROOM)): 2.4,
    frozenset((BEDROOM,)): 2.6,
    frozenset((KITCHEN, BATHROOM)): 3.0,
}
_STRANGE = 6.0

#: Penalties of a layout: for a path that leads through a bathroom, and for a room of less than half its target size.
_THROUGH_BATHROOM, _CRAMPED = 4.0, 3.0

#: Probabilities that kitchen and living room are one space, that rooms get an additional door, and of wide doors.
_OPEN_KITCHEN, _FURTHER_DOOR, _WIDE = 0.65, 0.15, 0.72

#: Ranges of the widths of doors, and least length of wall beside a door, meters.
_DOOR_WIDTH, _WIDE_DOOR_WIDTH, _JAMB = (1.0, 1.05), (1.9, 2.0), 0.15

#: Share of its target size up to which a room grows as a rectangle.
_RECTANGLE = 0.85

_TRIES = 6
_SIDES: tuple[Square, ...] = ((1, 0), (-1, 0), (0, 1), (0, -1))


class Layout(NamedTuple):
    """An empty house.

    Attributes:
      plan: its plan without furniture.
      unit: side of a square, meters.
      squares: squares of each room: column and row, rows counted upward.
      open: borders between rooms without wall.
    """

    plan: HousePlan
    unit: float
    squares: tuple[frozenset[Square], ...]
    open: tuple[Segment, ...]


def draw_layout(rng: np.random.Generator) -> Layout:
    """A random house without furniture."""
    counts = list(_PROGRAMS)
    shares = np.array([_PROGRAMS[count][0] for count in counts])
    programs = _PROGRAMS[counts[int(rng.choice(len(counts), p=shares / shares.sum()))]][1]
    kinds = tuple(_KINDS[letter] for letter in programs[int(rng.integers(len(programs)))])
    unit = round(float(rng.uniform(*_UNITS)), 1)
    while True:
        grown = [_grown(rng, kinds, unit) for _ in range(_TRIES)]
        layouts = [_with_doors(rng, kinds, unit, squares) for squares in grown if squares]
        found = [entry for entry in layouts if entry is not None]
        if found:
            return min(found, key=lambda entry: entry[0])[1]


def _grown(rng: np.random.Generator, kinds: Sequence[int], unit: float) -> list[set[Square]] | None:
    """The squares of each room, or `None` if the rooms do not fit or leave a hole."""
    spread = np.exp(rng.normal(0, _AREA_SPREAD, len(kinds)) - _AREA_SPREAD**2 / 2)
    targets = [max(2, round(_AREAS[kind] * s / unit**2)) for kind, s in zip(kinds, spread, strict=True)]
    ground = _ground(rng, sum(targets))
    seeds = rng.permutation(len(ground))[: len(kinds)]
    if len(seeds) < len(kinds):
        return None
    places = sorted(ground)
    rooms = [{places[seed]} for seed in seeds]
    left = ground.difference(*rooms)
    _grow_rectangles(rng, rooms, left, targets)
    _give_away(rooms, left, targets)
    return None if left else rooms


def _ground(rng: np.random.Generator, area: int) -> set[Square]:
    """The ground of a house, about `area` squares: a rectangle with some of its corners cut off."""
    room = area * rng.uniform(0.95, 1.45)
    width = max(1, round(float(np.sqrt(room) * np.exp(rng.normal(0, 0.2)))))
    height = max(1, round(room / width))
    ground = set(itertools.product(range(width), range(height)))
    for right, upper in rng.permutation([(0, 0), (0, 1), (1, 0), (1, 1)]):
        spare = len(ground) - area
        if spare <= 0 or min(width, height) < 2:
            break
        across = int(rng.integers(1, max(2, width // 2 + 1)))
        up = max(1, min(round(spare / across), height // 2))
        cut = itertools.product(range(across), range(up))
        corner = {(width - 1 - x if right else x, height - 1 - y if upper else y) for x, y in cut}
        if len(ground - corner) >= area:
            ground -= corner
    return ground


def _grow_rectangles(
    rng: np.random.Generator, rooms: list[set[Square]], left: set[Square], targets: Sequence[int]
) -> None:
    """Push whole sides of rooms outward, of the smallest for its target first, until none can or needs to grow."""
    growing = set(range(len(rooms)))
    while growing:
        room = min(growing, key=lambda index: len(rooms[index]) / targets[index])
        strips = []
        for x, y in _SIDES:
            ahead = {(column + x, row + y) for column, row in rooms[room]} - rooms[room]
            if ahead <= left and len(rooms[room]) + len(ahead) <= _RECTANGLE * targets[room] + 1:
                strips.append(ahead)
        if not strips or len(rooms[room]) >= targets[room]:
            growing.discard(room)
            continue
        # Long sides first, so that rooms do not become corridors.
        strip = max(strips, key=lambda ahead: len(ahead) + rng.uniform(0, 0.9))
        rooms[room] |= strip
        left -= strip


def _give_away(rooms: list[set[Square]], left: set[Square], targets: Sequence[int]) -> None:
    """Assign each remaining square to the room with most sides along it, then to the smallest room for its target."""
    while left:
        claims = []
        for square in sorted(left):
            for index, room in enumerate(rooms):
                touching = sum((square[0] + x, square[1] + y) in room for x, y in _SIDES)
                if touching:
                    claims.append((touching, -len(room) / targets[index], square, index))
        if not claims:
            return
        _, _, square, index = max(claims)
        rooms[index].add(square)
        left.discard(square)


def _with_doors(
    rng: np.random.Generator, kinds: tuple[int, ...], unit: float, squares: list[set[Square]]
) -> tuple[float, Layout] | None:
    """The implausibility of a house and the house; `None` if a room has a hole or cannot be reached."""
    outlines = [_outline(room) for room in squares]
    if any(outline is None for outline in outlines):
        return None
    borders = _borders(squares, unit)
    linked, cost = _links(rng, kinds, borders)
    if linked is None:
        return None
    needed = [round(_AREAS[kind] / unit**2) for kind in kinds]
    cost += _CRAMPED * sum(len(room) < 0.5 * target for room, target in zip(squares, needed, strict=True))
    opened = {
        pair
        for pair in linked
        if {kinds[number] for number in pair} == {KITCHEN, LIVING_ROOM} and rng.random() < _OPEN_KITCHEN
    }
    doors = [_door(rng, borders[pair]) for pair in sorted(linked - opened)]
    runs = [(pair, run) for pair, found in borders.items() for run in found]
    plan = HousePlan(
        rooms=tuple(Room(kind, np.array(outline, float) * unit) for kind, outline in zip(kinds, outlines, strict=True)),
        walls=tuple(run for pair, run in runs if pair not in opened),
        doors=tuple(doors),
        furniture=(),
    )
    layout = Layout(
        plan,
        unit,
        squares=tuple(frozenset(room) for room in squares),
        open=tuple(run for pair, run in runs if pair in opened),
    )
    return cost, layout


def _outline(room: set[Square]) -> list[Square] | None:
    """The corners of a room, counter-clockwise; `None` if it has a hole or touches itself."""
    sides: dict[Square, Square] = {}
    count = 0
    for x, y in room:
        corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)]
        beyond = [(x, y - 1), (x + 1, y), (x, y + 1), (x - 1, y)]
        for start, end, neighbor in zip(corners, [*corners[1:], corners[0]], beyond, strict=True):
            if neighbor not in room:
                sides[start] = end
                count += 1
    if len(sides) != count:
        return None  # two sides begin at one corner: the outline is not unique
    first = min(sides)
    walk = [first]
    while (following := sides[walk[-1]]) != first:
        walk.append(following)
    if len(walk) != count:
        return None
    turns = zip([walk[-1], *walk], walk, [*walk[1:], first], strict=False)
    return [here for before, here, after in turns if (before[0] - after[0]) * (before[1] - after[1]) != 0]


#: Two rooms by number, -1 being the outside, the smaller first.
_Pair = tuple[int, int]


def _borders(squares: Sequence[set[Square]], unit: float) -> dict[_Pair, list[Segment]]:
    """The straight borders between every two rooms, and between rooms and the outside, in meters."""
    owner = {square: number for number, room in enumerate(squares) for square in room}
    sides: dict[tuple[_Pair, bool, int], list[int]] = {}
    for x, y in owner:
        for upright, (across, along), beyond in (
            (True, (x, y), (x - 1, y)),
            (True, (x + 1, y), (x + 1, y)),
            (False, (y, x), (x, y - 1)),
            (False, (y + 1, x), (x, y + 1)),
        ):
            one, other = sorted((owner[x, y], owner.get(beyond, -1)))
            if one != other:
                sides.setdefault(((one, other), upright, across), []).append(along)
    borders: dict[_Pair, list[Segment]] = {}
    for (pair, upright, across), found in sorted(sides.items()):
        steps = np.unique(found)
        for run in np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1):
            low, high = int(run[0]), int(run[-1]) + 1
            ends = np.array([(across, low), (across, high)]) * unit
            start, end = (ends if upright else ends[:, ::-1]).tolist()
            borders.setdefault(pair, []).append(Segment(tuple(start), tuple(end)))
    return borders


def _links(
    rng: np.random.Generator, kinds: Sequence[int], borders: Mapping[_Pair, object]
) -> tuple[set[_Pair] | None, float]:
    """Pairs of rooms with a door, which connect all rooms, and the implausibility of these doors."""
    pairs = [pair for pair in borders if pair[0] >= 0]
    cost = {
        (one, other): _DISTANCES.get(frozenset((kinds[one], kinds[other])), _STRANGE) + rng.uniform(0, 0.8)
        for one, other in pairs
    }
    groups = DisjointSet(range(len(kinds)))
    linked: set[_Pair] = set()
    # Bathrooms come last, each with one door: paths lead through them only if there is no other.
    for pair in sorted(pairs, key=lambda pair: (BATHROOM in (kinds[pair[0]], kinds[pair[1]]), cost[pair])):
        if groups.merge(*pair):
            linked.add(pair)
    if groups.n_subsets > 1:
        return None, 0.0
    total = sum(cost[pair] for pair in linked)
    doors_of = [number for pair in linked for number in pair]
    total += _THROUGH_BATHROOM * sum(
        doors_of.count(number) > 1 for number, kind in enumerate(kinds) if kind == BATHROOM
    )
    further = {pair for pair in pairs if pair not in linked and cost[pair] < 2 and rng.random() < _FURTHER_DOOR}
    return linked | further, total


def _door(rng: np.random.Generator, borders: Sequence[Segment]) -> Segment:
    """A door at a random place in the walls between two rooms."""
    lengths = [np.hypot(*np.subtract(border.end, border.start)) for border in borders]
    index = int(rng.choice(len(borders), p=np.array(lengths) / sum(lengths)))
    start, length = np.array(borders[index].start), float(lengths[index])
    along = (np.array(borders[index].end) - start) / length
    is_wide = rng.random() < _WIDE and length > _WIDE_DOOR_WIDTH[1] + 2 * _JAMB
    width = float(rng.uniform(*(_WIDE_DOOR_WIDTH if is_wide else _DOOR_WIDTH)))
    offset = float(rng.uniform(_JAMB, length - width - _JAMB))
    near, far = start + offset * along, start + (offset + width) * along
    return Segment((float(near[0]), float(near[1])), (float(far[0]), float(far[1])))
