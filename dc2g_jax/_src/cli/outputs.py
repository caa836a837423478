"""Output folders of commands, with a record of how to reproduce them."""

import dataclasses
import datetime
import functools
import importlib.metadata
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

from dc2g_jax._src.files.atomic import clear_unfinished, is_unfinished, write_json
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.runtime.errors import InputError, short

if sys.platform != "win32":
    import fcntl

#: File in every output folder that records how it was made.
RUN_FILE = "run.json"


@dataclasses.dataclass(frozen=True, kw_only=True)
class CommandOptions:
    """Options of a command."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machines:
    """Devices and processes that share the work. They do not affect the results.

    Attributes:
      devices: number of accelerators, or of CPU cores, to use in each process; all by default.
      coordinator: host:port of the first of several processes that share the work; by default, Slurm, Open MPI,
        Kubernetes or a TPU pod provides it.
      num_processes: number of processes.
      process_id: index of this process, from 0.
    """

    devices: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    coordinator: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None
    num_processes: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    process_id: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None


#: Most bytes of it: each time that a run is resumed adds some.
_LARGEST_RECORD = 2**24

#: Options that may always change when a run is resumed.
WHERE = ("out", "resume", "track", *(field.name for field in dataclasses.fields(Machines)))

#: Folders that this process writes to, as absolute paths in order, each with the open file that locks it.
_held: dict[Path, int | None] = {}


def output_folder(
    options: Any, command: str, *, free: Collection[str] = (), inputs: Mapping[str, str] | None = None
) -> Path:
    """Make or reopen the output folder, with a `run.json` of the command, all options, versions, commit and time.

    Nothing is overwritten: the folder must be empty, except for `--resume` with the same options as before. In that
    case, `run.json` lists each resumption.

    Args:
      options: options of the command. `out` is the folder; if it is `None`, a new one under outputs/. With a field
        `resume`, runs can be resumed.
      command: name of the command.
      free: further options that may change when a run is resumed.
      inputs: option name -> SHA-256 of its data. They must be the same when a run is resumed.

    Raises:
      InputError: the folder is in use or cannot be written, or holds no such run to resume.
    """
    resume = bool(getattr(options, "resume", False))
    folder = options.out
    if folder is None:
        if resume:
            raise InputError("--resume: which run? give the --out folder that it writes to")
        folder = Path("outputs") / f"{command}-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    run = {
        "command": command_written(),
        "began": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "versions": versions(),
    }
    if getattr(options, "dataset", "") is None and (location := os.environ.get("DC2G_DATA")):
        run["DC2G_DATA"] = location  # where houses are read from, if no option says it
    facts = {"experiment": command, "options": _plain_options(options), "inputs": dict(inputs or {}), "runs": [run]}
    try:
        if resume:
            before = _read_run(folder)
            alone = _hold(folder)
            _require_same(folder, before, facts, {*WHERE, *free})
            facts["runs"] = [*before["runs"], run]
        else:
            _make_new(folder, resumable=hasattr(options, "resume"))
            alone = _hold(folder)
        if alone:
            clear_unfinished(folder)
        write_json(folder / RUN_FILE, facts)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); give --out another folder") from None
    return folder


def _make_new(folder: Path, *, resumable: bool) -> None:
    """Make a folder, which must not exist or be empty. A run may have been killed before it wrote its first file."""
    if folder.exists() and not (folder.is_dir() and all(map(is_unfinished, folder.iterdir()))):
        remedy = "; to go on with the run in it, add --resume" if resumable and (folder / RUN_FILE).exists() else ""
        raise InputError(f"{folder}: is not an empty folder; give --out a new folder{remedy}")
    folder.mkdir(parents=True, exist_ok=True)


def _hold(folder: Path) -> bool:
    """Lock a folder until this process ends. Returns whether the system can."""
    folder = folder.resolve()
    if folder in _held:
        return _held[folder] is not None
    held = None
    if sys.platform != "win32":
        held = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(held)
            raise InputError(
                f"{folder}: another process is writing to it; wait for its end, or give --out another folder"
            ) from None
        except OSError:  # a file system without locks
            os.close(held)
            held = None
    _held[folder] = held
    return held is not None


def folder_in_use() -> Path | None:
    """The last output folder of this process, or `None`."""
    return next(reversed(_held), None)


def _plain_options(options: Any) -> dict[str, Any]:
    """Options as JSON values: paths as strings, tuples as lists, options of a group as `group.name`."""
    plain: dict[str, Any] = {}
    for name, value in json.loads(json.dumps(dataclasses.asdict(options), default=str)).items():
        plain |= {f"{name}.{part}": one for part, one in value.items()} if isinstance(value, dict) else {name: value}
    return plain


def _read_run(folder: Path) -> dict[str, Any]:
    path = folder / RUN_FILE
    remedy = "the run cannot be resumed; begin anew in another --out folder"
    if not path.exists():
        raise InputError(f"{folder}: holds no run to resume; leave out --resume to begin one")
    facts = read_object(path, remedy, at_most=_LARGEST_RECORD)
    for name, kind in (("options", dict), ("inputs", dict), ("runs", list)):
        if not isinstance(facts.get(name), kind):
            raise InputError(f"{path}: {name} is {short(facts.get(name))}; {remedy}")
    return facts


def _require_same(folder: Path, before: dict[str, Any], now: dict[str, Any], free: Collection[str]) -> None:
    """Check that a run is resumed with the options and the inputs of its record, except for `free` options."""
    if before.get("experiment") != now["experiment"]:
        raise InputError(
            f"{folder}: holds a run of {short(before.get('experiment'))}, not of {now['experiment']}; give --out "
            "another folder"
        )
    for name, value in now["options"].items():
        if name.rpartition(".")[2] not in free and before["options"].get(name) != value:
            option, then = f"--{name.rpartition('.')[2].replace('_', '-')}", before["options"].get(name)
            begun = f"without {option}" if then is None else f"with {option} {short(then)}"
            raise InputError(
                f"{folder}: was begun {begun}, now it is {short(value)}; resume it with the same options, or give "
                "--out another folder"
            )
    for name, digest in now["inputs"].items():
        if before["inputs"].get(name) != digest:
            told = " (or for DC2G_DATA)" if name == "dataset" else ""
            raise InputError(
                f"{folder}: what is read for --{name.replace('_', '-')}{told} has changed since it was begun; bring it "
                "back to resume the run, or give --out another folder"
            )


def print_files(out: Path) -> None:
    """Print the names of the files in an output folder, and how to open its recordings."""
    print(f"Written to {out}: {', '.join(sorted(path.name for path in out.iterdir()))}")
    for recording in out.glob("*.rrd"):
        print(f"Step through it: rerun {recording}")


def program() -> str:
    """The running command as typed: `dc2g NAME` or `python -m experiments.MODULE`."""
    if sys.argv[0].startswith("dc2g "):
        return sys.argv[0]
    module = getattr(sys.modules["__main__"], "__spec__", None)
    return f"python -m {module.name if module else Path(sys.argv[0]).stem}"


def command_written() -> str:
    """The command line as typed, with its options."""
    return " ".join([program(), *map(shlex.quote, sys.argv[1:])])


@functools.cache
def commit() -> str:
    """The git commit of the code, followed by `+` if files have changed; `unknown` without a repository or git."""

    def asked(*command: str) -> str:
        here = Path(__file__).parent
        try:
            return subprocess.run(
                ["git", *command], capture_output=True, text=True, check=False, cwd=here
            ).stdout.strip()
        except OSError:
            return ""

    changed = asked("status", "--porcelain", "--untracked-files=no")
    return (asked("rev-parse", "HEAD") or "unknown") + ("+" if changed else "")


def versions() -> dict[str, str]:
    """Versions of Python and the packages that results depend on, and the device."""
    found = {name: importlib.metadata.version(name) for name in ("dc2g_jax", "jax", "flax", "numpy")}
    python = ".".join(str(part) for part in sys.version_info[:3])
    return {"python": python, **found, "device": jax.devices()[0].device_kind}
