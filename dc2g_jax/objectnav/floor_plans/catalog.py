"""Furniture by name, with sizes as in ProcTHOR's training houses."""

from typing import NamedTuple

import numpy as np

from dc2g_jax.objectnav import classes
from dc2g_jax.objectnav.floor_plans.placing import Item

Limits = tuple[float, float]


class Model(NamedTuple):
    """A kind of furniture in the catalog: its class and the ranges of its size in meters.

    Attributes:
      kind: class index, see `dc2g_jax.objectnav.classes`.
      width: range of the extent along its back.
      depth: range of the extent from back to front.
      top: range of the height.
      is_square: whether width and depth are equal.
    """

    kind: int
    width: Limits
    depth: Limits
    top: Limits
    is_square: bool = False

    def draw(self, rng: np.random.Generator) -> Item:
        """Draw an item of this kind."""
        width, depth, top = (float(rng.uniform(*limits)) for limits in (self.width, self.depth, self.top))
        return Item(self.kind, width, width if self.is_square else depth, top)


#: Name -> model.
CATALOG: dict[str, Model] = {
    "single bed": Model(classes.BED, (0.8, 1.3), (1.9, 2.2), (0.6, 0.95)),
    "double bed": Model(classes.BED, (1.35, 2.05), (2.05, 2.45), (0.8, 1.3)),
    "nightstand": Model(classes.CABINET, (0.38, 0.65), (0.28, 0.5), (0.46, 0.7)),
    "dresser": Model(classes.CABINET, (0.65, 2.3), (0.3, 0.75), (0.7, 1.15)),
    "side table": Model(classes.CABINET, (0.4, 1.0), (0.3, 0.6), (0.5, 0.85)),
    "desk": Model(classes.DESK, (1.2, 1.7), (0.5, 0.85), (0.75, 1.5)),
    "table": Model(classes.TABLE, (1.0, 1.8), (0.75, 1.0), (0.7, 0.85)),
    "coffee table": Model(classes.TABLE, (0.9, 1.5), (0.5, 0.9), (0.32, 0.45)),
    "chair": Model(classes.CHAIR, (0.42, 0.6), (0.46, 0.62), (0.78, 1.05)),
    "armchair": Model(classes.ARMCHAIR, (0.7, 1.1), (0.65, 0.95), (0.65, 1.05)),
    "couch": Model(classes.COUCH, (1.7, 2.7), (0.82, 1.2), (0.75, 1.15)),
    "television": Model(classes.TELEVISION, (1.05, 1.35), (0.09, 0.18), (1.7, 2.1)),
    "television on stand": Model(classes.TELEVISION, (0.85, 1.2), (0.15, 0.35), (0.6, 0.8)),
    "television stand": Model(classes.CABINET, (0.95, 1.4), (0.45, 0.85), (0.6, 0.8)),
    "shelf": Model(classes.SHELF, (0.65, 1.05), (0.25, 0.48), (1.2, 2.2)),
    "floor lamp": Model(classes.LAMP, (0.41, 0.55), (0.41, 0.55), (1.8, 2.1), is_square=True),
    "desk lamp": Model(classes.LAMP, (0.2, 0.4), (0.2, 0.35), (0.35, 0.7), is_square=True),
    "floor plant": Model(classes.PLANT, (0.3, 0.55), (0.3, 0.55), (0.6, 1.1), is_square=True),
    "potted plant": Model(classes.PLANT, (0.2, 0.4), (0.2, 0.4), (0.35, 0.7), is_square=True),
    "toilet": Model(classes.TOILET, (0.5, 0.56), (0.84, 0.97), (0.92, 1.05)),
    "sink": Model(classes.SINK, (0.66, 0.8), (0.55, 0.73), (0.95, 1.05)),
    "kitchen sink": Model(classes.SINK, (0.6, 0.85), (0.45, 0.6), (0.04, 0.1)),
    "bathtub": Model(classes.OTHER, (1.5, 1.8), (0.7, 0.85), (0.5, 0.62)),
    "fridge": Model(classes.REFRIGERATOR, (0.85, 1.15), (0.7, 0.82), (1.5, 2.1)),
    "counter": Model(classes.COUNTER, (1.2, 3.0), (0.6, 0.65), (0.92, 0.95)),
    "deep counter": Model(classes.COUNTER, (1.2, 3.05), (0.9, 2.6), (0.92, 0.95)),
    "waste bin": Model(classes.OTHER, (0.36, 0.52), (0.3, 0.5), (0.45, 0.66)),
    "small bin": Model(classes.OTHER, (0.14, 0.18), (0.14, 0.18), (0.5, 0.56), is_square=True),
    "box": Model(classes.OTHER, (0.32, 0.65), (0.32, 0.5), (0.2, 0.4)),
    "ball": Model(classes.OTHER, (0.24, 0.26), (0.24, 0.26), (0.24, 0.26), is_square=True),
    "pet bed": Model(classes.OTHER, (0.73, 1.1), (0.73, 1.0), (0.12, 0.3)),
    "hamper": Model(classes.OTHER, (0.45, 0.65), (0.36, 0.5), (0.6, 0.87)),
}
