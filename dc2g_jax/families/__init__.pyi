"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .plain import halls as halls, mazes as mazes, offices as offices, plain_maps as plain_maps, with_door as with_door
from .town_drawing import towns as towns
