"""Making an environment by name."""

import os

from dc2g_jax._src.environments.functional import SENSING_RANGE, FrontDoor, Params, front_door
from dc2g_jax._src.grid.sensing import PAPER_DEGREES
from dc2g_jax._src.readers.houses import HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import usable_houses
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT
from dc2g_jax._src.runtime.errors import check_name


def make_env(
    name: str = FrontDoor.name,
    *,
    dataset: str | os.PathLike[str] | HouseDataset | None = None,
    split: str = "train",
    sensing_range: int = SENSING_RANGE,
    field_of_view: float = PAPER_DEGREES,
    step_limit: int = STEP_LIMIT,
    autoreset: bool = True,
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
      sensing_range: range of the field of view, in cells.
      field_of_view: width of the field of view in degrees, 1 to 360.
      step_limit: actions after which an episode is truncated.
      autoreset: whether `step` begins a new episode where one ends.
      cells: side length of the square maps, if `dataset` is not open yet.

    Raises:
      InputError: an option or the dataset is invalid.
    """
    check_name("environment", name, [FrontDoor.name])
    dataset = dataset if isinstance(dataset, HouseDataset) else open_dataset(dataset, cells=cells)
    houses = usable_houses(dataset, split, instead="raise cells or use another split")
    return front_door(
        houses, sensing_range=sensing_range, field_of_view=field_of_view, step_limit=step_limit, autoreset=autoreset
    )
