"""Robots that drive with a camera: their equipment, and drives from many starts."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np

from dc2g_jax._src.cli.common import ImageSizeOption
from dc2g_jax._src.cli.outputs import CommandOptions
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.grid.label_noise import scaled
from dc2g_jax._src.grid.sensing import line_of_sight
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts.evaluation import episodes_from
from dc2g_jax._src.rollouts.statistics import house_bootstrap
from dc2g_jax._src.runtime.errors import check_number
from dc2g_jax.robot.driving.robot import run_all
from dc2g_jax.robot.driving.vehicle import CONTROL_PERIOD, VehicleLimits
from dc2g_jax.robot.mapping.camera import intrinsics
from dc2g_jax.robot.mapping.noise import PAPER_LIKE
from dc2g_jax.robot.mapping.scene import CELL_SIZE
from dc2g_jax.robot.mapping.semantic_map import MapSettings
from experiments.driving.drive import ARRIVED, Equipment, reset, step
from experiments.driving.fleet import sites_of

#: Sensing range that the planner assumes, in cells, and field of view of the camera.
_SENSING_RANGE, _FIELD_OF_VIEW_DEGREES = 8, 90.0

#: Names of `DRIVING`, `ARRIVED` and `NOTHING_LEFT` in tables.
StatusName = Literal["under_way", "arrived", "nothing_left"]
STATUS_NAMES: tuple[StatusName, ...] = get_args(StatusName)

#: Seconds after which an episode ends without success: one per gridworld step of the published maps' step limit.
SECONDS_LIMIT = 500.0

#: Control periods that the first call of the device drives.
_FIRST_PERIODS = 10


@dataclasses.dataclass(frozen=True)
class DrivingOptions(CommandOptions):
    """Robots that drive with a camera.

    Attributes:
      pedestrians: number of pedestrians on the sidewalks around each robot.
      image_size: width and height of the camera's images, pixels.
    """

    pedestrians: int = 0
    image_size: ImageSizeOption = (160, 120)

    def __post_init__(self) -> None:
        check_number("--pedestrians", self.pedestrians, whole=True, least=0)
        for pixels in self.image_size:
            check_number("--image-size", pixels, whole=True, least=8, hint="pixels")


def equipment(
    planner: str, estimator: Estimator | None, size: tuple[int, int], noise: float, options: DrivingOptions
) -> Equipment:
    """A robot's planner, camera and vehicle.

    Args:
      planner: name of the planner.
      estimator: estimator of the planner, if it uses one.
      size: rows and columns of the map.
      noise: noise level; 0 is no noise, 1 the presumed noise of the paper's maps.
      options: options of the command.
    """
    rules = complete_rules(_SENSING_RANGE, line_of_sight)
    width, height = options.image_size
    return Equipment(
        planner=planner_with(planner, rules, estimator),
        sensing=rules.sensing,
        camera=intrinsics(_FIELD_OF_VIEW_DEGREES, height, width),
        mapping=MapSettings(*size, cell_size=CELL_SIZE),
        noise=scaled(PAPER_LIKE, np.float32(noise)),
        limits=VehicleLimits(),
    )


class DriveResult(NamedTuple):
    """One drive.

    Attributes:
      house: name of the house.
      x: first column.
      y: first row.
      heading: first heading.
      seconds: duration.
      status: outcome, see `experiments.driving.drive`; `under way` at the time limit.
      off_ground: seconds in which the footprint touched forbidden ground.
      touched: seconds in which it touched a pedestrian.
    """

    house: str
    x: int
    y: int
    heading: int
    seconds: float
    status: StatusName
    off_ground: float
    touched: float


def drive_all(
    robot: Equipment, houses: Sequence[House], starts: Sequence[Start], *, seed: int = 0, pedestrians: int = 0,
    knows_map: bool = False, time_limit: float = SECONDS_LIMIT, on_progress: Callable[[int], None] | None = None,
) -> list[DriveResult]:  # fmt: skip
    """Drive from every start to the end: a front door, nothing left to explore, or the time limit.

    Args:
      robot: equipment of the robots.
      houses: houses of the starts; all of one size.
      starts: first poses.
      seed: seed of noise and pedestrians.
      pedestrians: number of pedestrians in each episode.
      knows_map: whether the robots know the map in advance.
      time_limit: seconds after which an episode ends without success.
      on_progress: called now and then with the number of episodes that have ended.
    """
    index, poses = episodes_from(starts, {house.name: number for number, house in enumerate(houses)})
    status, *periods = run_all(
        reset, step, lambda robots: (robots.status, robots.periods, robots.off_ground, robots.touched),
        (poses, np.full(len(starts), knows_map)), index, sites_of([house.terrain for house in houses]), robot,
        seed=seed, number=pedestrians, limit=round(time_limit / CONTROL_PERIOD), first_steps=_FIRST_PERIODS,
        on_progress=on_progress,
    )  # fmt: skip
    times = np.round(CONTROL_PERIOD * np.array(periods), 2).T.tolist()
    return [
        DriveResult(*start[:4], seconds, STATUS_NAMES[ending], off_ground, touched)
        for start, ending, (seconds, off_ground, touched) in zip(starts, status, times, strict=True)
    ]


def summarize_drives(drives: Sequence[DriveResult], oracle: Sequence[DriveResult]) -> dict[str, float]:
    """Statistics of a run.

    Args:
      drives: drives of the run.
      oracle: drives from the same starts with a known map.
    """
    extra = [100 * (one.seconds / knowing.seconds - 1) for one, knowing in zip(drives, oracle, strict=True)]
    mean, low, high = house_bootstrap(extra, [one.house for one in drives], resamples=2000, seed=0)
    return {
        "extra": mean,
        "extra_low": low,
        "extra_high": high,
        "median_extra": float(np.median(extra)),
        "success": float(np.mean([one.status == STATUS_NAMES[ARRIVED] for one in drives])),
        "seconds_off_ground": float(np.mean([one.off_ground for one in drives])),
        "seconds_touching_people": float(np.mean([one.touched for one in drives])),
    }
