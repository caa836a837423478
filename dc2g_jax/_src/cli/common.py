"""Shared by all commands: parsing of options, errors and interruptions, networks."""

import atexit
import dataclasses
import errno
import os
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn, TextIO, TypeVar

import jax
import tyro
from jax.experimental import multihost_utils
from tqdm import tqdm

from dc2g_jax._src.cli.outputs import RUN_FILE, CommandOptions, folder_in_use, program
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.files.cache import keep_compiled_programs
from dc2g_jax._src.files.digests import tree_sha256
from dc2g_jax._src.planning.named import NETWORK_PLANNERS, check_names
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.runtime.devices import join_processes, use_devices
from dc2g_jax._src.runtime.errors import InputError, check_seed, drop_output, reader_may_leave
from dc2g_jax._src.training.tracking import check_tracker

_Options = TypeVar("_Options", bound=CommandOptions)

#: Common options: a folder of houses (or a name), and a network (see `estimation.hub.load_network`).
DatasetOption = Annotated[str | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")]
NetworkOption = Annotated[str | Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")]

#: Planners: names in `planning.named.PLANNERS`, or `package.module:Name`.
PlannersOption = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")]

#: Rules: a name in `planning.rules.SETTINGS`, or `package.module:Name`.
SettingsOption = Annotated[str, tyro.conf.arg(metavar="NAME")]

#: Width of the field of view in degrees; `None` for that of the settings.
FieldOfViewOption = Annotated[float | None, tyro.conf.arg(metavar="DEGREES", help_behavior_hint="(default: 90)")]

#: Size of a camera's images in pixels.
ImageSizeOption = Annotated[tuple[int, int], tyro.conf.arg(metavar="WIDTH HEIGHT")]


def command_line(options: type[_Options], main: Callable[[_Options], None]) -> None:
    """Run a command: parse its options; report invalid input, lack of memory and Ctrl-C in one line with a status."""
    stderr = sys.stderr  # of every process; only the first goes on to print there
    with reader_may_leave():
        parsed = tyro.cli(options, prog=program(), config=(tyro.conf.FlagCreatePairsOff,))
    try:
        machine = getattr(parsed, "machine", None)
        if machine is not None:
            join_processes(machine.coordinator, machine.num_processes, machine.process_id)
        use_devices(None if machine is None else machine.devices)
        if jax.distributed.is_initialized():
            parsed = _silent_unless_first(parsed)
        keep_compiled_programs()
        check_seed(getattr(parsed, "seed", 0), "--seed")
        check_tracker(getattr(parsed, "track", None))
        main(parsed)
        sys.stdout.flush()
    except InputError as error:
        _leave(2, f"error: {error}", stderr)
    except KeyboardInterrupt:
        _leave(130, f"interrupted{_to_go_on(parsed)}", sys.stderr)
    except BrokenPipeError:
        drop_output()
        _leave(141, f"nobody reads the output any more{_to_go_on(parsed)}", sys.stderr)
    except Exception as error:
        of_jax, what = isinstance(error, jax.errors.JaxRuntimeError), str(error).partition("\n")[0]
        if full := _full_disk(error):
            _leave(2, f"error: {full}; make room on the disk{_to_go_on(parsed)}", stderr)
        if (of_jax and what.startswith("RESOURCE_EXHAUSTED")) or isinstance(error, MemoryError):
            _leave(2, f"error: a device is out of memory; {_less_memory(parsed)} ({what})", stderr)
        if not jax.distributed.is_initialized():
            raise
        # What is lost while a program starts is a ValueError.
        if of_jax or "Gloo" in what:
            _leave(1, f"error: process {jax.process_index()} lost the others ({what}); start all again", stderr)
        traceback.print_exc(file=stderr)
        _leave(1, f"error: process {jax.process_index()}: {type(error).__name__}, see above", stderr)


def _silent_unless_first(parsed: _Options) -> _Options:
    """Let only the first process print and write: the others are silent and write to a temporary copy of the folder."""
    if jax.process_index() > 0:
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
        if hasattr(parsed, "out"):
            # The name of the folder stays the same, since files are named after it.
            copy = Path(tempfile.mkdtemp()) / Path(parsed.out or "out").name
            atexit.register(shutil.rmtree, copy.parent, ignore_errors=True)
            if getattr(parsed, "resume", False) and Path(parsed.out).is_dir():
                shutil.copytree(parsed.out, copy)
            changed: dict[str, Any] = {"out": copy}
            parsed = dataclasses.replace(parsed, **changed)
    multihost_utils.sync_global_devices("copied")
    return parsed


def _to_go_on(parsed: CommandOptions) -> str:
    """How to go on with an interrupted run; empty if it cannot be resumed."""
    folder = folder_in_use()
    if not hasattr(parsed, "resume") or folder is None or not (folder / RUN_FILE).exists():
        return ""
    where = "" if getattr(parsed, "out", None) else f" --out {folder}"
    return f"; what was written is kept: the same command with --resume{where} goes on"


def _full_disk(error: BaseException | None) -> str:
    """The reason why nothing could be written, if an error or what it came from says so; else empty."""
    reasons = [os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)]
    while error is not None:
        # Orbax and TensorStore raise errors of their own, with the system's words in them.
        for reason in reasons:
            if reason in str(error):
                return f"{getattr(error, 'filename', None) or folder_in_use() or 'a file'}: {reason.lower()}"
        error = error.__cause__ or error.__context__
    return ""


def _less_memory(parsed: CommandOptions) -> str:
    options = [f"--{name.replace('_', '-')}" for name in ("runs_at_once", "batch_size") if hasattr(parsed, name)]
    return f"lower {' or '.join(options)}" if options else "end other programs that use it, or take smaller maps"


def _leave(status: int, line: str, stream: TextIO) -> NoReturn:
    """Print one line and exit. If several processes work together, do not wait for the others; they end too."""
    # Otherwise they would be drawn again, below the line.
    for bar in list(getattr(tqdm, "_instances", ())):
        bar.close()
    print(line, file=stream, flush=True)
    if jax.distributed.is_initialized():
        sys.stdout.flush()
        os._exit(status)
    sys.exit(status)


def check_planners(planners: Sequence[str]) -> None:
    """Check the planners of a command.

    Raises:
      InputError: there are none, or one is repeated or unknown.
    """
    if not planners or len(set(planners)) < len(planners):
        raise InputError(f"--planner {' '.join(planners)}: give each planner once, one at least")
    check_names(planners)


def network_for(planners: Iterable[str], place: str | Path | None) -> Estimator | None:
    """The network in a place, see `estimation.hub.load_network`; `None` if no planner uses a network."""
    return load_network(place) if NETWORK_PLANNERS.keys() & set(planners) else None


def digests(dataset: HouseDataset | None = None, **inputs: Any) -> dict[str, str]:
    """SHA-256 of the dataset and of trees of arrays, such as networks, by option. `None` is left out."""
    houses = {} if dataset is None else {"dataset": dataset.sha256}
    return houses | {name: tree_sha256(tree) for name, tree in inputs.items() if tree is not None}
