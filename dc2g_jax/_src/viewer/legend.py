"""Colors of the viewer, and their legends."""

from typing import NamedTuple

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float, UInt8

from dc2g_jax._src.figures.costs import map_colors
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_RGB

#: Layers over the observed map: name and color, RGBA. The legend names them.
REACHABLE_LAYER = ("reachable", (0, 190, 230, 60))
FIELD_OF_VIEW_LAYER = ("field of view", (255, 255, 255, 110))
FRONTIER_LAYER = ("frontier", (255, 205, 0, 255))

EXPANDING_COLOR = (225, 90, 0)
SUBGOAL_COLOR = (235, 0, 235)
TRAJECTORY_COLOR = (15, 15, 15)
ROBOT_COLOR = (235, 30, 30)
GOAL_COLOR = (235, 30, 30)
FRAME_COLOR = (120, 120, 128)

#: Colors of curves, used in turn.
CURVE_COLORS = ((255, 150, 0), (0, 200, 255), (120, 220, 90), (220, 120, 255), (255, 235, 59), (255, 90, 90))

#: Class index -> its color in words.
_COLOR_WORDS = (
    "mauve", "orange-red", "green", "gray", "light blue", "crimson", "sand", "navy", "cream", "violet", "dark green",
    "ochre", "yellow-green", "brown", "black", "white",
)  # fmt: skip

#: Costs are drawn as classes, so that the viewer names the value under the pointer: not shown, no path, no prediction,
#: then costs.
NOT_SHOWN, NO_WAY, NO_PREDICTION, FIRST_COST, LAST_COST = 0, 1, 2, 3, 255
_NOT_SHOWN_COLOR, _NO_WAY_COLOR, _NO_PREDICTION_COLOR = (32, 33, 38), (82, 83, 90), (150, 128, 128)

#: Used part of the color map of costs: its dark end would hide marks drawn over it.
_BRIGHT = 0.88

#: Differences are drawn as classes too: class `NO_DIFFERENCE` is 0, and the others reach from `-FARTHEST_OFF` to
#: `FARTHEST_OFF` cells.
NO_DIFFERENCE, FARTHEST_OFF = 128, 40

_EPISODE_LEGEND = """\
**Maps**

- mauve: not yet observed
- white veil: field of view
- blue veil: reachable
- yellow: frontier, at the edge of the unknown
- orange dots: frontier-expanding cells
- magenta: plan and its subgoal
- black line: the path so far
- red arrow: robot

**Costs-to-go**

- yellow at the goal to blue, {farthest} cells away
- gray: no path; dark: not observed
- brownish gray: no prediction, as on a map without classes
- dots: candidates, white for the lowest score, which wins, over red to black
- red dots: goal

**Terrain**

{classes}

Point at a cell or a dot for its class, cost or score.
"""


def terrain_context() -> rr.AnnotationContext:
    """Names and colors of the terrain classes."""
    names = ("not observed", *CLASS_NAMES[1:])
    return rr.AnnotationContext(list(zip(range(len(names)), names, map(tuple, FIGURE_RGB.tolist()), strict=True)))


def layer_context(name: str, color: tuple[int, ...]) -> rr.AnnotationContext:
    """Class 1 in a translucent color; class 0 is not drawn."""
    return rr.AnnotationContext([(0, "", (0, 0, 0, 0)), (1, name, color)])


class CostScale(NamedTuple):
    """Mapping from costs-to-go to classes of an image.

    Attributes:
      farthest: largest exact cost to show, at the end of the colors.
      step: cost per class.
      words: format of the label of a cost.
    """

    farthest: float
    step: float
    words: str = "{:g} cells to go"

    @classmethod
    def of(cls, exact: Float[np.ndarray, "*n h w"]) -> "CostScale":
        """The scale of exact costs, with a quarter of the classes reserved for larger estimates."""
        farthest = float(np.max(exact, where=np.isfinite(exact), initial=1.0))
        return cls(farthest, int(np.ceil(farthest / (0.75 * (LAST_COST - FIRST_COST)))))

    def classes(
        self, cost: Float[np.ndarray, "*n h w"], shown: Bool[np.ndarray, "*n h w"]
    ) -> UInt8[np.ndarray, "*n h w"]:
        """Class indices of images of costs."""
        level = np.clip(cost / self.step, 0, LAST_COST - FIRST_COST)
        level = np.where(np.isfinite(cost), np.rint(level) + FIRST_COST, NO_WAY)
        return np.where(shown, level, NOT_SHOWN).astype(np.uint8)

    def context(self) -> rr.AnnotationContext:
        """Names and colors of the classes."""
        names = ["not observed", "no path", "no prediction", *map(self.words.format, self._costs().tolist())]
        colors = map(tuple, self.colors().tolist())
        return rr.AnnotationContext(list(zip(range(len(names)), names, colors, strict=True)))

    def colors(self) -> UInt8[np.ndarray, "classes 3"]:
        """The RGB color of each class."""
        known = map_colors("viridis_r", _BRIGHT * np.minimum(self._costs() / self.farthest, 1))
        return np.array([_NOT_SHOWN_COLOR, _NO_WAY_COLOR, _NO_PREDICTION_COLOR, *known], np.uint8)

    def _costs(self) -> Float[np.ndarray, "costs"]:
        """The costs of the classes from `FIRST_COST` on."""
        return self.step * np.arange(LAST_COST - FIRST_COST + 1.0)


#: Scale of costs relative to the highest one, 0 to 1.
RELATIVE = CostScale(1.0, 1 / (LAST_COST - FIRST_COST), "{:.0%} of the highest cost")


def difference_classes(
    difference: Float[np.ndarray, "*n h w"], shown: Bool[np.ndarray, "*n h w"]
) -> UInt8[np.ndarray, "*n h w"]:
    """Class indices of images of differences between costs in cells."""
    off = np.clip(np.rint(np.where(shown, difference, 0)), -FARTHEST_OFF, FARTHEST_OFF)
    return np.where(shown, NO_DIFFERENCE + off, NOT_SHOWN).astype(np.uint8)


def difference_context() -> rr.AnnotationContext:
    """Names and colors of the classes of differences: blue where the estimate is too low, red where too high."""
    off = np.arange(-FARTHEST_OFF, FARTHEST_OFF + 1)
    colors = map_colors("RdBu_r", (off + FARTHEST_OFF) / (2 * FARTHEST_OFF))
    known = [
        (NO_DIFFERENCE + cells, f"{cells:+d} cells", tuple(color))
        for cells, color in zip(off.tolist(), colors.tolist(), strict=True)
    ]
    return rr.AnnotationContext([(NOT_SHOWN, "not observed", _NOT_SHOWN_COLOR), *known])


def episode_legend(terrain: UInt8[np.ndarray, "h w"], scale: CostScale) -> str:
    """The text of the legend, with the classes that occur in a house."""
    present = [index for index in np.unique(terrain).tolist() if index]
    classes = ", ".join(f"{_COLOR_WORDS[index]}: {CLASS_NAMES[index].replace('_', ' ')}" for index in present)
    return _EPISODE_LEGEND.format(farthest=round(scale.farthest), classes=classes)
