"""Recordings for the viewer: class images a second, from the end of the episodes to the closed file."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from rerun.chunk import RrdReader

from dc2g_jax._src.figures.replay import Frames, replay_result
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.viewer.recording import record_episode

from .bench import SENSING_RANGE, Bench, own
from .rows import Row

#: Planners that are recorded side by side.
_PLANNERS = ("frontier", "dc2g")


def images_in(path: Path) -> int:
    """Class images of single steps in a recording, counted in the file."""
    batches = (chunk.to_record_batch() for chunk in RrdReader(path).stream())
    steps = [batch for batch in batches if "step" in batch.schema.names]
    return sum(batch.num_rows for batch in steps if "SegmentationImage:buffer" in batch.schema.names)


def recording_rows(bench: Bench) -> Iterator[Row]:
    """One start, planners side by side: written from frames that are there already, and replayed first."""
    workload, settings = bench.workload, SETTINGS["reference"]
    rules, start = bench.rules(), workload.starts[0]
    dataset = HouseDataset(name=workload.dataset, source="folder", houses=workload.houses)
    found = Runner(dataset, settings).run([start], _PLANNERS, bench.network)
    results, house = {result.planner: result for result in found}, dataset.house(start.house)

    def replayed() -> dict[str, Frames]:
        return {planner: replay_result(result, house, rules, bench.network) for planner, result in results.items()}

    frames = replayed()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.rrd"

        def write(frames: dict[str, Frames]) -> int:
            record_episode(path, house=house, result_by_planner=results, frames_by_planner=frames)
            return path.stat().st_size

        calls = {"written": lambda: write(frames), "replayed and written": lambda: write(replayed())}
        for what, call in calls.items():
            row = own("recording", f"episodes {what}", "grid images", cells=workload.cells, sensing_range=SENSING_RANGE)
            measured = bench.measure(call)
            images = images_in(path)
            facts = {
                "images": float(images),
                "steps": float(sum(map(len, frames.values()))),
                "KiB": measured.output / 1024,
            }
            yield row.with_figures(measured, images, checksum=None, facts=facts)
