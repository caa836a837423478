"""The rooms of a house that a robot cannot reach."""

import numpy as np

from dc2g_jax._src.search_indoors.houses.worlds import IndoorWorld, largest_region


def rooms_cut_off(world: IndoorWorld) -> list[int]:
    """Rooms outside the largest region in which a robot can drive, by their number in `world.rooms`."""
    reached = np.unique(np.asarray(world.rooms)[largest_region(world)])
    return [room for room in range(1, len(world.room_kinds)) if room not in reached]
