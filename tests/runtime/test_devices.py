"""Work divided among devices and processes gives what one device gives."""

import os
import platform
import resource
import socket
import subprocess
import sys
import types

import jax
import numpy as np
import pytest

from dc2g_jax._src.readers.houses import load_dataset
from dc2g_jax._src.readers.starts import sample_starts
from dc2g_jax._src.runtime import devices
from dc2g_jax._src.runtime.devices import (
    cores,
    deal,
    dealt_counts,
    gather,
    join_processes,
    mesh_for_batch,
    mesh_of,
    not_repeated,
    on_each,
    require_memory,
    reuse_memory,
    settle,
    use_cores,
    use_devices,
)
from dc2g_jax.families.procedural import draw_house
from tests.support.houses import save_dataset
from tests.support.places import ROOT
from tests.support.refusals import refusal


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_large_arrays_reuse_the_memory_of_freed_ones():
    reuse_memory()

    def faults():
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        np.ones(2**23)  # 64 MiB
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

    faults()
    assert faults() < 100


@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("n_devices", [1, 2])
def test_what_is_dealt_out_is_gathered_in_order(count, n_devices):
    mesh, pieces = mesh_of(jax.devices()[:n_devices]), {"a": np.arange(count), "b": np.ones((count, 2))}
    dealt = deal(pieces, count, mesh)
    assert dealt["a"].shape == (n_devices, -(-count // n_devices))
    jax.tree.map(np.testing.assert_array_equal, gather(dealt, count), pieces)
    wanted = not_repeated(count, mesh)
    assert sorted(np.asarray(dealt["a"])[wanted].tolist()) == list(range(count))
    assert dealt_counts(count, mesh).sum() == wanted.sum() == count


def test_each_device_works_on_its_part():
    mesh = mesh_of()
    dealt = deal(np.arange(5), 5, mesh)
    made = on_each(lambda own, factor: factor * own + len(own), mesh, dealt, 10)
    assert gather(made, 5).tolist() == [3, 13, 23, 33, 43]


def test_cores_that_are_refused():
    use_cores(jax.device_count())  # as it is
    refusal(lambda: use_cores(0), "number of cores 0", "at least 1")
    refusal(lambda: use_cores(7), "7 cores", "already started with 2", "before anything else")
    assert cores() >= 1


@pytest.mark.parametrize("given", [("host:1", 2, None), (None, 2, 0), ("host:1", None, None)])
def test_processes_are_named_completely_or_not_at_all(given):
    refusal(lambda: join_processes(*given), "--coordinator", "--num-processes", "--process-id")


def test_the_number_of_a_process_is_checked():
    refusal(lambda: join_processes("host:1", 2, 2), "--process-id 2", "0 to 1")


def test_what_jax_is_told(monkeypatch):
    told = {}
    monkeypatch.setattr(jax.config, "update", told.__setitem__)
    monkeypatch.setattr(jax.distributed, "initialize", lambda *given, **options: told.update(processes=given))
    join_processes("host:1", 2, 0)
    assert told["processes"] == ("host:1", 2, 0)
    use_devices(2)
    assert (told["jax_cuda_visible_devices"], told["jax_num_cpu_devices"]) == ("0,1", 2)
    refusal(lambda: use_devices(1), "--devices 1: there are 2")
    assert (told["jax_cuda_visible_devices"], told["jax_num_cpu_devices"]) == ("0", 1)


@pytest.mark.parametrize(
    ("platform", "size", "runs", "shape"),
    [("cpu", 4, 1, (1, 2)), ("cpu", 4, 2, (1, 2)), ("cpu", 3, 1, (1, 1)), ("gpu", 4, 6, (2, 1)), ("gpu", 4, 3, (1, 2))],
)
def test_runs_and_batches_share_as_many_devices_as_divide_them(monkeypatch, platform, size, runs, shape):
    monkeypatch.setattr(devices, "platform", lambda mesh: platform)
    monkeypatch.setattr(jax, "devices", lambda: jax.local_devices()[:2])
    monkeypatch.setattr(jax, "device_count", lambda: 2)
    assert mesh_for_batch(size, runs).devices.shape == shape


def test_memory_that_is_surely_needed():
    require_memory(1e6, "--slots 1")
    refusal(lambda: require_memory(1e18, "--slots 9"), "--slots 9: needs more than 1e+09 GB of memory", "lower it")


def test_settle_waits_where_several_cores_are_devices():
    waited = []
    settle([types.SimpleNamespace(block_until_ready=lambda: waited.append(True))])
    assert waited


_LATE = """
import time
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import PartitionSpec as P
from dc2g_jax._src.runtime.devices import AXIS, mesh_of, use_cores

def late(core):
    time.sleep(75 * core)
    return np.float32(core)

def on_device(share):
    core = jax.pure_callback(late, jax.ShapeDtypeStruct((), jnp.float32), jax.lax.axis_index(AXIS))
    return jax.lax.psum(share + core, AXIS)

use_cores(2)
print(jax.jit(jax.shard_map(on_device, mesh=mesh_of(), in_specs=P(AXIS), out_specs=P(), check_vma=False))(jnp.ones(2)))
"""


@pytest.mark.slow
def test_a_core_that_is_a_minute_behind_is_waited_for():
    done = subprocess.run([sys.executable, "-c", _LATE], capture_output=True, text=True, cwd=ROOT, check=False)
    assert (done.returncode, done.stdout) == (0, "[3.]\n"), done.stderr


def test_flags_of_the_user_come_after_those_of_the_package(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_collective_call_terminate_timeout_seconds=5")
    use_cores(jax.device_count())
    ours, theirs = os.environ["XLA_FLAGS"].split()
    assert ours.endswith("=600")
    assert theirs.endswith("=5")


@pytest.mark.slow
def test_the_table_is_the_same_on_any_number_of_devices_and_processes(tmp_path):
    starts = tmp_path / "starts.csv"
    images = [(f"n001m000h00{seed}", "val", draw_house(seed, "suburb_sidewalks")) for seed in range(2)]
    folder = save_dataset(images, tmp_path / "houses")
    houses = load_dataset(folder).houses
    rows = [",".join(map(str, start[:4])) for start in sample_starts(houses, 3, seed=0)]
    starts.write_text("\n".join(["house,x,y,heading", *rows]))
    command = [sys.executable, "-m", "dc2g_jax", "run", "--starts", starts, "--dataset", folder]
    command += ["--planner", "frontier", "--out"]
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    together = ["--devices", "1", "--coordinator", address, "--num-processes", "2", "--process-id"]
    runs = [["one", "--devices", "1"], ["eight", "--devices", "8"], *(["two", *together, str(n)] for n in range(2))]
    processes = [
        subprocess.Popen([*command, tmp_path / out, *options], cwd=ROOT, stderr=subprocess.PIPE)
        for out, *options in runs
    ]
    for process in processes:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors.decode()
    tables = {(tmp_path / name / "episodes.csv").read_bytes() for name in ("one", "eight", "two")}
    assert len(tables) == 1
