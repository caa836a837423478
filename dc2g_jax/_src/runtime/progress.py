"""Progress bars of episodes."""

import sys

from tqdm import tqdm


class EpisodeProgress:
    """One progress bar per planner in the error stream, for `rollouts.evaluation.Runner`.

    Args:
      leave: whether bars stay when they are finished.
    """

    def __init__(self, *, leave: bool = True) -> None:
        self._leave = leave
        self._bar: tqdm | None = None
        self._compiling = 0

    def __call__(self, planner: str, finished: int, episodes: int) -> None:
        """Show the number of finished episodes of a planner."""
        if self._bar is None:
            # With 0, the time moves on within a long episode too.
            self._bar = tqdm(
                total=episodes, desc=f"{planner:>16}", unit="episode", leave=self._leave, miniters=0, file=sys.stderr,
                postfix="compiling",
            )  # fmt: skip
            self._compiling = 2  # reports before each of the two programs
        elif self._compiling:
            self._compiling -= 1
            if not self._compiling:
                # Estimates leave out the time of compiling, and what the same call finished.
                self._bar.initial = self._bar.n = self._bar.last_print_n = finished
                self._bar.unpause()
                self._bar.set_postfix_str("")
        self._bar.update(finished - self._bar.n)
        if finished >= episodes:
            self._bar.close()
            self._bar = None
