"""Every reader, on files with damage: each is read, or refused in one short line, soon and in little memory.

    FUZZ_INPUTS=100000 pytest -n 0 -rP -m "slow or not slow" tests/test_damaged_files.py

takes so many inputs for each file, different ones each time (`--hypothesis-seed` repeats them), instead of a few that
are always the same; and says how many there were, how many were refused, and the longest time and most memory of one.
"""

import collections
import dataclasses
import gzip
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import osmium
import pytest
from hypothesis import HealthCheck, given, settings
from PIL import Image

from dc2g_jax._src.cli.outputs import _read_run
from dc2g_jax._src.estimation.checkpoints import network_in_folder, save_network, write_network
from dc2g_jax._src.estimation.compact_unet import Architecture, init_weights
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.estimation.weights import fresh_weights, write_safetensors
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.rows import ResumableTable, read_rows, write_rows
from dc2g_jax._src.grid.terrain import CLASS_COLORS, CLASS_NAMES
from dc2g_jax._src.readers.houses import load_dataset, map_dataset
from dc2g_jax._src.readers.maps import Goal, read_map
from dc2g_jax._src.readers.starts import read_starts
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.errors import LONGEST_MESSAGE, InputError
from dc2g_jax._src.training.cost_to_go_data import check_masks, kept_arrays
from dc2g_jax._src.training.loop import Log
from dc2g_jax._src.training.masks import Masks
from dc2g_jax._src.training.tracking import Curve
from dc2g_jax.indoor.houses.procthor import read_procthor
from dc2g_jax.indoor.learning.midlevel import ENCODER, EncoderArchitecture, SmallEncoder
from dc2g_jax.indoor.learning.networks import COST_MAPS, CostMapArchitecture, CostMapNetwork, load_costs
from dc2g_jax.osm.extract import read_extract
from dc2g_jax.osm.neighborhood import Neighborhood
from dc2g_jax.robot.mapping.sequences import Shot, read_frame, read_picture, read_sequence, write_sequence
from tests.support import house_lines, occupancy
from tests.support.damage import damaged
from tests.support.frames import CAMERA, random_frame
from tests.support.hamlet import hamlet
from tests.support.houses import DATASET, STREET, YARD, save_dataset
from tests.support.memory import forget_most_memory, memory
from tests.support.toy import RESULTS

#: Inputs of each file; a tenth of them where reading takes long.
INPUTS = int(os.environ.get("FUZZ_INPUTS", "40"))

#: Most seconds of CPU time, and most bytes of memory beyond what the process has.
MOST_SECONDS, MOST_BYTES = 5, 500e6

KEY = jax.random.key(0)

EXTRACTS = ("plain.osm", "packed.osm.gz", "binary.osm.pbf")


class Reader(NamedTuple):
    """A reader: the files to damage, writes intact ones to a folder, reads them, and whether it takes long."""

    files: tuple[str, ...]
    write: Callable[[Path], None]
    read: Callable[[Path], Any]
    slow: bool = False


def write_palette(folder: Path) -> None:
    rows = [f"{name},{','.join(map(str, color))}" for name, color in zip(CLASS_NAMES, CLASS_COLORS, strict=True)]
    (folder / "labels_colors.csv").write_text("\n".join(["class,r,g,b", *rows]))


def write_houses(folder: Path) -> None:
    folder.rmdir()
    save_dataset([("street", "train", STREET), ("yard", "test", YARD)], folder)


def write_maps(folder: Path) -> None:
    np.save(folder / "yard.npy", YARD)
    np.save(folder / "street.npy", STREET.astype(np.int64, order="F"))
    (folder / "goals.csv").write_text("map,x,y,unit\nyard,4,4,cells\nstreet,0,4,cells\n")
    (folder / "cells.csv").write_text("columns,rows\n10,8\n")


def write_occupancy(folder: Path) -> None:
    occupancy.save(folder, np.full((8, 9), 254, np.uint8), mode="trinary")


