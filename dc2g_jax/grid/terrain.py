"""Terrain classes of a semantic map: their names, colours and which of them a robot may drive on."""

import numpy as np

#: Class index -> name. Index 0 stands for "unknown or not observed".
CLASS_NAMES: tuple[str, ...] = (
    "__ignore__",
    "front_door",
    "grass",
    "road",
    "driveway",
    "car",
    "path",
    "house",
    "sidewalk",
    "fence",
    "tree",
    "mailbox",
    "bush",
    "garage door",
    "nothing",
    "traversable",
)

#: Bits in a class index.
CLASS_BITS = (len(CLASS_NAMES) - 1).bit_length()

#: Class index -> RGB colour, uint8 [16 3], as in the published dataset's palette.
CLASS_COLORS = np.array(
    [
        (0, 0, 0),
        (128, 0, 0),
        (0, 128, 0),
        (128, 128, 0),
        (0, 0, 128),
        (128, 0, 128),
        (0, 128, 128),
        (128, 128, 128),
        (64, 0, 0),
        (192, 0, 0),
        (64, 128, 0),
        (192, 128, 0),
        (64, 0, 128),
        (192, 0, 128),
        (64, 128, 128),
        (255, 255, 255),
    ],
    dtype=np.uint8,
)

UNKNOWN = 0
FRONT_DOOR = CLASS_NAMES.index("front_door")
GRASS = CLASS_NAMES.index("grass")
ROAD = CLASS_NAMES.index("road")
DRIVEWAY = CLASS_NAMES.index("driveway")
CAR = CLASS_NAMES.index("car")
PATH = CLASS_NAMES.index("path")
HOUSE = CLASS_NAMES.index("house")
SIDEWALK = CLASS_NAMES.index("sidewalk")

_TRAVERSABLE_NAMES = ("front_door", "road", "driveway", "path", "sidewalk", "traversable")

#: Class index -> may the robot drive there? bool [16].
TRAVERSABLE = np.array([name in _TRAVERSABLE_NAMES for name in CLASS_NAMES])

_OPAQUE_NAMES = ("car", "house", "fence", "tree", "bush", "garage door")

#: Class index -> does it hide what is behind it from a camera a metre above the ground? bool [16].
OPAQUE = np.array([name in _OPAQUE_NAMES for name in CLASS_NAMES])
