"""A house of two rooms, 3 m deep, side by side, as cells of 10 cm: a bed in the one, a plant in the other; an agent."""

import numpy as np

from dc2g_jax._src.mapping.camera import intrinsics
from dc2g_jax._src.search_indoors.houses.dataset import IndoorHouse
from dc2g_jax._src.search_indoors.houses.plans import Furniture, HousePlan, Room, Segment, world_from_plan
from dc2g_jax._src.search_indoors.maps.classes import BED, PLANT
from dc2g_jax._src.search_indoors.maps.mapping import IndoorMapSettings
from dc2g_jax._src.search_indoors.search.agent import LIMITS, MPC, Agent
from dc2g_jax._src.search_indoors.search.guides import GoalReacher, NearestFrontier
from dc2g_jax._src.vehicles.mppi import MPPISettings

#: An agent with a small camera that samples few controls.
AGENT = Agent(
    guide=GoalReacher(NearestFrontier()),
    steering=MPC(),
    camera=intrinsics(90.0, 30, 40),
    mapping=IndoorMapSettings(cells=120, local=60),
    controller=MPPISettings(limits=LIMITS, samples=8, horizon=20),
)


def two_rooms() -> IndoorHouse:
    """The house. In the world, rooms begin at x = 0.25 and y = -0.25; the wall between them is at x = 3.25."""
    corners = [(0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (0.0, 3.0)]
    plan = HousePlan(
        rooms=(
            Room(1, np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)])),
            Room(3, np.array([(3.0, 0.0), (5.0, 0.0), (5.0, 3.0), (3.0, 3.0)])),
        ),
        walls=(
            *(Segment(one, other) for one, other in zip(corners, [*corners[1:], corners[0]], strict=True)),
            Segment((3.0, 0.0), (3.0, 3.0)),
        ),
        doors=(Segment((3.0, 1.0), (3.0, 2.0)),),
        furniture=(
            Furniture(BED, 0.6, 2.0, 1.0, 1.6, 0.0, 0.6),
            Furniture(PLANT, 4.6, 0.4, 0.4, 0.4, 0.0, 0.8),
        ),
    )
    return IndoorHouse("two_rooms", "val", world_from_plan(plan, 0.1))
