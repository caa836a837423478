"""Commands: options, calls, files. Run one with `python -m experiments.NAME --help`."""

import os
import sys
from types import TracebackType

# Before anything is imported that takes seconds: an interrupt is no error, whenever it comes, and in a log file a
# progress bar is a line now and then, not ten a second.
if not sys.stderr.isatty():
    os.environ.setdefault("TQDM_MININTERVAL", "15")


def _tell_exception(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print what ended the program: one line for Ctrl-C."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _tell_exception
