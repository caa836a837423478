"""Sizes of furniture, as in ProcTHOR's training houses."""

from typing import NamedTuple

import numpy as np

from dc2g_jax.objectnav.floor_plans.placing import Size

Limits = tuple[float, float]


class Sizes(NamedTuple):
    """Ranges of the size of a kind of furniture, meters.

    Attributes:
      width: range of the extent along its back.
      depth: range of the extent from back to front.
      top: range of the height.
      is_square: whether width and depth are equal.
    """

    width: Limits
    depth: Limits
    top: Limits
    is_square: bool = False

    def draw(self, rng: np.random.Generator) -> Size:
        """Draw a size."""
        width, depth, top = (float(rng.uniform(*limits)) for limits in (self.width, self.depth, self.top))
        return Size(width, width if self.is_square else depth, top)


SINGLE_BED = Sizes((0.8, 1.3), (1.9, 2.2), (0.6, 0.95))
DOUBLE_BED = Sizes((1.35, 2.05), (2.05, 2.45), (0.8, 1.3))
NIGHTSTAND = Sizes((0.38, 0.65), (0.28, 0.5), (0.46, 0.7))
DRESSER = Sizes((0.65, 2.3), (0.3, 0.75), (0.7, 1.15))
SIDE_TABLE = Sizes((0.4, 1.0), (0.3, 0.6), (0.5, 0.85))
DESK = Sizes((1.2, 1.7), (0.5, 0.85), (0.75, 1.5))
TABLE = Sizes((1.0, 1.8), (0.75, 1.0), (0.7, 0.85))
COFFEE_TABLE = Sizes((0.9, 1.5), (0.5, 0.9), (0.32, 0.45))
CHAIR = Sizes((0.42, 0.6), (0.46, 0.62), (0.78, 1.05))
ARMCHAIR = Sizes((0.7, 1.1), (0.65, 0.95), (0.65, 1.05))
COUCH = Sizes((1.7, 2.7), (0.82, 1.2), (0.75, 1.15))
TELEVISION = Sizes((1.05, 1.35), (0.09, 0.18), (1.7, 2.1))
TELEVISION_ON_STAND = Sizes((0.85, 1.2), (0.15, 0.35), (0.6, 0.8))
TELEVISION_STAND = Sizes((0.95, 1.4), (0.45, 0.85), (0.6, 0.8))
SHELF = Sizes((0.65, 1.05), (0.25, 0.48), (1.2, 2.2))
FLOOR_LAMP = Sizes((0.41, 0.55), (0.41, 0.55), (1.8, 2.1), is_square=True)
DESK_LAMP = Sizes((0.2, 0.4), (0.2, 0.35), (0.35, 0.7), is_square=True)
FLOOR_PLANT = Sizes((0.3, 0.55), (0.3, 0.55), (0.6, 1.1), is_square=True)
POTTED_PLANT = Sizes((0.2, 0.4), (0.2, 0.4), (0.35, 0.7), is_square=True)
TOILET = Sizes((0.5, 0.56), (0.84, 0.97), (0.92, 1.05))
SINK = Sizes((0.66, 0.8), (0.55, 0.73), (0.95, 1.05))
KITCHEN_SINK = Sizes((0.6, 0.85), (0.45, 0.6), (0.04, 0.1))
BATHTUB = Sizes((1.5, 1.8), (0.7, 0.85), (0.5, 0.62))
FRIDGE = Sizes((0.85, 1.15), (0.7, 0.82), (1.5, 2.1))
COUNTER = Sizes((1.2, 3.0), (0.6, 0.65), (0.92, 0.95))
DEEP_COUNTER = Sizes((1.2, 3.05), (0.9, 2.6), (0.92, 0.95))
WASTE_BIN = Sizes((0.36, 0.52), (0.3, 0.5), (0.45, 0.66))
SMALL_BIN = Sizes((0.14, 0.18), (0.14, 0.18), (0.5, 0.56), is_square=True)
BOX = Sizes((0.32, 0.65), (0.32, 0.5), (0.2, 0.4))
BALL = Sizes((0.24, 0.26), (0.24, 0.26), (0.24, 0.26), is_square=True)
PET_BED = Sizes((0.73, 1.1), (0.73, 1.0), (0.12, 0.3))
HAMPER = Sizes((0.45, 0.65), (0.36, 0.5), (0.6, 0.87))
