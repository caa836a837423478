"""A disk that fails at its n-th operation, and a process that dies there.

Only what Python writes passes through here: files that are opened with `open`, and the functions of `os`. Within
`faulty`, `open` is the one of `_pyio`, which calls `os` for everything. Libraries in C++ and Rust (TensorStore below
Orbax, the recordings of rerun) write on their own.
"""

import _pyio
import builtins
import contextlib
import errno
import io
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import pytest

#: `dies`: the process ends at the operation. `fails`: the operation fails with EIO, and again if it is tried again.
#: `full`: from the operation on, there is no room for anything. Where the operation writes, half of its bytes are
#: written first, as systems do: the writer is told how many, and the error comes when it writes the others.
Fault = Literal["dies", "fails", "full"]
FAULTS: tuple[Fault, ...] = ("dies", "fails", "full")

#: Operations that need room on the disk.
_GROWS = ("open", "write", "mkdir")


class Death(BaseException):
    """The process has died. No handler of exceptions may catch it, and nothing more reaches the disk."""


class Disk:
    """What is written below a folder, and the fault in it.

    Args:
      folder: the folder.
      fault: what happens at the operation.
      at: number of the operation, from 0; -1 for none.

    Attributes:
      operations: what was done, in order.
    """

    def __init__(self, folder: Path, fault: Fault, at: int):
        self.operations: list[str] = []
        self._folder, self._fault, self._at = os.path.realpath(folder), fault, at
        self._lock = threading.Lock()

    def __call__(self, name: str, path: str) -> bool:
        """Note an operation, and raise if it does not happen. Returns whether only half of it may happen."""
        if os.path.commonpath([path, self._folder]) != self._folder:
            return False
        operation = f"{name} {os.path.relpath(path, self._folder)}"
        with self._lock:
            number = len(self.operations)
            self.operations.append(operation)
        if number < self._at or self._at < 0:
            return False
        if number == self._at and name == "write":
            return True
        if self._fault == "dies":
            raise Death(self.operations[self._at])
        if self._fault == "fails" and operation == self.operations[self._at]:
            raise OSError(errno.EIO, os.strerror(errno.EIO), path)
        if self._fault == "full" and name in _GROWS:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)
        return False


def points(operations: list[str], fault: Fault) -> list[int]:
    """Numbers of the operations of an undisturbed run at which the fault may happen."""
    return [number for number, one in enumerate(operations) if fault != "full" or one.split()[0] in _GROWS]


def _where(path: Any, folder: int | None) -> str:
    """The absolute path of what a function of `os` is given: a path, or an open file."""
    if isinstance(path, int):
        return os.readlink(f"/proc/self/fd/{path}")
    return os.path.abspath(os.path.join(_where(folder, None) if folder is not None else "", os.fsdecode(path)))


@contextlib.contextmanager
def faulty(folder: Path, fault: Fault = "dies", at: int = -1) -> Iterator[Disk]:
    """Count what is written below a folder, with a fault at one of the operations; see `Disk`."""
    disk = Disk(folder, fault, at)

    def watched(name: str, target: int = 0) -> Callable[..., Any]:
        original = getattr(os, name)

        def operation(*args: Any, **options: Any) -> Any:
            disk(name, _where(args[target], options.get("dir_fd")))
            return original(*args, **options)

        return operation

    def open_file(path: Any, flags: int, *args: Any, dir_fd: int | None = None, **options: Any) -> int:
        if flags & (os.O_CREAT | os.O_TRUNC):
            disk("open", _where(path, dir_fd))
        return original_open(path, flags, *args, dir_fd=dir_fd, **options)

    def write(file: int, data: Any) -> int:
        half = disk("write", _where(file, None))
        return original_write(file, bytes(data)[: (len(data) + 1) // 2] if half else data)

    def sendfile(*args: Any) -> int:
        raise OSError(errno.ENOTSOCK, "copied by reading and writing")

    original_open, original_write = os.open, os.write
    with pytest.MonkeyPatch.context() as patch:
        for name in ("mkdir", "unlink", "remove", "rmdir", "truncate", "ftruncate", "fsync", "link", "symlink"):
            patch.setattr(os, name, watched(name))
        for name in ("rename", "replace"):
            patch.setattr(os, name, watched(name, target=1))
        patch.setattr(os, "open", open_file)
        patch.setattr(os, "write", write)
        patch.setattr(os, "sendfile", sendfile)
        patch.setattr(builtins, "open", _pyio.open)
        patch.setattr(io, "open", _pyio.open)
        yield disk
