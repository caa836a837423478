"""The paper's Fig. 9: a drive from camera to door, `python -m experiments.reproduce_fig9`."""

import dataclasses
import sys

import cv2
import jax
import numpy as np
from tqdm import tqdm

from dc2g_jax._src.cli.common import NetworkOption, check_planners, command_line, network_for
from dc2g_jax._src.cli.map_options import StartOption, start_in
from dc2g_jax._src.cli.options import DatasetOptions, OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.checkpoints import SHIPPED_NOISY_NETWORK
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.starts import check_starts, usable_houses
from dc2g_jax._src.runtime.errors import check_number
from dc2g_jax.robot.recording import MappedFrame, record_camera
from experiments.driving.drive import reset
from experiments.driving.fleet import Moment, moments, sites_of
from experiments.support.commands import HouseOption, PlannerOption
from experiments.support.drive_figures import plot_moments
from experiments.support.driving import SECONDS_LIMIT, STATUS_NAMES, DrivingOptions, equipment

#: Number of moments in the figure.
_ROWS = 4


@dataclasses.dataclass(frozen=True)
class Options(DrivingOptions, DatasetOptions, OutOptions):
    """Drive one vehicle with a camera to a front door (section IV-D): writes a figure and a recording of every frame.

    Attributes:
      house: name of the house; by default the first test house in which an episode can be run.
      start: column, row (growing downward) and heading (0 right, 1 down, 2 left, 3 up); sampled by default.
      noise: noise level; 0 is no noise, 1 the presumed noise of the paper's maps.
      planner: planner to run; package.module:Name for one of your own.
      network: folder of a trained network; by default the shipped one that was trained with mapping noise.
      seed: seed of the sampled start, noise and pedestrians.
    """

    house: HouseOption = None
    start: StartOption = None
    noise: float = 1.0
    planner: PlannerOption = "dc2g"
    network: NetworkOption = None
    seed: int = 0


def mapped(moment: Moment) -> MappedFrame:
    """A moment of a drive as a recording shows it."""
    _, encoded = cv2.imencode(".png", moment.picture[..., ::-1])
    return MappedFrame(moment.frame, encoded.tobytes(), moment.robot.map, np.asarray(moment.robot.terrain))


def main(options: Options) -> None:
    """Drive; write the figure and the recording."""
    check_number("--noise", options.noise, least=0)
    check_planners([options.planner])
    dataset = open_dataset(options.dataset)
    if options.house is None:
        house = usable_houses(dataset, "test", instead="name another --house")[0]
    else:
        house = dataset.house(options.house)
    start = start_in(house.name, house, options.start, options.seed)
    check_starts([start], dataset)
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
    first = reset(jax.random.key(options.seed), (pose, False), site, robot, options.pedestrians)
    print("Compiling, half a minute or so; then it drives.", file=sys.stderr)
    drive = list(tqdm(moments(first, site, robot, SECONDS_LIMIT), desc="driving", unit="frame", file=sys.stderr))
    last = drive[-1].robot
    plot_moments(out / "fig9", drive, _ROWS, robot.mapping.cell_size)
    path = np.stack([np.asarray(moment.frame.pose.position) for moment in drive])
    frames = map(mapped, tqdm(drive, desc="recording", unit="frame", file=sys.stderr))
    record_camera(out / "fig9.rrd", frames, camera=robot.camera, settings=robot.mapping, path=path, name=house.name)
    known = last.terrain != 0
    right = 100 * np.mean((last.terrain == house.terrain)[known])
    print(f"{house.name}: {STATUS_NAMES[int(last.status)]} after {int(last.periods) / 10:.1f} s, {len(drive)} frames")
    print(f"of {np.sum(known):,} cells known in the end, {right:.1f} % are as in the house")
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
