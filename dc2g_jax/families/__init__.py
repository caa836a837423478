"""Families of maps beyond houses, registered by name as plug-ins: towns, and maps without classes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
