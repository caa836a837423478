"""The exception for invalid input (or a missing extra), values in its messages, and closed output pipes."""

import contextlib
import difflib
import importlib.util
import math
import numbers
import os
import re
import reprlib
import sys
from collections.abc import Iterable, Iterator
from typing import Any

#: Longest message of an `InputError`, in characters. Of longer ones the middle is left out.
LONGEST_MESSAGE = 400

#: Most names that a message lists; of more, only those most like what was given.
_MOST_NAMES = 40

#: Characters that are kept of the end of a longer message, where the remedy is.
_KEPT_END = 110


class InputError(ValueError):
    """Invalid input from the user.

    The message is one line that names the file, the value found there and the remedy. Commands print it
    without a stack trace and exit with status 2.

    Args:
      message: the message. Line breaks become blanks, and it is cut to `LONGEST_MESSAGE` characters.
    """

    def __init__(self, message: str):
        super().__init__(_one_line(message))


def _one_line(text: str) -> str:
    if len(text) > LONGEST_MESSAGE:
        text = f"{text[: LONGEST_MESSAGE - _KEPT_END - 5]} ... {text[-_KEPT_END:]}"
    # Escapes are longer than the characters that they stand for.
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)


class _Short(reprlib.Repr):
    """Looks at few elements of a value, and at few levels of those that are nested."""

    def repr_int(self, value: int, level: int) -> str:
        """Python refuses to write numbers of thousands of digits."""
        return super().repr_int(value, level) if value.bit_length() < 1000 else f"a number of {value.bit_length()} bits"


_SHORT = _Short()
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxother, _SHORT.maxlong = 3, 60, 60, 40


def short(value: Any) -> str:
    """A value as in Python, for a message: at most some 60 characters, in little time for values of any size."""
    # Where a class is defined is of no use to users.
    text = re.sub(r"dc2g_jax\._src\.[\w.]*\.", "", _SHORT.repr(value))
    return text if len(text) <= 60 else f"{text[:56]} ..."


def check_number(
    name: str, value: Any, *, whole: bool = False, least: float = -math.inf, most: float = math.inf,
    above: float = -math.inf, hint: str = "",
) -> None:  # fmt: skip
    """Check a number.

    Args:
      name: what the number is, such as `--starts` or `cell_size`, and where it stands, for the message.
      value: the number.
      whole: whether it must be an integer.
      least: smallest number that is valid.
      most: largest number that is valid.
      above: the number must be larger than this.
      hint: rest of the message, such as a unit or where to look.

    Raises:
      InputError: the value is not a finite number within the bounds.
    """
    of_kind = isinstance(value, numbers.Integral if whole else numbers.Real) and not isinstance(value, bool)
    with contextlib.suppress(OverflowError):  # an integer of hundreds of digits
        if of_kind and math.isfinite(value) and max(least, above) <= value <= most and value != above:
            return
    kind = "a whole number" if whole else "a number"
    if least > -math.inf and most < math.inf:
        bounds = f" from {least:.12g} to {most:.12g}"
    else:
        limits = ((" above", above), (" of at least", least), (" of at most", most))
        bounds = " and".join(f"{words} {limit:.12g}" for words, limit in limits if math.isfinite(limit))
    raise InputError(f"{name} {short(value)}: give {kind}{bounds}{hint and ' '}{hint}")


def check_seed(seed: Any, name: str = "seed") -> None:
    """Check a random seed.

    Raises:
      InputError: it is not a whole number, negative, or has more than 32 bits.
    """
    check_number(name, seed, whole=True, least=0, most=2**32 - 1)


def check_name(kind: str, name: Any, known: Iterable[str], hint: str = "") -> None:
    """Check that a name is a known one.

    Args:
      kind: what it names, such as `split`, for the message.
      name: the name.
      known: all names that are valid.
      hint: rest of the message.

    Raises:
      InputError: it is not.
    """
    if name not in (known := [*known]):
        if len(known) > _MOST_NAMES:
            known = [*(difflib.get_close_matches(str(name), known, cutoff=0.5) or known[:3]), "..."]
        raise InputError(f"no {kind} is called {short(name)}; give one of {', '.join(known)}{hint and ' '}{hint}")


def require_extra(*modules: str, extra: str = "all") -> None:
    """Check that modules which come with an extra are installed, without importing them.

    Raises:
      InputError: one is not.
    """
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        raise InputError(f'{", ".join(missing)}: not installed; run: pip install "dc2g_jax[{extra}]"')


@contextlib.contextmanager
def reader_may_leave() -> Iterator[None]:
    """End the program silently when its output is no longer read, as after `| head`."""
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        drop_output()
        sys.exit(141)


def drop_output() -> None:
    """Discard further and unflushed output, which Python would print at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
