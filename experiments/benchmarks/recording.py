"""Recordings for the viewer: class images a second, from the end of the episodes to the closed file."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from rerun.chunk import RrdReader

from dc2g_jax.datasets.houses import HouseDataset
from dc2g_jax.inspection.recording import RecordedEpisode, record_frames
from dc2g_jax.inspection.replay import replay_result
from dc2g_jax.planning.rules import SETTINGS
from dc2g_jax.rollouts.evaluation import EpisodeResult, Runner

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
    results = Runner(dataset, settings).run([start], _PLANNERS, bench.network)
    house = dataset.house(start.house)

    def replayed(result: EpisodeResult) -> RecordedEpisode:
        return RecordedEpisode(result, replay_result(result, house, rules, bench.network))

    episodes = {result.planner: replayed(result) for result in results}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.rrd"

        def write() -> int:
            return record_frames(path, house=house, episodes=episodes).stat().st_size

        def replay_and_write() -> int:
            again = {result.planner: replayed(result) for result in results}
            return record_frames(path, house=house, episodes=again).stat().st_size

        for what, call in (("written", write), ("replayed and written", replay_and_write)):
            row = own("recording", f"episodes {what}", "grid images", cells=workload.cells, sensing_range=SENSING_RANGE)
            measured = bench.measure(call)
            images = images_in(path)
            facts = {
                "images": float(images),
                "steps": float(sum(len(episode.frames) for episode in episodes.values())),
                "KiB": measured.output / 1024,
            }
            yield row.with_figures(measured, images, checksum=None, facts=facts)
