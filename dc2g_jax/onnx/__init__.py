"""Export of compact networks to ONNX, for programs in other languages. It needs the extra `onnx`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

#: Its commands, see `dc2g_jax._src.runtime.plugins`.
COMMANDS = {"export": ("dc2g_jax.onnx.command", "write a trained network as an ONNX file")}
