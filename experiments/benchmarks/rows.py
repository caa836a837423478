"""Lines of the report."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ..baselines.problem import BaselineUnavailable
from .programs import TooLarge
from .timing import Measured, checksum

#: Batches are left out once one call is expected to take more seconds than these.
_MOST_SECONDS = 15.0


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the report.

    Attributes:
      section: part of the report.
      what: what is measured.
      by: whose program: `dc2g_jax`, `C`, a library.
      unit: what is counted, or `s` where seconds are the result.
      batch: robots, environments or maps side by side; `None` where the program decides.
      cells: side of the map, in cells.
      sensing_range: reach of the field of view, in cells.
      cores: cores of the CPU it may use; `None` for all.
      rate: units a second, from the median repeat.
      worst_rate: units a second, from the slowest repeat.
      seconds: median seconds of a call.
      first_seconds: seconds of the first call, compilation included.
      repeats: how many repeats.
      checksum: of the output; programs that do the same have the same.
      peak_memory: bytes held at most, by the process or on the device.
      added_memory: how many of them came on top of what was held before.
      shares: part of what the machine can do, 0 to 1, by resource.
      facts: anything else.
      missing: why there is no figure.
    """

    section: str
    what: str
    by: str
    unit: str
    batch: int | None = None
    cells: int | None = None
    sensing_range: int | None = None
    cores: int | None = None
    rate: float | None = None
    worst_rate: float | None = None
    seconds: float | None = None
    first_seconds: float | None = None
    repeats: int | None = None
    checksum: int | None = None
    peak_memory: int | None = None
    added_memory: int | None = None
    shares: dict[str, float] = dataclasses.field(default_factory=dict)
    facts: dict[str, float] = dataclasses.field(default_factory=dict)
    missing: str | None = None

    def with_figures(self, measured: Measured, units: float, **more: Any) -> "Row":
        """The row with what was measured.

        Args:
          measured: timing and output of a call.
          units: how many units one call handles.
          more: further attributes.
        """
        return dataclasses.replace(
            self,
            rate=units / measured.median,
            worst_rate=units / measured.worst,
            seconds=measured.median,
            first_seconds=measured.first,
            repeats=measured.repeats,
            peak_memory=measured.peak_memory,
            added_memory=measured.added_memory,
            **{"checksum": checksum(measured.output), **more},
        )


def attempt(row: Row, measured_row: Callable[[], Row]) -> Row:
    """The row of somebody else's program, or why there are no figures: nothing of theirs ends the benchmark.

    Args:
      row: the row without figures.
      measured_row: gives it with them.
    """
    try:
        return measured_row()
    except (ImportError, BaselineUnavailable) as error:
        return dataclasses.replace(row, missing=f"not available: {error}")
    except TooLarge as error:
        return dataclasses.replace(row, missing=f"left out: {error}")
    except Exception as error:
        lines = str(error).strip().splitlines() or [""]
        return dataclasses.replace(row, missing=f"failed: {type(error).__name__}: {lines[0][:200]}")


def growing(batches: Sequence[int], row: Row, measured_row: Callable[[Row, int], Row]) -> Iterator[Row]:
    """Rows for larger and larger batches, as long as they fit and do not take too long.

    Args:
      batches: sizes, growing.
      row: the row without batch and figures.
      measured_row: `(row, batch) ->` the row with figures.
    """
    missing, previous = None, None
    for batch in batches:
        wanted = dataclasses.replace(row, batch=batch, missing=missing)
        if previous is not None and previous.seconds is not None and previous.batch is not None:
            expected = previous.seconds * batch / previous.batch
            if expected > _MOST_SECONDS:
                wanted = dataclasses.replace(wanted, missing=f"left out: a call would take about {expected:.0f} s")
        if wanted.missing is None:
            wanted = attempt(wanted, functools.partial(measured_row, wanted, batch))
            previous = wanted
        missing = wanted.missing
        yield wanted
