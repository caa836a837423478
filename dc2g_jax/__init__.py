"""Planning toward a goal nobody has mapped: Deep Cost-to-Go (DC2G) training and batch evaluation in JAX.

```
import dc2g_jax as dc2g

results = dc2g.evaluate(["frontier", "dc2g"], "procedural", split="val")
print(results)
```

The names below are imported when they are first used, so that `import dc2g_jax` costs nothing.
"""

import importlib.metadata

import lazy_loader

__version__ = importlib.metadata.version(__name__)

__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __dir__() -> list[str]:
    return sorted(__all__)
