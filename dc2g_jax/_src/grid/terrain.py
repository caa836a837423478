"""Terrain classes of a semantic map: names, colors, and which classes are traversable or opaque."""

import numpy as np

#: Class -> RGB color in the published dataset's palette, and color in figures, in the order of the indices. In figures,
#: ground is pale and the rest dark, so that they differ in grayscale; unknown is in between.
_COLORS = {
    "__ignore__": ((0, 0, 0), "#a79bb5"),
    "front_door": ((128, 0, 0), "#d55e00"),
    "grass": ((0, 128, 0), "#4f9d69"),
    "road": ((128, 128, 0), "#d5d8dc"),
    "driveway": ((0, 0, 128), "#9ecae9"),
    "car": ((128, 0, 128), "#b5446e"),
    "path": ((0, 128, 128), "#f0d589"),
    "house": ((128, 128, 128), "#2f3144"),
    "sidewalk": ((64, 0, 0), "#f4ece1"),
    "fence": ((192, 0, 0), "#7b5ea7"),
    "tree": ((64, 128, 0), "#1b5e3c"),
    "mailbox": ((192, 128, 0), "#b8860b"),
    "bush": ((64, 0, 128), "#a3bb55"),
    "garage door": ((192, 0, 128), "#a6611a"),
    "nothing": ((64, 128, 128), "#111111"),
    "traversable": ((255, 255, 255), "#d9ead3"),
}

#: Class index -> name. Index 0 stands for "unknown or not observed".
CLASS_NAMES: tuple[str, ...] = tuple(_COLORS)

#: Class index -> RGB color, uint8 [class 3].
CLASS_COLORS = np.array([rgb for rgb, _ in _COLORS.values()], np.uint8)

#: Class -> color in figures.
FIGURE_COLORS = {name: color for name, (_, color) in _COLORS.items()}

#: Class index -> RGB color in figures, uint8 [class 3].
FIGURE_RGB = np.array([list(bytes.fromhex(color[1:])) for color in FIGURE_COLORS.values()], np.uint8)

# Indices are bytes, and the two highest values mark unknown colors while reading images.
assert len(CLASS_NAMES) <= 254, f"{len(CLASS_NAMES)} terrain classes do not fit into a byte"

#: Bits in a class index.
CLASS_BITS = (len(CLASS_NAMES) - 1).bit_length()

#: Class index of cells beyond the edge of a map.
OUTSIDE = len(CLASS_NAMES)

#: The class indices, in the order of the classes above.
UNKNOWN, FRONT_DOOR, GRASS, ROAD, DRIVEWAY, CAR, PATH, HOUSE, SIDEWALK, FENCE, TREE = range(11)
MAILBOX, BUSH, GARAGE_DOOR, NOTHING, FREE = range(11, 16)

#: Occupied cells of a map without classes, such as an occupancy map, whose free cells are `FREE`.
OCCUPIED = HOUSE

#: Class index -> whether the robot may drive on it, bool [class].
TRAVERSABLE = np.isin(CLASS_NAMES, ["front_door", "road", "driveway", "path", "sidewalk", "traversable"])

#: Class index -> whether it hides what is behind it from a camera one meter above the ground, bool [class].
OPAQUE = np.isin(CLASS_NAMES, ["car", "house", "fence", "tree", "bush", "garage door"])
