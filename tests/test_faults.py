"""Every command that can be resumed ends as if nothing had happened, wherever in its writing there was a fault.

    pytest -n 0 -rP -m release tests/test_faults.py

tries every point, and says how many there were; without `release`, a few of two commands. To try one point alone:

    FAULT_AT=train:dies:17 pytest -n 0 -m release tests/test_faults.py
"""

import collections
import contextlib
import importlib
import io
import json
import os
from pathlib import Path
from typing import Any

import pytest

from dc2g_jax._src.cli.common import _full_disk
from dc2g_jax._src.cli.options import ResumeOptions
from dc2g_jax._src.cli.outputs import RUN_FILE
from dc2g_jax._src.files.atomic import is_unfinished
from dc2g_jax._src.runtime.errors import InputError
from tests.support import commands
from tests.support.faults import FAULTS, Death, Fault, faulty, points
from tests.support.resumable import COMMANDS, Command, write_houses

#: What `FAULT_AT` asks for: a command, a fault, the number of an operation.
ASKED = os.environ.get("FAULT_AT", "").split(":")

#: Facts of `results.json` that differ from run to run.
TIMES = ("seconds", "milliseconds")


@pytest.fixture
def houses(tmp_path) -> str:
    write_houses(tmp_path / "houses")
    return str(tmp_path / "houses")


def contents(out: Path) -> dict[str, Any]:
    """What a finished run has written, but for its times, its history and the format of its training states."""
    found: dict[str, Any] = {}
    for path in sorted(out.rglob("*")):
        name = str(path.relative_to(out))
        if path.is_dir() or path.name == RUN_FILE or "states" in path.parts:
            continue
        assert not is_unfinished(path)
        if path.name == "log.jsonl":  # an interrupted validation is repeated
            lines = [json.loads(line) for line in path.read_text().splitlines() if line.endswith("}")]
            found[name] = {(line.get("run"), line["step"]): line for line in lines}
        elif path.name == "results.json":
            found[name] = {key: fact for key, fact in json.loads(path.read_text()).items() if key not in TIMES}
        else:
            found[name] = path.read_bytes()
    return found


def quietly(command: Command, out: Path, resume: bool) -> None:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        command(out, resume)


def interrupted(command: Command, out: Path, fault: Fault, at: int) -> bool:
    """Run a command with a fault. Returns whether that ended it."""
    with faulty(out, fault, at) as disk:
        try:
            quietly(command, out, False)
        except Death:
            assert fault == "dies"
        except Exception as error:
            one_line = fault == "fails" or isinstance(error, InputError) or _full_disk(error)
            assert fault != "dies" and one_line, "no line for the user"  # noqa: PT018
        else:
            return fault == "dies" and len(disk.operations) > at  # Orbax writes a file more or less
    return True


def survives(command: Command, out: Path, fault: Fault, at: int) -> dict[str, Any]:
    """What a command has written in the end that met a fault and was resumed; or begun anew, where nothing was kept."""
    if interrupted(command, out, fault, at):
        quietly(command, out, (out / RUN_FILE).exists())
    return contents(out)


def try_all(name: str, houses: str, folder: Path, patch: pytest.MonkeyPatch, every: int = 1) -> None:
    command = COMMANDS[name](houses, folder, patch)
    with faulty(folder / "whole") as disk:
        quietly(command, folder / "whole", False)
    whole = contents(folder / "whole")
    tried, failures = collections.Counter[str](), list[str]()
    for fault in FAULTS:
        for at in points(disk.operations, fault)[::every]:
            if ASKED != [""] and [name, fault, str(at)] != ASKED:
                continue
            replay = f"FAULT_AT={name}:{fault}:{at} ({disk.operations[at]})"
            try:
                assert survives(command, folder / f"{fault}-{at}", fault, at) == whole, "another end"
            except (Exception, Death) as error:
                failures.append(f"{replay}: {type(error).__name__}: {error}")
            tried[fault] += 1
    print(f"{name}: {len(disk.operations)} operations, {dict(tried)}")
    assert not failures, "\n".join(failures)


def test_every_command_that_can_be_resumed_is_tried():
    options = {module: importlib.import_module(module).Options for module in commands.COMMANDS.values()}
    resumable = {module.rpartition(".")[2] for module, one in options.items() if issubclass(one, ResumeOptions)}
    resumable -= {"sweep_losses"}  # it is `sweep`, with other defaults
    assert resumable == COMMANDS.keys() - {"objectnav_train_with_encoder"}


def test_a_command_that_writes_in_place_is_found_out(tmp_path):
    def command(out: Path, resume: bool) -> None:
        out.mkdir(exist_ok=True)
        if not (out / "table.csv").exists():
            (out / "table.csv").write_text("x\n1\n2\n")

    with faulty(tmp_path / "whole") as disk:
        command(tmp_path / "whole", False)
    assert disk.operations == ["mkdir .", "open table.csv", "write table.csv"]
    for fault in FAULTS:
        ends = [survives(command, tmp_path / f"{fault}-{at}", fault, at) for at in range(3)]
        assert ends == [{"table.csv": b"x\n1\n2\n"}, *ends[1:]]
        assert ends[2] == {"table.csv": b"x\n1"}, fault


@pytest.mark.parametrize(("name", "every"), [("run_episodes", 1), pytest.param("train", 30, marks=pytest.mark.slow)])
def test_a_few_faults(name, every, houses, tmp_path, monkeypatch):
    try_all(name, houses, tmp_path, monkeypatch, every)


@pytest.mark.release
@pytest.mark.parametrize("name", COMMANDS)
def test_all_faults(name, houses, tmp_path, monkeypatch):
    try_all(name, houses, tmp_path, monkeypatch)
