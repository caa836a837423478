"""Planners that run on a map one step at a time, and their pictures, for the page of `dc2g demo`.

Pictures have one pixel per cell. Marks are SVG in the same coordinates, drawn over the picture.
"""

import base64
import dataclasses
import functools
import io
import tempfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from dc2g_jax import datasets, grid, inspection, planning
from dc2g_jax.estimation import Estimator, answers_in_cells
from dc2g_jax.files import PALETTE_FILE, read_palette, write_palette
from dc2g_jax.runtime import InputError, jit

#: Side length in cells of the map to draw on, and the map size for which marks are one cell large.
BLANK_SIDE, _USUAL_SIDE = 40, 50

#: Most drawings that `undo` goes back, most characters of a link, and most cells of a map in one.
_MOST_KEPT, _LONGEST_LINK, _MOST_CELLS = 200, 4000, 2**20

#: Terms of a learned score whose weights are chosen: distance and information gain.
_WEIGHTED = np.array([planning.LearnedScore.terms.index(term) for term in ("actions", "gain")])

#: Outlines of marks around the origin, as SVG has them: the robot heading right, a door, a subgoal.
_TRIANGLE = "1,0 -.8,-.85 -.8,.85"
_STAR = "0,-1 .25,-.34 .95,-.31 .4,.13 .59,.81 0,.42 -.59,.81 -.4,.13 -.95,-.31 -.25,-.34"
_CROSS = "0,.4 .6,1 1,.6 .4,0 1,-.6 .6,-1 0,-.4 -.6,-1 -1,-.6 -.4,0 -1,.6 -.6,1"


class Snapshot(NamedTuple):
    """The state of a robot before one of its actions, or at the end.

    Attributes:
      pose: its pose.
      seen: observed cells.
      cost_to_go: the planner's cost-to-go of every cell; `None` without predictions.
      to_goal: actions that an oracle needs from here, -1 if no door can be reached.
      decision: the decision.
    """

    pose: planning.RobotPose
    seen: Bool[np.ndarray, "h w"]
    cost_to_go: Float[np.ndarray, "h w"] | None
    to_goal: int
    decision: planning.Decision


@functools.partial(jit, static_argnames=("rules",))
def _advance(
    carry: tuple[grid.Belief, Any], world: grid.World, planner: planning.Planner, *, rules: planning.Rules
) -> tuple[Any, dict[str, Any]]:
    """Decide, then act. Returns the input of the next call, and what the planner saw."""
    belief, state = carry
    assessment, state = planning.assess(planner, belief, state, rules)
    oracle = grid.search.first_action(belief.pose, grid.every_heading(world.goals), world.traversable)
    looked = {
        "pose": (belief.pose.x, belief.pose.y, belief.pose.heading),
        "seen": grid.bitboard.unpack(belief.seen, belief.width),
        "to_goal": jnp.where(oracle.found, oracle.length, -1),
        "view": planning.view_of(belief, assessment),
    }
    return (grid.gridworld.step(world, belief, assessment.plan.action, rules.sensing), state), looked


def _unbounded(planner: planning.Planner) -> Any:
    """The planner that is bounded, or the planner itself."""
    return planner.planner if isinstance(planner, planning.Bounded) else planner


