"""Files that are whole at any moment: what is written anew takes the old file's place in one go."""

import contextlib
import json
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

#: What marks the name of a file that is not finished.
_MARK = ".unfinished-"


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path to write a file under that takes another's place once the block has ended; not if it raises.

    Args:
        path: the file to replace, or to make.

    Yields:
        Path of a hidden file beside it, with the same suffix, that no other writer has.
    """
    path = Path(path)
    unfinished = path.with_name(f".{path.stem}{_MARK}{secrets.token_hex(8)}{path.suffix}")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_json(path: str | Path, facts: Any) -> None:
    """Write facts as a JSON file, for people to read as well."""
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(facts, indent=2) + "\n")


def clear_unfinished(folder: Path) -> None:
    """Delete what writers that were killed have left in a folder and those below it; for when nobody writes there."""
    for left in folder.rglob(f".*{_MARK}*"):
        with contextlib.suppress(OSError):  # what cannot be deleted does no harm
            left.unlink()
