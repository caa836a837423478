"""Maps from OpenStreetMap extracts: reading them, drawing their classes, and adding doors, driveways and walks."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

#: Its commands, see `dc2g_jax._src.runtime.plugins`.
COMMANDS = {"map osm": ("dc2g_jax.osm.import_osm", "make maps of the buildings of an OpenStreetMap extract")}
