"""Networks and training states on disk, saved with Orbax and checked before they are believed."""

import contextlib
import dataclasses
import functools
import json
import logging
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from dc2g_jax.errors import InputError
from dc2g_jax.estimation import networks
from dc2g_jax.estimation.estimators import NetworkCostToGo
from dc2g_jax.estimation.networks import Architecture
from dc2g_jax.estimation.training import TrainingConfig, TrainingState, init_state
from dc2g_jax.grid.terrain import CLASS_NAMES

_CARD = "network.json"
_WEIGHTS = "weights"
_CONFIG = "config.json"
_NETWORK = "compact_unet"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Orbax's progress reports, which go to absl's logger, out of the way."""
    loggers = [logging.getLogger(name) for name in ("absl", "asyncio")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def save_network(folder: str | Path, network: NetworkCostToGo, card: dict[str, Any] | None = None) -> Path:
    """Save a network: `network.json` (what it is) and `weights/` (Orbax). Replaces a network already there.

    Args:
      folder: where to save.
      network: what to save.
      card: further facts about the network for `network.json`: data, seed, command, metrics.
    """
    folder = Path(folder).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f".{_WEIGHTS}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    with _quiet(), ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save(partial, jax.tree.map(np.asarray, network.weights))
    # A note by Orbax that names the folder on this machine; nothing reads it.
    (partial / "commit_success.txt").unlink(missing_ok=True)
    shutil.rmtree(folder / _WEIGHTS, ignore_errors=True)
    partial.rename(folder / _WEIGHTS)
    facts = {
        "network": _NETWORK,
        "architecture": dataclasses.asdict(network.architecture),
        "classes": list(CLASS_NAMES),
        **(card or {}),
    }
    (folder / _CARD).write_text(json.dumps(facts, indent=2) + "\n")
    return folder


def _read_json(path: Path, remedy: str) -> dict[str, Any]:
    try:
        facts = json.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(f"{path}: not found; {remedy}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); {remedy}") from None
    if not isinstance(facts, dict):
        raise InputError(f"{path}: holds no JSON object; {remedy}")
    return facts


def _read_card(folder: Path) -> Architecture:
    """The architecture of a saved network, once it is sure that this package can run it."""
    remedy = "give a folder written by `python -m experiments.train`"
    facts = _read_json(folder / _CARD, remedy)
    if facts.get("network") != _NETWORK:
        raise InputError(
            f"{folder / _CARD}: the network is {facts.get('network')!r}, but this planner runs {_NETWORK!r}; {remedy}"
        )
    if facts.get("classes") != list(CLASS_NAMES):
        raise InputError(f"{folder / _CARD}: the network was trained on another list of terrain classes; train it anew")
    architecture: Any = facts.get("architecture")
    try:
        known = Architecture(
            widths=tuple(int(width) for width in architecture["widths"]),
            quantiles=tuple(float(level) for level in architecture["quantiles"]),
            cost_scale=float(architecture["cost_scale"]),
        )
        networks.weight_shapes(known)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder / _CARD}: architecture {architecture!r} is not one of this network's ({error}); {remedy}"
        ) from None
    return known


def _shapes(tree: Any) -> dict[str, tuple[int, ...]]:
    return {jax.tree_util.keystr(path): tuple(leaf.shape) for path, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def load_network(folder: str | Path) -> NetworkCostToGo:
    """Load a network saved by `save_network`.

    Raises:
      InputError: if there is none, it cannot be read, or its weights are those of another architecture.
    """
    folder = Path(folder).absolute()
    architecture = _read_card(folder)
    wanted = networks.weight_shapes(architecture)
    if not (folder / _WEIGHTS / "_CHECKPOINT_METADATA").is_file():
        raise InputError(f"{folder / _WEIGHTS}: holds no weights; save or copy the network again")
    try:
        with _quiet(), ocp.StandardCheckpointer() as checkpointer:
            metadata = checkpointer.metadata(folder / _WEIGHTS).item_metadata
            if metadata is None:
                raise ValueError("its list of arrays is missing or damaged")
            found = metadata.tree
            differing = sorted(set(_shapes(wanted).items()) ^ set(_shapes(found).items()))
            if differing:
                name = differing[0][0]
                raise InputError(
                    f"{folder / _WEIGHTS}: weights of another architecture: {name} has shape "
                    f"{_shapes(found).get(name, 'none')}, but {_CARD} asks for {_shapes(wanted).get(name, 'none')}; "
                    "keep the two files of one training together"
                )
            weights = checkpointer.restore(folder / _WEIGHTS, wanted)
    except InputError:
        raise
    except Exception as error:  # Orbax raises many kinds for a damaged checkpoint
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(f"{folder / _WEIGHTS}: cannot be read ({reason}); save or copy the network again") from None
    return NetworkCostToGo(weights=weights, architecture=architecture)


class TrainingCheckpoints:
    """Training states of one run in a folder; the newest few are kept.

    Args:
      folder: where they are.
      config: how the run trains. A folder that holds states of another configuration is refused.
      facts: whatever else must be the same for a run to be resumed, such as the data; a JSON object.

    Raises:
      InputError: if the folder holds a run of another configuration.
    """

    def __init__(self, folder: str | Path, config: TrainingConfig, facts: dict[str, Any] | None = None):
        self._config = config
        folder = Path(folder).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        wanted = json.loads(json.dumps({**dataclasses.asdict(config), **(facts or {})}))
        if (folder / _CONFIG).exists():
            found = _read_json(folder / _CONFIG, "give another folder")
            changed = [name for name in wanted if found.get(name) != wanted[name]]
            if changed:
                raise InputError(
                    f"{folder / _CONFIG}: {changed[0]} was {found.get(changed[0])!r} in the run that is there, "
                    f"now {wanted[changed[0]]!r}; give the same options to resume it, or another folder"
                )
        (folder / _CONFIG).write_text(json.dumps(wanted, indent=2) + "\n")
        with _quiet():
            self._manager = ocp.CheckpointManager(
                folder / "states", options=ocp.CheckpointManagerOptions(max_to_keep=2, create=True)
            )

    def restore(self) -> TrainingState | None:
        """The newest state, or `None` where there is none."""
        step = self._manager.latest_step()
        if step is None:
            return None
        template = jax.eval_shape(functools.partial(init_state, self._config.recipe), self._config.hyperparameters)
        with _quiet():
            return self._manager.restore(step, args=ocp.args.StandardRestore(template))

    def save(self, state: TrainingState) -> None:
        """Save a state; returns when it is on disk."""
        with _quiet():
            self._manager.save(int(state.step), args=ocp.args.StandardSave(state))
            self._manager.wait_until_finished()

    def close(self) -> None:
        """Release the folder."""
        self._manager.close()
