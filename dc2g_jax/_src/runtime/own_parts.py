"""Parts of the user's own by name, `package.module:Name`: planners, estimators, datasets, losses, settings."""

import importlib
import re
from collections.abc import Iterable
from typing import Any

from dc2g_jax._src.runtime.errors import InputError, check_name

_OWN = re.compile(r"[^\W\d][\w.]*:[^\W\d]\w*")


def is_own_part(name: object) -> bool:
    """Whether a name has the form `package.module:Name`."""
    return isinstance(name, str) and _OWN.fullmatch(name) is not None


def own_part(kind: str, name: str, known: Iterable[str]) -> Any:
    """Import a part of the user's own.

    Args:
      kind: what the part is, such as `planner`, for messages.
      name: `package.module:Name`, of a module that Python finds.
      known: names of the parts of the package, for messages.

    Raises:
      InputError: the name has another form, or cannot be imported.
    """
    if not is_own_part(name):
        check_name(kind, name, known, "or one of your own, package.module:Name")
    module, _, attribute = name.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"{kind} {name!r}: cannot be imported ({error}); give package.module:Name, of a module that Python finds "
            "in the folder of the script (for a command: the current one) or among the installed ones"
        ) from None
