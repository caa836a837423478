"""The planner, in this process or in one of its own, which may use another Python and does not delay the node.

The node, with the Python of ROS, starts this file with a Python that has `dc2g_jax`. What they send each other is
pickled, and consists of numbers, text, bytes and tuples only.
"""

import pickle
import subprocess
import sys
import threading
from typing import Any, NamedTuple


class Refused(ValueError):
    """A line that says what the planner cannot use, and what to give instead."""


class MapPose(NamedTuple):
    """A pose in the frame of the map: meters, and radians counterclockwise from the x-axis."""

    x: float
    y: float
    yaw: float


class Map(NamedTuple):
    """An occupancy grid: cells as int8, row by row from the lowest; rows and columns; meters; pose of its corner."""

    cells: bytes
    shape: tuple[int, int]
    resolution: float
    origin: tuple[float, float, float]


class Decision(NamedTuple):
    """A `dc2g_jax.MetricDecision`, with the poses of its candidates."""

    mode: str
    subgoal: MapPose | None
    path: list[MapPose]
    candidates: list[MapPose]
    why: str
    cell_size: float


class Planner:
    """A `dc2g_jax.MetricPlanner` whose arguments and results are plain. It runs in the process."""

    def __init__(self, **options: Any):
        import dc2g_jax
        from dc2g_jax.planning import MetricPose

        self._planner = dc2g_jax.MetricPlanner(**options)
        self._map, self._pose = dc2g_jax.MetricMap, MetricPose

    def plan(self, seen: tuple[Any, ...], pose: tuple[float, ...], doors: list[tuple[float, float]]) -> tuple[Any, ...]:
        """The fields of a `Decision`."""
        import numpy as np

        cells, shape, resolution, origin = seen
        grid = self._map(np.frombuffer(cells, np.int8).reshape(shape), resolution, origin)
        made = self._planner.plan(grid, pose, doors=doors)
        subgoal = None if made.subgoal is None else tuple(made.subgoal)
        candidates = [tuple(candidate.pose) for candidate in made.candidates]
        return made.mode, subgoal, [tuple(pose) for pose in made.path], candidates, made.why, made.cell_size

    def set_aside(self, pose: tuple[float, ...]) -> None:
        """Set aside what would be seen from a subgoal."""
        self._planner.set_aside(self._pose(*pose))


class AnyPlanner:
    """A `Planner`, wherever it runs."""

    def plan(self, seen: Map, pose: MapPose, doors: list[tuple[float, float]]) -> Decision:
        """Decide the next subgoal.

        Raises:
          Refused: the map, the pose or a door is invalid, or the planner's process has ended.
        """
        mode, subgoal, path, candidates, why, size = self._ask("plan", (tuple(seen), tuple(pose), doors))
        path, candidates = ([MapPose(*pose) for pose in each] for each in (path, candidates))
        return Decision(mode, subgoal and MapPose(*subgoal), path, candidates, why, size)

    def set_aside(self, pose: MapPose) -> None:
        """Set aside what would be seen from the last subgoal.

        Raises:
          Refused: the planner's process has ended.
        """
        self._ask("set_aside", (tuple(pose),))

    def _ask(self, name: str, arguments: Any) -> Any:
        """What a method of the planner returns."""
        raise NotImplementedError


class PlannerHere(AnyPlanner):
    """Runs a `Planner` in this process, whose Python has `dc2g_jax`.

    Args:
      options: those of `dc2g_jax.MetricPlanner`.

    Raises:
      Refused: `dc2g_jax` is not installed, or an option is invalid.
    """

    def __init__(self, **options: Any):
        try:
            from dc2g_jax import InputError
        except ModuleNotFoundError as error:
            if error.name != "dc2g_jax":
                raise
            raise Refused("dc2g_jax is not installed in this Python; install it with pip") from None
        self._refusal = InputError
        try:
            self._planner = Planner(**options)
        except InputError as error:
            raise Refused(str(error)) from None

    def _ask(self, name: str, arguments: Any) -> Any:
        try:
            return getattr(self._planner, name)(*arguments)
        except self._refusal as error:
            raise Refused(str(error)) from None


class PlannerProcess(AnyPlanner):
    """Runs a `Planner` in a process of its own.

    Args:
      python: the Python that has `dc2g_jax`; empty for the running one.
      options: those of `dc2g_jax.MetricPlanner`.

    Raises:
      Refused: the Python cannot be started, or an option is invalid.
    """

    def __init__(self, python: str, **options: Any):
        command, pipe = [python or sys.executable, __file__], subprocess.PIPE
        self._one_at_a_time = threading.Lock()
        try:
            # In a session of its own, since Ctrl-C ends the node, which then ends the process.
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True)
        except OSError as error:
            raise Refused(f"python {command[0]!r}: cannot be started ({error.strerror})") from None
        try:
            self._ask("make", options)
        except Refused:
            self.close()
            raise

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()

    def _ask(self, name: str, arguments: Any) -> Any:
        with self._one_at_a_time:
            try:
                pickle.dump((name, arguments), self._process.stdin)  # type: ignore[arg-type]
                self._process.stdin.flush()  # type: ignore[union-attr]
                is_done, answer = pickle.load(self._process.stdout)  # type: ignore[arg-type]
            except (OSError, ValueError, EOFError):
                raise Refused("the planner's process has ended; what it printed says why") from None
        if not is_done:
            raise Refused(answer)
        return answer


def serve() -> None:
    """Answer what is asked on standard input, until it ends."""
    import gc
    import os

    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what is printed must not come between
    import dc2g_jax

    planner: Any = None
    while True:
        try:
            name, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            if name == "make":
                planner, answer = Planner(**arguments), None
                gc.freeze()  # a full collection would delay some decision by a tenth of a second
            else:
                answer = getattr(planner, name)(*arguments)
            pickle.dump((True, answer), answers)
        except dc2g_jax.InputError as error:
            pickle.dump((False, str(error)), answers)
        answers.flush()


if __name__ == "__main__":
    serve()
