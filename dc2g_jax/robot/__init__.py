"""Robots that drive with a camera: from depth images to a semantic map, and from a plan to wheel commands."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

#: Its commands, see `dc2g_jax._src.runtime.plugins`.
COMMANDS = {"map recording": ("dc2g_jax.robot.map_recording", "map a recorded sequence of depth images")}
