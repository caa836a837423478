"""The benchmark command end to end, and the sums it does."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.families import procedural_dataset
from experiments import benchmark
from experiments.baselines.problem import BaselineUnavailable
from experiments.benchmark import Section
from experiments.benchmarks import accelerator, timing
from experiments.benchmarks.bench import own
from experiments.benchmarks.machine import peaks
from experiments.benchmarks.programs import TooLarge, compile_program
from experiments.benchmarks.report import SECTIONS
from experiments.benchmarks.rows import Row, attempt
from experiments.benchmarks.timing import checksum, measure
from experiments.benchmarks.work import Work, count_work
from experiments.benchmarks.workload import make_workload, resized
from tests.support.places import ROOT
from tests.support.refusals import refusal


def run(*options: object) -> subprocess.CompletedProcess:
    """Run the command as users do."""
    command = [sys.executable, "-m", "experiments.benchmark", *(str(option) for option in options)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)


def facts_of(folder: Path) -> dict:
    """What a quick run wrote, after a look at every row of it."""
    facts = json.loads((folder / "benchmark.json").read_text())
    assert all(peak["rate"] > 0 for peak in facts["peaks"].values())
    assert facts["machine"]["cores"] >= 1
    assert facts["houses"] == 4
    for row in facts["rows"]:
        if row["by"] == "dc2g_jax":
            assert row["missing"] is None, row
        if row["missing"] is not None:
            assert row["missing"].startswith("not available: "), row
        else:
            assert row["rate"] >= row["worst_rate"] > 0
        assert all(share > 0 for share in row["shares"].values())
        for agreement in ("same actions", "same answer"):
            assert row["facts"].get(agreement, 1.0) == 1.0, row
    return facts


@pytest.mark.slow
def test_quick_benchmark_of_one_section(tmp_path):
    options = ("--quick", "--repeats", 1, "--dataset", "procedural", "--only", "environment")
    result = run(*options, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    facts = facts_of(tmp_path / "out")
    assert {row["section"] for row in facts["rows"]} == {"environment"}
    table = (tmp_path / "out" / "benchmark.md").read_text()
    assert f"## {SECTIONS['environment']}" in table
    assert f"## {SECTIONS['planners']}" not in table


@pytest.mark.release
def test_quick_benchmark_of_everything(tmp_path):
    result = run("--quick", "--repeats", 1, "--dataset", "procedural", "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    rows = facts_of(tmp_path / "out")["rows"]
    assert {row["section"] for row in rows} == set(get_args(Section))
    of_planners = {(row["what"], row["by"]) for row in rows if row["section"] == "planners"}
    assert {("oracle", "NumPy"), ("frontier", "C"), ("frontier", "Numba"), ("dc2g", "dc2g_jax")} <= of_planners
    table = (tmp_path / "out" / "benchmark.md").read_text()
    assert all(f"## {SECTIONS[section]}" in table for section in get_args(Section))
    assert "Whole episodes" in result.stdout


@pytest.mark.slow
def test_what_is_measured_of_an_accelerator_runs_on_a_cpu(tmp_path):
    options = ("--accelerator", "--quick", "--repeats", 1, "--dataset", "procedural")
    result = run(*options, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    facts = json.loads((tmp_path / "out" / "accelerator.json").read_text())
    assert not any(row["missing"] for row in facts["rows"])
    sections = list(dict.fromkeys(row["section"] for row in facts["rows"]))
    assert sections == ["golden", "batch", "fig7", "training", "translator", "searches"]
    assert facts["rows"][0]["facts"]["same actions"] == 1.0
    table = (tmp_path / "out" / "accelerator.md").read_text()
    assert all(f"## {SECTIONS[section]}" in table for section in sections)


def test_without_an_accelerator_one_line_says_so(tmp_path):
    with pytest.raises(InputError, match=r"--accelerator: JAX finds none.*--quick"):
        benchmark.main(benchmark.Options(accelerator=True, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_failures_and_lack_of_time_or_memory_are_rows(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(accelerator.time, "monotonic", lambda: now[0])

    def rows(*taken: float, fails: str = "") -> Iterator[Row]:
        for number, seconds in enumerate(taken):
            now[0] += seconds
            yield own("batch", str(number), "maps", rate=1.0)
        if fails:
            raise RuntimeError(fails)

    parts = (
        accelerator._Part("batch", 10, "--robots", lambda: rows(5, fails="RESOURCE_EXHAUSTED: Out of memory")),
        accelerator._Part("fig7", 10, "", lambda: rows(fails="it broke")),
        accelerator._Part("training", 90, "", lambda: rows(1)),
        accelerator._Part("searches", 10, "", lambda: rows(60, 60, 60)),
    )
    found = [(row.section, row.what, row.missing) for row in accelerator._in_time(parts, until=90.0)]
    rest = "all that is left of it"
    assert found == [
        ("batch", "0", None),
        ("batch", rest, "failed: RuntimeError: RESOURCE_EXHAUSTED: Out of memory; lower --robots"),
        ("fig7", rest, "failed: RuntimeError: it broke"),
        ("training", rest, "left out: 85 s are left; give more --minutes"),
        ("batch", "0", None),
        ("batch", "1", None),
        ("searches", rest, "left out: 0 s are left; give more --minutes"),
    ]


@pytest.mark.parametrize("option", ["repeats", "starts_per_house"])
def test_nothing_to_measure_is_refused(option, tmp_path):
    options = benchmark.Options(**{option: 0}, dataset="procedural", out=tmp_path / "out")
    refusal(lambda: benchmark.main(options), f"--{option.replace('_', '-')} 0")
    assert not (tmp_path / "out").exists()


def test_medians_and_worsts(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])
    taken = iter([20.0, 3.0, 1.0, 2.0, 9.0, 2.5])

    def call() -> None:
        now[0] += next(taken)

    measured = measure(call, repeats=5, shortest_repeat=0.0)
    assert (measured.median, measured.worst, measured.first, measured.repeats) == (2.5, 9.0, 20.0, 5)


def test_measuring_calls_and_keeps_the_output():
    calls = []

    def call() -> jax.Array:
        calls.append(1)
        return jnp.arange(4)

    measured = measure(call, repeats=3, shortest_repeat=0.0)
    assert len(calls) == 1 + 3  # the first, and the repeats
    assert measured.repeats == 3
    assert 0 < measured.median <= measured.worst
    assert measured.peak_memory > 0
    np.testing.assert_array_equal(measured.output, range(4))


def test_checksums_tell_outputs_apart():
    one = {"a": np.arange(3), "b": np.array([1.0, np.inf])}
    assert checksum(one) == checksum({"a": jnp.arange(3), "b": jnp.array([1.0, jnp.inf])})
    assert checksum(one) != checksum({"a": np.arange(3), "b": np.array([2.0, np.inf])})
    assert checksum(one) != checksum({"a": np.arange(4), "b": np.array([1.0, np.inf])})


def test_rates_follow_from_seconds():
    measured = measure(lambda: np.ones(2), repeats=2, shortest_repeat=0.0)
    row = Row("kernels", "what", by="NumPy", unit="maps").with_figures(measured, 10.0)
    assert row.rate == pytest.approx(10.0 / measured.median)
    assert row.worst_rate == pytest.approx(10.0 / measured.worst)


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (BaselineUnavailable("no C compiler"), "not available: no C compiler"),
        (ModuleNotFoundError("No module named 'numba'"), "not available: No module named 'numba'"),
        (TooLarge("needs 99 GiB"), "left out: needs 99 GiB"),
        (RuntimeError("it broke\nhere"), "failed: RuntimeError: it broke"),
    ],
)
def test_a_peer_that_cannot_run_is_a_row_that_says_why(error, reason):
    def fail() -> Row:
        raise error

    row = attempt(Row("kernels", "what", by="peer", unit="maps"), fail)
    assert row.missing == reason
    assert row.rate is None


def test_work_is_counted_through_loops():
    def countdown(x: jax.Array, mask: jax.Array) -> jax.Array:
        """`n` turns of one shift and one `or` on 8 words, `n` being the first word's value."""

        def turn(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            return carry[0] - 1, (carry[1] << 1) | mask

        return jax.lax.while_loop(lambda carry: carry[0] > 0, turn, (x[0], x))[1]

    x, mask = jnp.full(8, 5, jnp.uint32), jnp.ones(8, jnp.uint32)
    work = count_work(countdown, x, mask)
    # A turn: 8 shifts, 8 ors, one subtraction; 6 comparisons in all. Bytes: the mask, and the carry in and out.
    assert work.operations == 5 * (8 + 8 + 1) + 6
    a_turn, given_and_found = 32 + 2 * (32 + 4), 3 * 32
    assert work.bytes == 5 * a_turn + given_and_found
    assert count_work(lambda a, b: a & b, x, mask) == Work(operations=8, bytes=3 * 32)
    nested = jax.jit(lambda a, b: jax.lax.fori_loop(0, a[0].astype(jnp.int32), lambda _, c: countdown(c, b), a))
    assert count_work(nested, jnp.full(8, 1, jnp.uint32), mask).bytes == a_turn + given_and_found

    def one_after_another(rows: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda count, row: (count + 1, countdown(row, mask)), 0, rows)[1]

    assert count_work(one_after_another, jnp.stack([x, x - 2])).bytes == (5 + 3) * a_turn + 2 * 2 * 32


def test_compiled_programs_are_told_about():
    program, memory = compile_program(lambda a: (a @ a) ** 2, jnp.eye(8))
    np.testing.assert_array_equal(program(jnp.eye(8)), np.eye(8))
    assert memory >= 2 * 8 * 8 * 4


def test_the_machine_does_something():
    assert all(0 < peak.worst_rate <= peak.rate for peak in peaks(1, quick=True).values())


@pytest.mark.slow
def test_no_test_house_is_measured_with():
    workload = make_workload(procedural_dataset(), per_house=2, most_houses=3)
    assert {house.split for house in workload.houses} <= {"train", "val"}
    assert len(workload.starts) == 6
    assert [start.house for start in workload.starts[:3]] == [house.name for house in workload.houses]
    for cells in (25, 60):
        larger = resized(workload, cells, count=3)
        assert larger.terrain.shape == (3, cells, cells)
        assert len(larger.starts) == 3
