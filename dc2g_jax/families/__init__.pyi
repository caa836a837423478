"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .drawn import plain_training_maps as plain_training_maps
from .plain import halls as halls, mazes as mazes, offices as offices, plain_maps as plain_maps, with_door as with_door
from .procedural import (
    procedural_dataset as procedural_dataset,
    procedural_training_houses as procedural_training_houses,
)
from .procedural.drawing import (
    PictureFrame as PictureFrame,
    Placement as Placement,
    Points as Points,
    Polygons as Polygons,
    Sketch as Sketch,
    rectangle as rectangle,
    resample as resample,
    ribbon as ribbon,
    stroke as stroke,
    uniform as uniform,
)
from .procedural.lots import door_outline as door_outline, tapered as tapered, walkway as walkway
from .town_drawing import towns as towns
