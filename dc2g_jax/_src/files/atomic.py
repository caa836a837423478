"""Atomic writing of files: a new file replaces the old one in a single step."""

import contextlib
import json
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

#: Marks the name of a temporary file.
_MARK = ".unfinished-"


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Write a file atomically: a temporary file replaces `path` at the end of the block, unless the block raises.

    The temporary file, which is given, is hidden, in the same folder, with the same suffix and a unique name.
    """
    path = Path(path)
    unfinished = path.with_name(f".{path.stem}{_MARK}{secrets.token_hex(8)}{path.suffix}")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_json(path: str | Path, facts: Any) -> None:
    """Write facts as a human-readable JSON file, atomically."""
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(facts, indent=2) + "\n")


def is_unfinished(path: Path) -> bool:
    """Whether a file is a temporary one of `replacing`."""
    return path.name.startswith(".") and _MARK in path.name


def clear_unfinished(folder: Path) -> None:
    """Delete temporary files of killed writers in a folder and its subfolders. No other writer may be active there."""
    for left in folder.rglob(f".*{_MARK}*"):
        with contextlib.suppress(OSError):  # files that cannot be deleted do no harm
            left.unlink()
