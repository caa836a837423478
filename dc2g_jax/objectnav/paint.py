"""Appearance of simulated houses.

Houses have no textures, so they are painted: objects in the colors of their classes with random variation, and floors
by the type of room, since kitchens and bathrooms have other floors than bedrooms. All walls look alike.
"""

import numpy as np
from jaxtyping import UInt8

from dc2g_jax.objectnav.classes import BATHROOM, BEDROOM, KITCHEN, LIVING_ROOM, OBJECT_COLORS
from dc2g_jax.objectnav.worlds import IndoorWorld

#: Colors of floors by type of room, of walls, and of the outside.
_FLOORS = {BEDROOM: (196, 170, 140), BATHROOM: (170, 196, 206), KITCHEN: (206, 200, 182), LIVING_ROOM: (158, 120, 88)}
_WALL, NO_COLOR = (226, 224, 218), (245, 245, 242)


def painted(world: IndoorWorld, rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
    """The color of each cell of a house, which is that of its highest object.

    Args:
      world: one house.
      rng: random number generator of the variation between objects.
    """
    objects = np.append(OBJECT_COLORS[np.asarray(world.objects.classes)], [_WALL], axis=0)
    objects = objects + rng.normal(0, 14, objects.shape)
    kinds = np.asarray(world.room_kinds)
    floors = np.array([_FLOORS.get(int(kind), NO_COLOR) for kind in kinds]) + rng.normal(0, 10, (len(kinds), 3))
    cells = np.where(
        np.asarray(world.obstacle)[..., None], objects[np.asarray(world.instances)], floors[np.asarray(world.rooms)]
    )
    return np.clip(np.round(cells), 0, 255).astype(np.uint8)
