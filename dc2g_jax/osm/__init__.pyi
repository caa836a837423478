"""The public names and the modules that define them; `__init__.py` imports each when it is first used."""

from .neighborhood import extract_dataset as extract_dataset

COMMANDS: dict[str, tuple[str, str]]
