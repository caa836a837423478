"""What every command shares: options from the command line, progress bars, and errors as one line."""

import sys
from collections.abc import Callable
from typing import TypeVar

import tyro
from tqdm import tqdm

from dc2g_jax.errors import InputError

_Options = TypeVar("_Options")


def command_line(options: type[_Options], main: Callable[[_Options], None], arguments: list[str] | None = None) -> None:
    """Run a command: parse its options, and turn bad input and Ctrl-C into one line and an exit status."""
    parsed = tyro.cli(options, args=arguments)
    try:
        main(parsed)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


class EpisodeProgress:
    """A progress bar a planner, fed by `dc2g_jax.evaluation.Runner`."""

    def __init__(self) -> None:
        self._bar: tqdm | None = None

    def __call__(self, planner: str, finished: int, episodes: int) -> None:
        """Show that a planner has finished so many of its episodes."""
        if self._bar is None:
            self._bar = tqdm(total=episodes, desc=f"{planner:>16}", unit="episode", file=sys.stderr)
        self._bar.update(finished - self._bar.n)
        if finished >= episodes:
            self._bar.close()
            self._bar = None
