"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .network import export_onnx as export_onnx

COMMANDS: dict[str, tuple[str, str]]
