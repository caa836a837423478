"""Options that several commands share, as base classes of their `Options`."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from dc2g_jax._src.cli.common import DatasetOption, NetworkOption
from dc2g_jax._src.cli.outputs import CommandOptions, Machines
from dc2g_jax._src.runtime.errors import check_number
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.tracking import TrackerName

#: A whole number that may be left out.
OptionalInt = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")]


@dataclasses.dataclass(frozen=True, kw_only=True)
class DatasetOptions(CommandOptions):
    """Houses to run on.

    Attributes:
      dataset: folder of houses, of maps or of OpenStreetMap extracts; procedural, towns, mazes, halls, offices or
        floor_plans; package.module:Name for one of your own; the published houses by default, from DC2G_DATA, the
        cache or a download.
    """

    dataset: DatasetOption = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworkOptions(CommandOptions):
    """A network for the planners that use one.

    Attributes:
      network: folder of a trained network, or hf://owner/name; several with commas between them for the mean of their
        predictions; package.module:Name for an estimator of your own; the shipped network by default.
    """

    network: NetworkOption = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class StepLimitOptions(CommandOptions):
    """The length of episodes.

    Attributes:
      step_limit: actions after which an episode ends without success; by default 500, and more on larger maps and where
        ways to the goal are long.
    """

    step_limit: OptionalInt = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutOptions(CommandOptions):
    """A folder to write to.

    Attributes:
      out: folder to write to; a new one under outputs/ by default.
    """

    out: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class SharedOptions(CommandOptions):
    """Work that devices and processes can share.

    Attributes:
      machine: where the command runs; it does not affect the results.
    """

    machine: tyro.conf.OmitArgPrefixes[Machines] = dataclasses.field(default_factory=Machines)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ResumeOptions(SharedOptions):
    """Runs that can be resumed.

    Attributes:
      resume: continue the run in `out` where it stopped. It must have been started with the same options.
    """

    resume: bool = False


@dataclasses.dataclass(frozen=True)
class _Data(DataConfig):
    """The same, as its help shows it."""

    extra_houses: OptionalInt = None
    starts_per_house: OptionalInt = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class DataOptions(CommandOptions):
    """Data of a training. As the last base of a command's options, it stands before what is said of machines.

    Attributes:
      data: houses and masks.
    """

    data: tyro.conf.OmitArgPrefixes[_Data] = dataclasses.field(default_factory=_Data)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingOptions(ResumeOptions):
    """Training runs.

    Attributes:
      out: folder for checkpoints, networks, logs and figures.
      track: tracker to send curves and pictures to: tensorboard, wandb or trackio; none by default.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    track: Annotated[TrackerName | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None


def require_positive(options: object, *names: str) -> None:
    """Check that options are at least 1; those that are `None` are skipped.

    Raises:
      InputError: one is not; the message names it.
    """
    for name in names:
        value = getattr(options, name)
        if value is not None:
            check_number(f"--{name.replace('_', '-')}", value, whole=True, least=1)
