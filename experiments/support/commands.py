"""What several experiments take as options and write."""

import math
from typing import Annotated

import tyro

#: A planner: a name in `planning.named.PLANNERS`, or `package.module:Name`.
PlannerOption = Annotated[str, tyro.conf.arg(metavar="NAME")]

#: A house by its name.
HouseOption = Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")]


def number_or_null(value: float) -> float | None:
    """The number, or `None` for NaN and infinities, which JSON does not have."""
    return value if math.isfinite(value) else None
