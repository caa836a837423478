"""The paper's Fig. 9: from camera to door, `python -m experiments.reproduce_fig9`."""

import dataclasses
import math
import sys
from pathlib import Path
from typing import Annotated

import cv2
import jax
import numpy as np
import tyro
from tqdm import tqdm

from dc2g_jax.cli.common import (
    DatasetOption,
    NetworkOption,
    OutOption,
    PlannerOption,
    check_planners,
    command_line,
    network_for,
)
from dc2g_jax.cli.driving import SECONDS_LIMIT, DrivingOptions, equipment
from dc2g_jax.cli.map_options import StartOption, start_in
from dc2g_jax.cli.outputs import output_folder
from dc2g_jax.datasets.houses import House, HouseDataset, open_dataset
from dc2g_jax.datasets.starts import why_no_episode
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import SHIPPED_NOISY_NETWORK
from dc2g_jax.files.resources import resource
from dc2g_jax.grid.poses import make_pose
from dc2g_jax.inspection.camera_recording import CameraRecording, MappedFrame
from dc2g_jax.inspection.driving_figures import plot_moments
from dc2g_jax.vehicles.drive import STATUS_NAMES, Equipment, reset
from dc2g_jax.vehicles.fleet import sites_of
from dc2g_jax.vehicles.trace import Moment, moments

#: Moments that the figure shows.
_ROWS = 4


@dataclasses.dataclass(frozen=True)
class Options(DrivingOptions):
    """Drive one vehicle with a camera to a front door (section IV-D): a figure, and a recording of every frame.

    Attributes:
      house: name of the house; the first test house in which an episode can be run where not given.
      start: column, row (growing downward) and heading (0 right, 1 down, 2 left, 3 up); sampled where not given.
      noise: level of noise: 0 is none, 1 as much as the paper's maps may have had.
      planner: planner to drive by; one of your own as package.module:Class.
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      network: folder of the trained network; where not given, the shipped one that was trained with mapping noise.
      seed: of the sampled start, noise and pedestrians.
      out: folder to write to; a new one below outputs/ where not given.
    """

    house: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    start: StartOption = None
    noise: float = 1.0
    planner: PlannerOption = "dc2g"
    dataset: DatasetOption = None
    network: NetworkOption = None
    seed: int = 0
    out: OutOption = None


def record(file: Path, drive: list[Moment], robot: Equipment, name: str) -> None:
    """Write the recording."""
    path = np.stack([np.asarray(moment.frame.pose.position) for moment in drive])
    with CameraRecording(file, camera=robot.camera, settings=robot.mapping, path=path, name=name) as recording:
        for moment in tqdm(drive, desc="recording", unit="frame", file=sys.stderr):
            _, encoded = cv2.imencode(".png", moment.picture[..., ::-1])
            recording.add(MappedFrame(moment.frame, encoded.tobytes(), moment.robot.map, moment.robot.terrain))


def first_house(dataset: HouseDataset) -> House:
    """The first test house in which an episode can be run.

    Raises:
      InputError: if there is none.
    """
    for house in dataset.split("test"):
        if why_no_episode(house) is None:
            return house
    raise InputError(f"{dataset.name}: no episode can be run in any of its test houses; name another --house")


def main(options: Options) -> None:
    """Drive, draw, record."""
    if not 0 <= options.noise < math.inf:
        raise InputError(f"--noise {options.noise:g}: give a number from 0 on")
    check_planners([options.planner])
    dataset = open_dataset(options.dataset)
    house = first_house(dataset) if options.house is None else dataset.house(options.house)
    start = start_in(house.name, house, options.start, options.seed)
    robot = equipment(
        options.planner,
        network_for([options.planner], options.network or resource(SHIPPED_NOISY_NETWORK)),
        house.terrain.shape,
        options.noise,
        options,
    )
    out = output_folder(options, "reproduce_fig9")
    site = jax.tree.map(lambda leaf: leaf[0], sites_of([house.terrain]))
    pose = make_pose(start.x, start.y, start.heading)
    first = reset(jax.random.key(options.seed), pose, site, robot, pedestrians=options.pedestrians)
    print("Compiling, half a minute or so; then it drives.", file=sys.stderr)
    drive = list(tqdm(moments(first, site, robot, SECONDS_LIMIT), desc="driving", unit="frame", file=sys.stderr))
    last = drive[-1].robot
    plot_moments(out / "fig9", drive, _ROWS, robot.mapping.cell_size)
    record(out / "fig9.rrd", drive, robot, house.name)
    known = last.terrain != 0
    right = 100 * np.mean((last.terrain == house.terrain)[known])
    print(f"{house.name}: {STATUS_NAMES[int(last.status)]} after {int(last.periods) / 10:.1f} s, {len(drive)} frames")
    print(f"of {np.sum(known):,} cells known in the end, {right:.1f} % are as in the house")
    print(f"Written to {out}: fig9.png, fig9.svg, fig9.rrd (open it with: rerun {out / 'fig9.rrd'})")


if __name__ == "__main__":
    command_line(Options, main)
