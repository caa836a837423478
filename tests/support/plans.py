"""A house of two rooms as a plan, and furniture for it."""

import numpy as np

from dc2g_jax._src.search_indoors.houses.plans import Furniture, HousePlan, Room, Segment
from dc2g_jax._src.search_indoors.maps.classes import BED, PLANT

PLANT_BOX = Furniture(PLANT, 5.5, 0.5, 0.4, 0.4, 0.0, 0.8)
BED_BOX = Furniture(BED, 1.0, 2.0, 1.0, 1.6, 0.0, 0.6)


def plan(*furniture: Furniture, door: float = 1.0, width: float = 6.0) -> HousePlan:
    """Two rooms, 3 m deep, the second one 3 m wide; the door between them is in the middle."""
    corners = [(0.0, 0.0), (width, 0.0), (width, 3.0), (0.0, 3.0)]
    wall = width - 3.0
    return HousePlan(
        rooms=(
            Room(1, np.array([(0.0, 0.0), (wall, 0.0), (wall, 3.0), (0.0, 3.0)])),
            Room(3, np.array([(wall, 0.0), (width, 0.0), (width, 3.0), (wall, 3.0)])),
        ),
        walls=(
            *(Segment(one, other) for one, other in zip(corners, [*corners[1:], corners[0]], strict=True)),
            Segment((wall, 0.0), (wall, 3.0)),
        ),
        doors=(Segment((wall, 1.5 - door / 2), (wall, 1.5 + door / 2)),) if door else (),
        furniture=furniture,
    )
