"""What every command shares: options from the command line, progress bars, output folders, the episodes table."""

import csv
import datetime
import functools
import importlib.metadata
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

import jax
import tyro
from tqdm import tqdm

from dc2g_jax.datasets.download import cache_folder
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import TrainedNetwork, load_network
from dc2g_jax.evaluation import EpisodeResult
from dc2g_jax.shipped import shipped

_Options = TypeVar("_Options")

#: The trained network that comes with the package.
SHIPPED_NETWORK = "weights/compact_unet"


def command_line(options: type[_Options], main: Callable[[_Options], None]) -> None:
    """Run a command: parse its options, and turn bad input and Ctrl-C into one line and an exit status."""
    parsed = tyro.cli(options)
    try:
        keep_compiled_programs()
        main(parsed)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


def keep_compiled_programs() -> None:
    """Keep compiled programs in the user's cache folder for later runs, unless JAX has been told where."""
    folder_option = "jax_compilation_cache_dir"
    if getattr(jax.config, folder_option) is None:
        jax.config.update(folder_option, str(cache_folder() / "compiled"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


class EpisodeProgress:
    """One progress bar after another, each of one planner's episodes; fed by `dc2g_jax.evaluation.Runner`."""

    def __init__(self) -> None:
        self._bar: tqdm | None = None

    def __call__(self, planner: str, finished: int, episodes: int) -> None:
        """Show that a planner has finished so many of its episodes."""
        if self._bar is None:
            self._bar = tqdm(total=episodes, desc=f"{planner:>16}", unit="episode", file=sys.stderr)
        self._bar.update(finished - self._bar.n)
        if finished >= episodes:
            self._bar.close()
            self._bar = None


def output_folder(chosen: Path | None, command: str) -> Path:
    """The folder to write to, made now; nothing that lies there is ever overwritten.

    Args:
      chosen: what the user asked for; `None` for a new folder below `outputs/`, named after the command and the time.
      command: name of the command.

    Raises:
      InputError: if the folder is in use or cannot be made.
    """
    if chosen is None:
        chosen = Path("outputs") / f"{command}-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    try:
        if chosen.exists() and (not chosen.is_dir() or any(chosen.iterdir())):
            raise InputError(f"{chosen}: is not an empty folder; give --out a new folder")
        chosen.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{chosen}: cannot be written ({error.strerror}); give --out another folder") from None
    return chosen


def open_network(folder: Path | None) -> TrainedNetwork:
    """The network in a folder, or the one that comes with the package."""
    return load_network(shipped(SHIPPED_NETWORK) if folder is None else folder)


@functools.cache
def commit() -> str:
    """The git commit of the code, with `+` after it where files have changed since; `unknown` outside a repository."""
    here = Path(__file__).parent
    found = [
        subprocess.run(["git", *command], capture_output=True, text=True, check=False, cwd=here).stdout.strip()
        for command in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
    ]
    return (found[0] or "unknown") + ("+" if found[1] else "")


def versions() -> dict[str, str]:
    """Versions of what a result depends on, and the device it was made on."""
    found = {name: importlib.metadata.version(name) for name in ("dc2g_jax", "jax", "flax", "numpy")}
    python = ".".join(str(part) for part in sys.version_info[:3])
    return {"python": python, **found, "device": jax.devices()[0].device_kind}


def write_episodes(path: Path, results: Iterable[EpisodeResult]) -> None:
    """Write `episodes.csv`: one line an episode and planner, `success` as 0 or 1, `extra` in percent."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(EpisodeResult._fields)
        for result in results:
            row = {**result._asdict(), "success": int(result.success), "extra": round(result.extra, 4)}
            writer.writerow(row.values())