def write_transparent_occupancy(folder: Path) -> None:
    write_occupancy(folder)
    shades = np.full((8, 9, 4), 255, np.uint8)
    Image.fromarray(shades).save(folder / "shades.png")
    text = (folder / "lab.yaml").read_text()
    (folder / "lab.yaml").write_text(text.replace("lab.pgm", "shades.png").replace("trinary", "scale"))


def read_occupancy(folder: Path) -> None:
    read_map(folder / "lab.yaml", goals=[Goal(0.1, 0.1, "meters")])


def write_recording(folder: Path) -> None:
    rng = np.random.default_rng(0)
    small = dataclasses.replace(CAMERA, height=6, width=8)
    picture = np.zeros((6, 8, 3), np.uint8)

    def frame() -> Any:
        whole = random_frame(rng)
        return dataclasses.replace(whole, depth=whole.depth[:6, :8], classes=whole.classes[:6, :8])

    write_sequence(folder / "new", small, [Shot(frame(), picture) for _ in range(2)])
    for path in (folder / "new").iterdir():
        path.rename(folder / path.name)
    (folder / "new").rmdir()


def read_recording(folder: Path) -> None:
    sequence = read_sequence(folder)
    for moment in sequence.frames:
        read_frame(sequence, moment)
        read_picture(moment)


def write_starts(folder: Path) -> None:
    (folder / "starts.csv").write_text("house,x,y,heading,range,expanding_range\nstreet,9,5,1,8,\nyard,5,4,3,,\n")


def write_compact(folder: Path) -> None:
    architecture = Architecture(widths=(2, 2, 2, 2))
    save_network(folder, NetworkCostToGo(init_weights(architecture, KEY), architecture), {"seed": 1})


def write_indoor(folder: Path) -> None:
    architecture = CostMapArchitecture(widths=(3, 4), embedding=2, features=3, feature_width=3)
    small = EncoderArchitecture((2, 2, 2), features=3)
    write_network(folder / "encoder", fresh_weights(SmallEncoder, small, KEY), small, ENCODER)
    write_network(folder, fresh_weights(CostMapNetwork, architecture, KEY), architecture, COST_MAPS)


def write_run(folder: Path) -> None:
    facts = {"experiment": "train", "options": {"seed": 0, "out": None}, "inputs": {"dataset": "1a"}, "runs": [{}]}
    write_json(folder / "run.json", facts)


def write_log(folder: Path) -> None:
    Log(folder).write({"step": 10, "error": 0.5}, {"step": 20, "error": 0.25})


def write_curve(folder: Path) -> None:
    for step in (10, 20):
        Curve(folder, ("a", "b")).add(step, [{"loss": 0.5}, {"loss": 0.25}])


def write_episodes(folder: Path) -> None:
    write_rows(folder / "episodes.csv", EpisodeResult, list(RESULTS.values()))


def read_episodes(folder: Path) -> None:
    read_rows(folder / "episodes.csv", EpisodeResult)
    ResumableTable(folder / "episodes.csv", EpisodeResult)


def write_masks(folder: Path) -> None:
    masks = {"boards": np.ones((3, 1, 8), np.uint32), "world": np.array([0, 1, 1])}
    write_safetensors(folder / "masks.safetensors", masks)


def read_masks(folder: Path) -> None:
    arrays = kept_arrays(folder / "masks.safetensors", Masks._fields, lambda show: {}, unit="rollout")
    check_masks(Masks(**arrays), DATASET.houses[:2], "masks.safetensors")


def write_indoor_houses(folder: Path) -> None:
    plain = house_lines.write(folder, house_lines.house(), house_lines.house())
    (folder / "train.jsonl.gz").write_bytes(gzip.compress(plain.read_bytes()))


def read_indoor_houses(folder: Path) -> None:
    for name in ("train.jsonl", "train.jsonl.gz"):
        read_procthor(folder / name)


