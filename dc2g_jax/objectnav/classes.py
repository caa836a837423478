"""What stands in a house: the classes of the indoor map, how they look, and what a data set calls them.

The paper has 16 semantic classes, "a superset of our target classes" (section II-A), and names the goals alone. The
others here are chosen to tell rooms apart. Floor and walls are none of them: that something stands in the way, and what
has been seen, are channels of their own.

An armchair is no goal "chair" and has a class of its own, so that whatever the map calls a chair is one. Bathtubs
are other objects: ProcTHOR's table of objects has none, so a class of their own would teach a cue that is never found
there.
"""

import numpy as np

#: Class -> RGB color, in the order of the indices. Goals have colors of Okabe and Ito, which color-blind people tell
#: apart; all else is paler or darker than they are.
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

#: Class index -> name. Index 0 stands for floor, wall and whatever has no class.
CLASS_NAMES: tuple[str, ...] = tuple(_PALETTE)

#: Class index -> RGB color, uint8 [class 3].
CLASS_COLORS = np.array(list(_PALETTE.values()), np.uint8)

#: Semantic classes, those of the map's channels: class index `1 + channel`.
SEMANTIC_CLASSES = len(CLASS_NAMES) - 1

NOTHING = 0
(
    BED, CHAIR, SINK, PLANT, COUCH, ARMCHAIR, TABLE, DESK, CABINET, SHELF, TELEVISION, TOILET, REFRIGERATOR, COUNTER,
    LAMP, OTHER,
) = range(1, len(CLASS_NAMES))  # fmt: skip

#: What a robot may be sent to, by class index, in the paper's order (section III-C).
GOALS: tuple[int, ...] = (BED, CHAIR, SINK, PLANT, COUCH)

#: Room type -> name, as ProcTHOR has them. Index 0 is outside.
ROOM_NAMES: tuple[str, ...] = ("outside", "Bedroom", "Bathroom", "Kitchen", "LivingRoom")
BEDROOM, BATHROOM, KITCHEN, LIVING_ROOM = range(1, len(ROOM_NAMES))

#: ProcTHOR object type -> class. Small things that stand on furniture are part of it, whatever else stands on the floor
#: is an other object.
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