class Walk:
    """One planner's episode, decided step by step. All snapshots are kept.

    Args:
      planner: the planner.
      terrain: class indices of the map.
      start: first pose.
      rules: field of view and definition of frontiers.
    """

    def __init__(
        self,
        planner: planning.Planner,
        terrain: UInt8[np.ndarray, "h w"],
        start: planning.RobotPose,
        rules: planning.Rules,
    ):
        self.snapshots: list[Snapshot] = []
        self.in_cells = answers_in_cells(getattr(planner, "estimator", None))
        self._planner, self._rules, self._world = planner, rules, grid.World.from_terrain(terrain)
        first = grid.gridworld.reset(self._world, grid.make_pose(*start), rules.sensing)
        self._carry = first, planner.init(self._world)

    @property
    def over(self) -> bool:
        """Whether the robot stands on a door, or the planner gave up."""
        return bool(self.snapshots) and self.snapshots[-1].decision.action is None

    def step(self) -> None:
        """Act on the last decision, and decide again. Does nothing if the episode is over.

        Raises:
          InputError: a score is NaN.
        """
        if self.over:
            return
        self._carry, looked = _advance(self._carry, self._world, self._planner, rules=self._rules)
        found = jax.device_get(looked)
        view = found["view"]
        pose = planning.RobotPose(*map(int, found["pose"]))
        self.snapshots.append(
            Snapshot(pose, found["seen"], view.cost_to_go, int(found["to_goal"]), planning.decide(view, 0, 0))
        )

    def summary(self, steps: int) -> str:
        """The robot's progress after this many actions, compared with an oracle's, in one line."""
        snapshot, oracle = self.snapshots[steps], self.snapshots[0].to_goal
        if snapshot.decision.action is None:
            done = "reached the door in" if snapshot.decision.mode == "to_goal" else "gave up after"
            told = f"{done} {steps} {'step' if steps == 1 else 'steps'}"
        else:
            told = f"step {steps}"
        if oracle < 0:
            return f"{told}; no door can be reached"
        if snapshot.to_goal < 0 or oracle == 0:
            return f"{told}; oracle: {oracle}"
        return f"{told}: {100 * (steps + snapshot.to_goal - oracle) / oracle:+.0f} % beyond the oracle ({oracle})"


