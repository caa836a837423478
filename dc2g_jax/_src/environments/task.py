"""Checked options of an environment: houses, sensing range, step limit, and starts by house name."""

import os
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from dc2g_jax._src.environments.functional import SENSING_RANGE, FrontDoor, Params, front_door, whole_number
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.grid.ground import connected_to_goal
from dc2g_jax._src.grid.poses import HEADINGS, Pose, make_pose
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR
from dc2g_jax._src.readers.houses import House, HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import usable_houses, why_no_episode
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT

_START = ("house", "x", "y", "heading")


class FrontDoorTask:
    """The houses of a split in which episodes can be run, and the environment in them.

    Args:
      dataset: folder of houses, the word `procedural`, or an open dataset, which environments can share; `None` for the
        published houses, see `readers.houses.open_dataset`.
      split: `train`, `val` or `test`. Houses in which no episode can be run are left out.
      sensing_range: range of the 90-degree field of view, in cells.
      step_limit: actions after which an episode is truncated.
      cells: side length of the square maps, if `dataset` is not open yet.

    Attributes:
      environment: the functional environment, without default parameters, so that equal sensing shares programs.
      params: its parameters.
      names: names of the houses, by their index in the stack of worlds: object [houses].

    Raises:
      InputError: an option or the dataset is invalid.
    """

    def __init__(
        self,
        dataset: str | os.PathLike[str] | HouseDataset | None = None,
        split: str = "train",
        sensing_range: int = SENSING_RANGE,
        step_limit: int = STEP_LIMIT,
        cells: int = 50,
    ):
        if not isinstance(dataset, HouseDataset):
            dataset = open_dataset(dataset, cells=whole_number("cells", cells, 2))
        self._dataset, self._split = dataset, split
        houses = usable_houses(dataset, split, instead="raise cells or use another split")
        environment, self.params = front_door(houses, sensing_range=sensing_range, step_limit=step_limit)
        self.environment = FrontDoor(environment.sensing)
        self.names = np.array([house.name for house in houses], object)

    def starts(self, options: Mapping[str, Any], robots: int) -> tuple[Int[Array, "robots"], Pose]:
        """The starts given by reset options.

        Args:
          options: `house`, `x`, `y` and `heading`, each one value for all robots or one per robot.
          robots: number of robots.

        Returns:
          Index of the house, and pose, of each robot.

        Raises:
          InputError: an option is unknown, missing or of the wrong length, or no episode can start there.
        """
        for name in options:
            if name not in _START:
                raise InputError(f"reset option {name!r} is unknown; a start has {', '.join(_START)}")
        columns = []
        for name in _START:
            if name not in options:
                raise InputError(f"reset options have no {name!r}; a start has {', '.join(_START)}")
            values = [options[name]] * robots if np.ndim(options[name]) == 0 else list(options[name])
            if len(values) != robots:
                raise InputError(
                    f"reset option {name!r} has {len(values)} values; give one, or one for each of {robots}"
                )
            columns.append(values)
        table = np.array([self._start(*row) for row in zip(*columns, strict=True)], np.int32)
        house, x, y, heading = jnp.asarray(table).T
        return house, make_pose(x, y, heading)

    def _start(self, name: object, x: object, y: object, heading: object) -> tuple[int, int, int, int]:
        """One checked start, with the index of the house."""
        house = self._dataset.house(str(name))
        if house.split != self._split:
            raise InputError(
                f"house {name} is in split {house.split!r}; make the environment with split={house.split!r}"
            )
        if reason := why_no_episode(house):
            raise InputError(f"house {name}: no episode can be run in it: {reason}; name another")
        height, width = house.terrain.shape
        column, row = whole_number("x", x, 0, width - 1), whole_number("y", y, 0, height - 1)
        _check_ground(house, column, row)
        index = int(np.flatnonzero(self.names == house.name)[0])
        return index, column, row, whole_number("heading", heading, 0, HEADINGS - 1)


def _check_ground(house: House, x: int, y: int) -> None:
    """Reject a cell that is a goal already or from which no goal can be reached."""
    terrain = house.terrain[y, x]
    if terrain == FRONT_DOOR:
        raise InputError(f"({x}, {y}) in {house.name} is a front door already; start elsewhere")
    if not connected_to_goal(house.terrain)[y, x]:
        raise InputError(
            f"no front door of {house.name} can be reached from ({x}, {y}), which is {CLASS_NAMES[terrain]}; "
            "start on a traversable cell that is connected to one"
        )


def make_env(
    name: str = FrontDoor.name,
    *,
    dataset: str | os.PathLike[str] | HouseDataset | None = None,
    split: str = "train",
    sensing_range: int = SENSING_RANGE,
    step_limit: int = STEP_LIMIT,
    cells: int = 50,
) -> tuple[FrontDoor, Params]:
    """Make a functional environment and its parameters, as `gymnax.make` does.

    ```
    env, params = dc2g_jax.make_env("FrontDoor-v0", dataset="procedural")
    observation, state = env.reset(key, params)
    observation, state, reward, terminated, truncated, info = env.step(key, state, action, params)
    ```

    Args:
      name: `FrontDoor-v0`.
      dataset: folder of houses, the word `procedural`, or an open dataset; `None` for the published houses, see
        `readers.houses.open_dataset`.
      split: `train`, `val` or `test`. Houses in which no episode can be run are left out.
      sensing_range: range of the 90-degree field of view, in cells.
      step_limit: actions after which an episode is truncated.
      cells: side length of the square maps, if `dataset` is not open yet.

    Raises:
      InputError: an option or the dataset is invalid.
    """
    if name != FrontDoor.name:
        raise InputError(f"no environment is called {name!r}; known: {FrontDoor.name}")
    task = FrontDoorTask(dataset, split, sensing_range, step_limit, cells)
    return FrontDoor(task.environment.sensing, task.params), task.params
