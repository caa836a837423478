"""Search for objects indoors: houses, semantic maps, costs of the path to an object, and control."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