class Demo:
    """The map, start, settings and planners of one visitor.

    Args:
      maps: class indices of the maps to choose from, by name.
      planners: names of the planners to run.
      estimator: network of planners that use one.

    Attributes:
      terrain: the map; it may be changed.
      start: first pose of the robots.
      sensing_range: range of the field of view in cells.
      field_of_view: its width in degrees.
      distance_weight: weight of an action on the path to a subgoal, for `dc2g` and its variants that use the network.
      gain_weight: weight of the information gain, for the same planners; it lowers the score.
      walks: the episodes by planner.
    """

    def __init__(self, maps: dict[str, UInt8[np.ndarray, "h w"]], planners: Sequence[str], estimator: Estimator):
        self.maps, self.planners, self._estimator = maps, list(planners), estimator
        usual_settings = planning.SETTINGS["paper"]
        self.sensing_range, self.field_of_view = usual_settings.sensing_range, usual_settings.field_of_view
        usual = _unbounded(planning.planner_with("dc2g", self._rules, estimator))
        actions, gain = map(float, usual.weights[_WEIGHTED] if isinstance(usual, planning.LearnedScore) else (0, 0))
        self.distance_weight, self.gain_weight = actions, -gain
        self.walks: dict[str, Walk] = {}
        self._kept: list[tuple[UInt8[np.ndarray, "h w"], planning.RobotPose]] = []
        self.choose(next(iter(maps)))

    @property
    def _rules(self) -> planning.Rules:
        return planning.complete_rules(self.sensing_range, degrees=self.field_of_view)

    def choose(self, name: str) -> None:
        """Choose a map by name, and a start on it."""
        self.terrain = self.maps[name].copy()
        self.sample_start(0)

    def blank(self) -> None:
        """Begin an empty map to draw on: grass with a road."""
        self.terrain = np.full((BLANK_SIDE, BLANK_SIDE), grid.GRASS, np.uint8)
        self.terrain[-8:-5] = grid.ROAD
        self.sample_start(0)

    def sample_start(self, seed: int) -> None:
        """Place the robot at random where a door can be reached; if there is no such place, on traversable ground."""
        starts = datasets.sample_starts([datasets.House("map", "val", self.terrain)], 1, seed=seed)
        y, x = (np.argwhere(grid.TRAVERSABLE[self.terrain]).tolist() or [[0, 0]])[0]
        self.start = planning.RobotPose(*starts[0][1:4]) if starts else planning.RobotPose(x, y, 0)
        self.walks = {}

    def place(self, x: int, y: int) -> None:
        """Place the robot on a cell, or turn it right if it is already there."""
        heading = self.start.heading + ((x, y) == self.start[:2])
        self.start = planning.RobotPose(x, y, heading % grid.HEADINGS)
        self.walks = {}

    def paint(self, begin: tuple[int, int], end: tuple[int, int], name: str, width: int) -> None:
        """Paint a line of a class from one cell to another, each given by column and row, `width` cells wide."""
        before, height, columns = (width - 1) // 2, *self.terrain.shape
        count = max(abs(begin[0] - end[0]), abs(begin[1] - end[1])) + 1
        for x, y in np.linspace(begin, end, count).round().astype(int) - before:
            self.terrain[max(y, 0) : min(y + width, height), max(x, 0) : min(x + width, columns)] = (
                grid.CLASS_NAMES.index(name)
            )
        self.walks = {}

    def fill(self, begin: tuple[int, int], end: tuple[int, int], name: str) -> None:
        """Fill the rectangle between two cells, each given by column and row, with a class."""
        (left, right), (top, bottom) = (sorted(edges) for edges in zip(begin, end, strict=True))
        self.terrain[top : bottom + 1, left : right + 1] = grid.CLASS_NAMES.index(name)
        self.walks = {}

    def keep(self) -> None:
        """Keep the map and the start for `undo`."""
        self._kept = [*self._kept[1 - _MOST_KEPT :], (self.terrain.copy(), self.start)]

    def undo(self) -> None:
        """Go back to the map and the start that were kept last; does nothing if there are none."""
        if self._kept:
            self.terrain, self.start = self._kept.pop()
            self.walks = {}

    @property
    def link(self) -> str:
        """Map and start as letters for an address, see `follow`; empty if they would be too long."""
        numbers = np.array([*self.terrain.shape, *self.start], "<u2").tobytes()
        text = base64.urlsafe_b64encode(zlib.compress(numbers + self.terrain.tobytes(), 9)).decode().rstrip("=")
        return text if len(text) <= _LONGEST_LINK else ""

    def follow(self, link: str) -> None:
        """Take map and start from a link.

        Raises:
          InputError: it holds no map.
        """
        try:
            packed = base64.urlsafe_b64decode(link + "=" * (-len(link) % 4))
            data = zlib.decompressobj().decompress(packed, _MOST_CELLS)
            height, width, x, y, heading = np.frombuffer(data[:10], "<u2").tolist()
            terrain = np.frombuffer(data[10:], np.uint8).reshape(height, width).copy()
            if terrain.max() >= len(grid.CLASS_NAMES) or x >= width or y >= height or heading >= grid.HEADINGS:
                raise ValueError("a number is out of range")
        except (ValueError, zlib.error):
            raise InputError("the address holds no map; copy the whole of it, or draw anew") from None
        self.terrain, self.start, self.walks = terrain, planning.RobotPose(x, y, heading), {}

    def begin(self) -> None:
        """Put all planners at the start, without a decision.

        Raises:
          InputError: the start is not traversable, no planner is chosen, or a user's planner cannot be made.
        """
        x, y, _ = self.start
        if not grid.TRAVERSABLE[self.terrain[y, x]]:
            what = grid.CLASS_NAMES[self.terrain[y, x]] if self.terrain[y, x] else "unknown"
            raise InputError(f"the robot's cell ({x}, {y}) is {what!r}, not traversable; place the robot elsewhere")
        if not self.planners:
            raise InputError("no planner is chosen; choose at least one")
        terrain = self.terrain.copy()
        self.walks = {name: Walk(self._planner(name), terrain, self.start, self._rules) for name in self.planners}

    def _planner(self, name: str) -> planning.Planner:
        """A planner, with the chosen weights if it is one of the package with a learned score."""
        planner = planning.planner_with(name, self._rules, self._estimator)
        usual = _unbounded(planner)
        if name not in planning.NETWORK_PLANNERS or not isinstance(usual, planning.LearnedScore):
            return planner
        chosen = jnp.asarray([self.distance_weight, -self.gain_weight], jnp.float32)
        weighted = dataclasses.replace(usual, weights=jnp.asarray(usual.weights).at[_WEIGHTED].set(chosen))
        return dataclasses.replace(planner, planner=weighted) if isinstance(planner, planning.Bounded) else weighted

    def step(self) -> bool:
        """Step every planner. Returns whether any episode goes on."""
        for walk in self.walks.values():
            walk.step()
        return not all(walk.over for walk in self.walks.values())


