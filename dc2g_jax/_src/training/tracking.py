"""Curves of a training: `curve.csv`, and trackers (TensorBoard, Weights & Biases, Trackio)."""

import contextvars
import functools
import secrets
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import UInt8

from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.files.tables import table_lines, write_table
from dc2g_jax._src.runtime.errors import InputError, require_extra

#: Names of trackers, and of the extras that install their packages.
TrackerName = Literal["tensorboard", "wandb", "trackio"]

#: The project, for trackers that collect the runs of several folders.
_PROJECT = "dc2g_jax"

Image = UInt8[np.ndarray, "h w 3"]


class Tracker(NamedTuple):
    """Shows the curves of one run.

    Attributes:
      log: `(step, figures)` adds a point to each of the curves, name -> value.
      image: `(step, name, array)` adds a picture, RGB.
      close: sends or writes the rest.
    """

    log: Callable[[int, Mapping[str, float]], None]
    image: Callable[[int, str, Image], None]
    close: Callable[[], None]


def _tensorboard(folder: Path, run: str, config: Mapping[str, Any]) -> Tracker:
    """Event files in `folder`. A resumed run adds a file, which TensorBoard shows with the first."""
    from tensorboardX import SummaryWriter

    # A thread writes every second (two minutes by default), so a killed process loses little.
    writer = SummaryWriter(str(folder / run), filename_suffix=f".{secrets.token_hex(4)}", flush_secs=1)

    def log(step: int, figures: Mapping[str, float]) -> None:
        for name, value in figures.items():
            writer.add_scalar(name, value, step)

    return Tracker(log, lambda step, name, array: writer.add_image(name, array, step, dataformats="HWC"), writer.close)


def _online(module: Any, run: Any) -> Tracker:
    """A run of wandb or trackio, whose interfaces are alike. A resumed run continues."""
    return Tracker(
        log=lambda step, figures: run.log(dict(figures), step=step),
        image=lambda step, name, array: run.log({name: module.Image(array)}, step=step),
        close=run.finish,
    )


def _kept_id(folder: Path, run: str) -> str:
    """The ID of a run at a service: made once, and kept in a file."""
    path = folder / f"{run or 'run'}.id"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(secrets.token_hex(4))
    return path.read_text()


def _wandb(folder: Path, run: str, config: Mapping[str, Any]) -> Tracker:
    import wandb

    out = folder.parent
    try:
        begun = wandb.init(
            project=_PROJECT,
            id=_kept_id(folder, run),
            name=run or out.name,
            group=out.name if run else None,
            dir=str(out),
            config=dict(config),
            resume="allow",
            reinit="create_new",  # runs that are trained together are open together
        )
    except wandb.Error as error:
        raise InputError(f"--track wandb: {error}; log in with `wandb login`, or set WANDB_MODE=offline") from None
    return _online(wandb, begun)


def _trackio(folder: Path, run: str, config: Mapping[str, Any]) -> Tracker:
    import trackio

    out = folder.parent
    begin = functools.partial(
        trackio.init,
        project=_PROJECT,
        name=f"{run or out.name}-{_kept_id(folder, run)}",
        group=out.name if run else None,
        config=dict(config),
        resume="allow",
        auto_log_cpu=False,
        auto_log_gpu=False,
    )
    # In a separate context: trackio ends an earlier run that it finds in its own.
    return _online(trackio, contextvars.copy_context().run(begin))


#: Open the tracker of a run, given its folder, the name of the run (empty for a single one) and its configuration.
_TRACKERS: dict[TrackerName, Callable[[Path, str, Mapping[str, Any]], Tracker]] = {
    "tensorboard": _tensorboard,
    "wandb": _wandb,
    "trackio": _trackio,
}


def check_tracker(name: TrackerName | None) -> None:
    """Check that the package of a tracker is installed.

    Raises:
      InputError: it is not.
    """
    if name is not None:
        require_extra("tensorboardX" if name == "tensorboard" else name, extra=name)


def run_folder(out: Path, run: str) -> Path:
    """The folder of one of the runs of a training, or of the only one, which has no name."""
    return out / "runs" / run if run else out


class Curve:
    """The curves of a training, or of several runs trained together: `curve.csv`, and a tracker of each run.

    The table has a row for each step, and each run if there are several. It is replaced atomically. A step that is
    repeated after an interruption replaces its earlier row, and is not sent to the tracker again.

    Args:
      out: folder of the training.
      runs: names of the runs trained together; a single one is called "".
      track: name of the tracker; `None` for the table alone.

    Raises:
      InputError: the table cannot be read, or the tracker cannot be used.
    """

    def __init__(self, out: Path, runs: Sequence[str] = ("",), track: TrackerName | None = None):
        self._path, self._runs = out / "curve.csv", runs
        self._rows: dict[tuple[int, str], dict[str, Any]] = {}
        if self._path.exists():
            for line, row in table_lines(self._path, ("step",), optional=None, remedy="delete it to begin a new one"):
                if not row["step"].isdecimal() or len(row["step"]) > 18:
                    raise InputError(f"{self._path}: line {line} has no step; delete the line")
                self._rows[int(row["step"]), row.get("run", "")] = row
        self._told = {key: {name for name, value in row.items() if value} for key, row in self._rows.items()}
        self._trackers: list[Tracker] = []
        if track is not None and jax.process_index() == 0:
            for run in self._runs:
                saved = run_folder(out, run) / "config.json"  # beside its checkpoints
                config = read_object(saved, "give another folder") if saved.exists() else {}
                self._trackers.append(_TRACKERS[track](out / track, run, config))

    def add(self, step: int, figures: Sequence[Mapping[str, Any]], group: str = "") -> None:
        """Add the figures of a step, and write the table.

        Args:
          step: optimizer steps taken.
          figures: name -> value for each run, in order. Values other than numbers are left out.
          group: prefix of the names in trackers.
        """
        for number, (run, found) in enumerate(zip(self._runs, figures, strict=True)):
            known = {name: float(f"{value:.6g}") for name, value in found.items() if isinstance(value, int | float)}
            self._rows.setdefault((step, run), {"step": step, **({"run": run} if run else {})}).update(known)
            told = self._told.get((step, run), ())
            new = {group + name: value for name, value in known.items() if name not in told}
            if self._trackers and new:
                self._trackers[number].log(step, new)
        columns = list(dict.fromkeys(name for row in self._rows.values() for name in row))
        write_table(self._path, columns, ([row.get(name, "") for name in columns] for row in self._rows.values()))

    def show(self, step: int, name: str, pictures: Sequence[Image]) -> None:
        """Send a picture of each run to its tracker, if this process has trackers."""
        for tracker, run, picture in zip(self._trackers, self._runs, pictures, strict=False):
            if (step, run) not in self._told:
                tracker.image(step, name, picture)

    def close(self) -> None:
        """Close the trackers."""
        for tracker in self._trackers:
            tracker.close()
