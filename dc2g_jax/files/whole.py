"""Files that are whole at any moment: what is written anew takes the old file's place in one go."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path to write a file under that takes another's place once the block has ended; not if it raises.

    Args:
        path: the file to replace, or to make.

    Yields:
        Path of a hidden file beside it, with the same suffix, that no other writer has.
    """
    path = Path(path)
    unfinished = path.with_name(f".{path.stem}.unfinished-{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