def open_dropped(name: str, data: bytes) -> dict[str, UInt8[np.ndarray, "h w"]]:
    """The map in a file's bytes, by its name: an array of classes, or a picture in the colors of the dataset.

    Raises:
      InputError: it is no such file.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(name).name
        try:
            path.write_bytes(data)
        except OSError:
            raise InputError(f"{name}: cannot be the name of a file; rename it") from None
        if path.suffix.lower() not in (".npy", ".png"):
            raise InputError(f"{name}: is no map; drop a .npy or .png file")
        write_palette(path.parent)
        try:
            return open_maps(str(path))
        except InputError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None


def open_maps(location: str | None) -> dict[str, UInt8[np.ndarray, "h w"]]:
    """Maps by name: one map file, or the validation houses of a dataset. Never test houses if there are others.

    Args:
      location: a map file, a folder, or `procedural`; `None` as for `open_dataset`. An image needs its palette in
        the same folder, with the file name that datasets use.

    Raises:
      InputError: the map or the dataset cannot be read.
    """
    path = Path(location or "").expanduser()
    if path.is_file():
        palette = path.parent / PALETTE_FILE
        if path.suffix.lower() == ".png" and not palette.exists():
            raise InputError(f"{path}: a picture needs a palette; put {palette.name}, columns class,r,g,b, beside it")
        return {path.stem: datasets.draw_map(path, palette=read_palette(palette) if palette.exists() else None)}
    dataset = datasets.open_dataset(location)
    return {house.name: house.terrain for house in dataset.split("val") or dataset.houses}


def map_picture(terrain: UInt8[np.ndarray, "h w"], seen: Bool[np.ndarray, "h w"] | None = None) -> str:
    """The map as a data URL, pale where it has not been observed. `seen`: `None` if all is observed."""
    return _data_url(inspection.map_image(terrain, np.ones(terrain.shape, bool) if seen is None else seen))


def cost_picture(walk: Walk, terrain: UInt8[np.ndarray, "h w"], snapshot: Snapshot) -> str:
    """The cost-to-go of observed ground as a data URL; the map if the planner predicts none.

    The colors end at the longer side of the map, or at the highest cost if costs are not in cells.
    """
    if snapshot.cost_to_go is None:
        return map_picture(terrain, snapshot.seen)
    ground = grid.TRAVERSABLE[terrain]
    share = snapshot.cost_to_go / (max(terrain.shape) if walk.in_cells else 1.0)
    return _data_url(inspection.cost_image(share, snapshot.seen & ground, snapshot.seen & ~ground))


def _data_url(pixels: Float[np.ndarray, "h w 3"]) -> str:
    file = io.BytesIO()
    Image.fromarray((255 * pixels + 0.5).astype(np.uint8)).save(file, "png")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def start_marks(terrain: UInt8[np.ndarray, "h w"], start: planning.RobotPose) -> str:
    """SVG of the doors and of the robot at the start."""
    size = max(terrain.shape) / _USUAL_SIDE
    return _doors(terrain, start, size) + _mark(_TRIANGLE, start, 1.2 * size, inspection.ROBOT_COLOR, start.heading)


def walk_marks(
    walk: Walk, terrain: UInt8[np.ndarray, "h w"], steps: int, sensing_range: int, degrees: float = 90
) -> str:
    """SVG of a snapshot: field of view, candidates, path so far and planned, subgoal, doors and robot."""
    size = max(terrain.shape) / _USUAL_SIDE
    snapshot = walk.snapshots[steps]
    decision, pose = snapshot.decision, snapshot.pose
    parts = [_field_of_view(pose, sensing_range, degrees), _doors(terrain, pose, size)]
    so_far = [past.pose for past in walk.snapshots[: steps + 1]]
    parts += [_line(so_far, inspection.MARK_COLOR, 0.9 * size), _line(so_far, "black", 0.45 * size)]
    parts += [_line(decision.path, "black", 0.7 * size), _line(decision.path, inspection.SUBGOAL_COLOR, 0.45 * size)]
    ranks = np.linspace(0, 1, max(len(decision.candidates), 2))
    by_score = sorted(decision.candidates, key=lambda candidate: candidate.score)
    for candidate, color in zip(by_score, inspection.score_colors(ranks).tolist(), strict=False):
        cost = "" if candidate.cost_to_go is None else f", predicted cost-to-go {candidate.cost_to_go:.1f}"
        parts.append(
            f'<circle cx="{candidate.x + 0.5}" cy="{candidate.y + 0.5}" r="{0.32 * size:.2f}" fill="rgb{tuple(color)}" '
            f'stroke="black" stroke-width="{0.07 * size:.2f}" pointer-events="all"><title>score {candidate.score:.1f}: '
            f"{candidate.distance} actions away{cost}</title></circle>"
        )
    if decision.mode == "explore" and decision.subgoal is not None:
        parts.append(_mark(_CROSS, decision.subgoal, 0.9 * size, inspection.SUBGOAL_COLOR))
    parts.append(_mark(_TRIANGLE, pose, 1.2 * size, inspection.ROBOT_COLOR, pose.heading))
    return "".join(parts)


def _doors(terrain: UInt8[np.ndarray, "h w"], robot: planning.RobotPose, size: float) -> str:
    places, _ = inspection.goal_marks(terrain, robot[:2])
    return "".join(_mark(_STAR, place, 1.3 * size, inspection.MARK_COLOR) for place in places)


def _mark(outline: str, cell: Sequence[int], size: float, color: str, turns: int = 0) -> str:
    """A polygon around the center of a cell, after quarter turns to the right."""
    return (
        f'<polygon points="{outline}" fill="{color}" stroke="black" stroke-width="0.2" stroke-linejoin="round" '
        f'transform="translate({cell[0] + 0.5} {cell[1] + 0.5}) rotate({90 * turns}) scale({size:.2f})"/>'
    )


def _line(poses: Sequence[planning.RobotPose], color: str, width: float) -> str:
    points = " ".join(f"{pose.x + 0.5},{pose.y + 0.5}" for pose in poses)
    return (
        f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="{width:.2f}" stroke-linejoin="round" '
        'stroke-linecap="round"/>'
    )


def _field_of_view(pose: planning.RobotPose, sensing_range: int, degrees: float) -> str:
    reach, half = sensing_range + 0.5, np.radians(degrees / 2)
    ahead, aside = reach * np.cos(half), reach * np.sin(half)
    outline = f"M0 0L{ahead:.2f} {-aside:.2f}A{reach} {reach} 0 {degrees > 180:d} 1 {ahead:.2f} {aside:.2f}Z"
    if degrees == 360:  # one SVG arc cannot end where it starts
        outline = f"M{-reach} 0" + "".join(f"A{reach} {reach} 0 0 1 {end} 0" for end in (reach, -reach)) + "Z"
    return (
        f'<path d="{outline}" transform="translate({pose.x + 0.5} {pose.y + 0.5}) rotate({90 * pose.heading})" '
        'fill="white" fill-opacity="0.25" stroke="#e69f00" stroke-width="0.25"/>'
    )