def write_extracts(folder: Path) -> None:
    text = hamlet().text().encode()
    (folder / "plain.osm").write_bytes(text)
    (folder / "packed.osm.gz").write_bytes(gzip.compress(text))
    with osmium.SimpleWriter(folder / "binary.osm.pbf") as writer:
        for element in osmium.FileProcessor(folder / "plain.osm"):
            writer.add(element)


def read_extracts(folder: Path) -> None:
    for name in EXTRACTS:
        neighborhood = Neighborhood(read_extract(folder / name), meters=60.0, cells=50, seed=0, only_mapped=False)
        for building in neighborhood.buildings[:2]:
            neighborhood.map_of(building)


READERS = (
    Reader(
        ("labels_colors.csv", "training_houses.csv", "full_semantic/test/worldyard.png"),
        write_houses,
        lambda folder: load_dataset(folder, cells=None),
    ),
    Reader(("yard.npy", "street.npy", "goals.csv", "cells.csv"), write_maps, map_dataset),
    Reader(("lab.yaml", "lab.pgm"), write_occupancy, read_occupancy),
    Reader(("shades.png",), write_transparent_occupancy, read_occupancy),
    Reader(
        (
            "depth.txt", "classes.txt", "rgb.txt", "groundtruth.txt", "camera.txt", "depth/0.000000.png",
            "classes/0.100000.png",
        ),
        write_recording,
        read_recording,
    ),
    Reader(("starts.csv",), write_starts, lambda folder: read_starts(folder / "starts.csv", DATASET)),
    Reader(("network.json", "weights.safetensors"), write_compact, network_in_folder, slow=True),
    Reader(
        ("network.json", "weights.safetensors", "encoder/network.json", "encoder/weights.safetensors"),
        write_indoor,
        load_costs,
        slow=True,
    ),
    Reader(("run.json",), write_run, _read_run),
    Reader(("log.jsonl",), write_log, lambda folder: Log(folder).by_step(None, ("error",))),
    Reader(("curve.csv",), write_curve, lambda folder: Curve(folder, ("a", "b"))),
    Reader(("episodes.csv",), write_episodes, read_episodes),
    Reader(("masks.safetensors",), write_masks, read_masks),
    Reader(("train.jsonl", "train.jsonl.gz", "asset_boxes.json"), write_indoor_houses, read_indoor_houses),
    Reader(EXTRACTS, write_extracts, read_extracts, slow=True),
)  # fmt: skip


@pytest.mark.parametrize(
    ("reader", "name"),
    [
        pytest.param(reader, name, id=name, marks=[pytest.mark.slow] if reader.slow else [])
        for reader in READERS
        for name in reader.files
    ],
)
def test_damaged_files_are_read_or_refused_soon_and_in_one_line(reader, name, tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    reader.write(folder)
    os.mkfifo(folder / "pipe")
    (folder / "folder").mkdir()
    path = folder / name
    whole = path.read_bytes()
    reader.read(folder)
    told = collections.Counter[str]()
    longest, most = 0.0, 0

    def survive(content: bytes) -> None:
        nonlocal longest, most
        path.write_bytes(content)
        forget_most_memory()
        before, began = memory(), time.process_time()
        try:
            reader.read(folder)
        except InputError as error:
            message = str(error)
            told["refused"] += 1
        else:
            message = "read"
        seconds, taken = time.process_time() - began, memory("VmHWM") - before
        told["inputs"] += 1
        longest, most = max(longest, seconds), max(most, taken)
        assert message.isprintable()
        assert len(message) <= LONGEST_MESSAGE
        assert seconds < MOST_SECONDS
        assert taken < MOST_BYTES

    count = max(INPUTS // 10, 1) if reader.slow else INPUTS
    often = settings(
        max_examples=count, derandomize="FUZZ_INPUTS" not in os.environ, suppress_health_check=list(HealthCheck)
    )
    often(given(damaged(whole))(survive))()
    print(f"{name}: {json.dumps(told)}, at most {longest:.2f} s and {most / 1e6:.0f} MB")
