"""Houses of two rooms, 3 m deep, side by side: plans, furniture for them, one as cells of 10 cm, and an agent."""

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.houses.plans import Furniture, HousePlan, Room, Segment, world_from_plan
from dc2g_jax.indoor.houses.worlds import IndoorWorld, painted, scene
from dc2g_jax.indoor.maps.camera import CameraView, view
from dc2g_jax.indoor.maps.classes import BED, PLANT
from dc2g_jax.indoor.maps.mapping import IndoorMapSettings
from dc2g_jax.indoor.search.agent import LIMITS, Agent, with_mpc
from dc2g_jax.indoor.search.guides import nearest_frontier, until_seen
from dc2g_jax.robot.driving.mppi import MPPISettings
from dc2g_jax.robot.mapping.camera import intrinsics, level_camera
from experiments.objectnav.collecting import largest_region

#: An agent with a small camera that samples few controls.
AGENT = Agent(
    guide=until_seen(nearest_frontier),
    steering=with_mpc,
    camera=intrinsics(90.0, 30, 40),
    mapping=IndoorMapSettings(cells=120, local=60),
    controller=MPPISettings(limits=LIMITS, samples=8, horizon=20),
)


#: Furniture for `plan`.
PLANT_BOX = Furniture(PLANT, 5.5, 0.5, 0.4, 0.4, 0.0, 0.8)
BED_BOX = Furniture(BED, 1.0, 2.0, 1.0, 1.6, 0.0, 0.6)


def plan(*furniture: Furniture, door: float = 1.0, width: float = 6.0, wall: float | None = None) -> HousePlan:
    """Two rooms with a door in the middle of the wall between them, 3 m from the right end if not told otherwise."""
    corners = [(0.0, 0.0), (width, 0.0), (width, 3.0), (0.0, 3.0)]
    wall = width - 3.0 if wall is None else wall
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


def two_rooms() -> IndoorHouse:
    """A bed and a plant. In the world, rooms begin at x = 0.25 and y = -0.25; the wall between them is at x = 3.25."""
    bed, plant = Furniture(BED, 0.6, 2.0, 1.0, 1.6, 0.0, 0.6), Furniture(PLANT, 4.6, 0.4, 0.4, 0.4, 0.0, 0.8)
    return IndoorHouse("two_rooms", world_from_plan(plan(bed, plant, width=5.0, wall=3.0), 0.1))


def rooms_cut_off(world: IndoorWorld) -> list[int]:
    """Rooms outside the largest region in which a robot can drive, by their number in `world.rooms`."""
    reached = np.unique(np.asarray(world.rooms)[largest_region(world)])
    return [room for room in range(1, len(world.room_kinds)) if room not in reached]


def views_of_a_bed() -> CameraView:
    """From the middle of a room: toward the bed, and away from it. Pictures of one house."""
    world = world_from_plan(plan(BED_BOX), 0.1)
    house, paint = scene(world), jnp.asarray(painted(world, np.random.default_rng(0)))
    headings = jnp.asarray([np.pi / 2, -np.pi / 2], jnp.float32)
    # The plan's corner is the margin of a quarter of a meter away from the world's.
    return jax.jit(
        lambda headings: jax.lax.map(lambda yaw: view(house, paint, level_camera(1.25, -2.75, 0.9, yaw, 0.3)), headings)
    )(headings)
