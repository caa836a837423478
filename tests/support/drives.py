"""Drives from camera to door in two streets, from the same few starts."""

import numpy as np

from dc2g_jax._src.grid.label_noise import scaled
from dc2g_jax._src.grid.sensing import line_of_sight
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.starts import Start
from dc2g_jax.robot.driving.vehicle import VehicleLimits
from dc2g_jax.robot.mapping.camera import intrinsics
from dc2g_jax.robot.mapping.noise import PAPER_LIKE
from dc2g_jax.robot.mapping.semantic_map import MapSettings
from experiments.driving import fleet
from experiments.driving.drive import Equipment
from experiments.support.driving import drive_all
from tests.support.streets import STREET, WALLED

RULES = complete_rules(4, line_of_sight)
HOUSES = [House("street", "val", STREET), House("walled", "val", WALLED)]
SITES = fleet.sites_of([STREET, WALLED])

EAST, WEST, MIDDLE = Start("street", 9, 2, 2), Start("street", 0, 1, 0), Start("street", 5, 1, 1)
SHUT_OUT = Start("walled", 9, 2, 2)


def made(planner, noise=0.0):
    """A robot of small images, which are rendered quickly."""
    return Equipment(
        planner=planner,
        sensing=RULES.sensing,
        camera=intrinsics(90.0, 48, 64),
        mapping=MapSettings(*STREET.shape, cell_size=1.0, reach=6.0),
        noise=scaled(PAPER_LIKE, np.float32(noise)),
        limits=VehicleLimits(),
    )


def drives(planner, *starts, noise=0.0, **options):
    """Results of driving from the starts."""
    return drive_all(made(planner, noise), HOUSES, starts, **options)
