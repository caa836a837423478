"""Semantic classes of indoor maps: names, colors, goals, and their object types in ProcTHOR.

The paper has 16 semantic classes, "a superset of our target classes" (section II-A), but names only the goals. The
other classes here are chosen to distinguish types of rooms. Floor and walls have no class: the map has separate
channels for obstacles and for explored cells.

An armchair is not the goal "chair" and has its own class, so that everything labeled as a chair is a goal. Bathtubs are
other objects: ProcTHOR's table of objects has none, so a separate class would be a cue that never occurs there.
"""

import numpy as np

#: Class -> RGB color, in the order of the indices. Goals have the colors of Okabe and Ito, which color-blind people can
#: distinguish; other classes are paler or darker.
_PALETTE = {
    "nothing": (255, 255, 255),
    "bed": (0, 114, 178),
    "chair": (230, 159, 0),
    "sink": (86, 180, 233),
    "plant": (0, 158, 115),
    "couch": (213, 94, 0),
    "armchair": (204, 121, 167),
    "table": (214, 190, 156),
    "desk": (184, 158, 118),
    "cabinet": (140, 112, 84),
    "shelf": (92, 72, 54),
    "television": (44, 44, 52),
    "toilet": (240, 228, 66),
    "refrigerator": (190, 204, 222),
    "counter": (160, 160, 148),
    "lamp": (250, 226, 150),
    "other object": (158, 142, 176),
}

#: Class index -> name. Index 0 stands for floor, walls and everything without class.
OBJECT_CLASSES: tuple[str, ...] = tuple(_PALETTE)

#: Class index -> RGB color, uint8 [class 3].
OBJECT_COLORS = np.array(list(_PALETTE.values()), np.uint8)

#: Color of the outside.
NO_COLOR = (245, 245, 242)

#: Semantic classes, those of the map's channels: class index `1 + channel`.
SEMANTIC_CLASSES = len(OBJECT_CLASSES) - 1

NO_OBJECT = 0
(
    BED, CHAIR, SINK, PLANT, COUCH, ARMCHAIR, TABLE, DESK, CABINET, SHELF, TELEVISION, TOILET, REFRIGERATOR, COUNTER,
    LAMP, OTHER,
) = range(1, len(OBJECT_CLASSES))  # fmt: skip

#: Class indices of the goals, in the paper's order (section III-C).
GOALS: tuple[int, ...] = (BED, CHAIR, SINK, PLANT, COUCH)

#: Their names.
TARGETS = tuple(OBJECT_CLASSES[goal] for goal in GOALS)

#: Room type -> ProcTHOR's name. Index 0 is the outside.
ROOM_NAMES: tuple[str, ...] = ("outside", "Bedroom", "Bathroom", "Kitchen", "LivingRoom")
BEDROOM, BATHROOM, KITCHEN, LIVING_ROOM = range(1, len(ROOM_NAMES))

#: ProcTHOR object type -> class. Small things on furniture are part of it; everything else on the floor is an other
#: object.
PROCTHOR_CLASSES: dict[str, int] = {
    "Bed": BED,
    "Chair": CHAIR,
    "Sink": SINK,
    "HousePlant": PLANT,
    "Sofa": COUCH,
    "ArmChair": ARMCHAIR,
    "DiningTable": TABLE,
    "CoffeeTable": TABLE,
    "Desk": DESK,
    "Dresser": CABINET,
    "SideTable": CABINET,
    "TVStand": CABINET,
    "Safe": CABINET,
    "ShelvingUnit": SHELF,
    "Television": TELEVISION,
    "Toilet": TOILET,
    "Fridge": REFRIGERATOR,
    "CounterTop": COUNTER,
    "FloorLamp": LAMP,
    "DeskLamp": LAMP,
}
