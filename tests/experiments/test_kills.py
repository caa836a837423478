"""Work on two processes, one of which is killed now and then, ends like work that nobody disturbed."""

import csv
import hashlib
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from dc2g_jax._src.cli import episodes
from dc2g_jax._src.estimation.weights import read_safetensors
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.starts import sample_starts
from tests.support import maps
from tests.support.places import ROOT

#: Runs of the sweep, and how often a process is killed.
RUNS, KILLS = 200, 5

#: Seconds within which the other process ends.
A_MINUTE = 60


@pytest.fixture(scope="module")
def houses(tmp_path_factory) -> Path:
    """A tiny map of every split. They are not square, so that no houses are drawn to validate in."""
    folder = tmp_path_factory.mktemp("houses")
    for number, split in enumerate(("train", "val", "test")):
        (folder / split).mkdir()
        np.save(folder / split / f"{split}.npy", maps.random_terrain(number, (10, 12), 0.85, doors=2))
    return folder


def started(command: list[object], n_processes: int, resume: bool) -> list[subprocess.Popen]:
    """The processes of a command, each on one core."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    options = [[]]
    if n_processes > 1:
        shared = ["--coordinator", address, "--num-processes", n_processes]
        options = [[*shared, "--process-id", number] for number in range(n_processes)]
    words = [[*command, "--devices", 1, *own, *["--resume"] * resume] for own in options]
    return [
        subprocess.Popen(
            [sys.executable, "-c", START, *map(str, one)], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True,
        )
        for one in words
    ]  # fmt: skip


#: Runs a command with shards of few episodes.
START = f"""
import runpy, sys
import {episodes.__name__} as episodes
episodes.EPISODES_A_SHARD = 100
runpy.run_module("dc2g_jax", run_name="__main__", alter_sys=True)
"""


def finish(processes: list[subprocess.Popen]) -> None:
    """Wait until all have ended well."""
    for process in processes:
        _, errors = process.communicate(timeout=3000)
        assert process.returncode == 0, errors


def disturbed(command: list[object], out: Path, progress: Callable[[], int], kills: int) -> None:
    """Run a command on two processes, of which one, each in turn, is killed at random moments; then let it finish.

    Args:
      command: the command.
      out: the folder it writes to.
      progress: a number that grows with what is written; a process is killed a moment after it has grown.
      kills: how often.
    """
    draw = random.Random(0)
    for number in range(kills):
        before, processes = progress(), started(command, 2, (out / "run.json").exists())
        while progress() <= before and all(process.poll() is None for process in processes):
            time.sleep(0.02)
        time.sleep(draw.uniform(0, 2))
        victim = number % 2
        assert processes[victim].poll() is None, "there was nothing left to disturb"
        processes[victim].kill()
        killed = time.monotonic()
        _, errors = processes[1 - victim].communicate(timeout=A_MINUTE)
        seconds = time.monotonic() - killed
        processes[victim].communicate()
        print(f"\nkill {number}: process {victim}; the other ended after {seconds:.1f} s: {errors[-400:]!r}")
        assert "Traceback" not in errors
        if victim == 0 and processes[1].returncode == -signal.SIGABRT:
            # JAX ends a process that was not waiting for the first one when that died.
            assert "JAX distributed service detected fatal errors" in errors
            continue
        assert processes[1 - victim].returncode == 1
        # JAX's own threads may write after it.
        lines = errors.replace("\r", "\n").splitlines()
        assert sum(line.startswith(f"error: process {1 - victim} lost the others") for line in lines) == 1
    finish(started(command, 2, resume=True))


def weights_of(out: Path) -> dict[str, dict[str, np.ndarray]]:
    """The weights of every run of a sweep."""
    return {path.parts[-3]: read_safetensors(path) for path in out.glob("runs/*/network/weights.safetensors")}


def ranking(table: str) -> list[str]:
    """The runs of a sweep, the best first."""
    return [row["run"] for row in csv.DictReader(table.splitlines())]


@pytest.mark.release
def test_a_sweep(houses, tmp_path):
    def command(out: str) -> list[object]:
        return [
            "sweep", "--dataset", houses, "--out", tmp_path / out, "--extra-houses", 0, "--starts-per-house", 1,
            "--masks-per-episode", 2, "--ranges", 6, "--steps", 4, "--batch-size", 4, "--widths", "2,2,2,2",
            "--losses", "l1", "l2", "--seeds", *range(RUNS // 2), "--validate-every", 0, "--split", "None",
            "--runs-at-once", 20,
        ]  # fmt: skip

    finish(started(command("whole"), 2, False))
    killed = tmp_path / "killed"
    disturbed(command("killed"), killed, lambda: len(list(killed.glob("runs/*/network"))), KILLS)
    finish(started(command("alone"), 1, False))
    whole, after_kills, alone = (weights_of(tmp_path / out) for out in ("whole", "killed", "alone"))
    assert len(whole) == RUNS
    jax.tree.map(np.testing.assert_array_equal, whole, after_kills)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-5), whole, alone)
    whole_table, killed_table, alone_table = (
        (tmp_path / out / "results.csv").read_text() for out in ("whole", "killed", "alone")
    )
    assert whole_table == killed_table
    assert ranking(whole_table) == ranking(alone_table)


@pytest.mark.slow
def test_episodes(houses, tmp_path):
    starts = tmp_path / "starts.csv"
    lines = [",".join(map(str, start[:4])) for start in sample_starts(open_dataset(houses).houses, 2000, seed=0)]
    starts.write_text("\n".join(["house,x,y,heading", *lines]))

    def command(out: str) -> list[object]:
        return [
            "run", "--starts", starts, "--dataset", houses, "--out", tmp_path / out, "--planner", "frontier",
            "oracle", "--step-limit", 100,
        ]  # fmt: skip

    finish(started(command("whole"), 2, False))
    table = tmp_path / "killed" / "episodes.csv"
    disturbed(command("killed"), table.parent, lambda: table.stat().st_size if table.exists() else 0, KILLS)
    finish(started(command("alone"), 1, False))
    digests = {
        hashlib.sha256((tmp_path / out / "episodes.csv").read_bytes()).digest() for out in ("whole", "killed", "alone")
    }
    assert len(digests) == 1
