"""Networks (safetensors and a card) and training states (Orbax) on disk, checked before they are believed."""

import contextlib
import dataclasses
import functools
import json
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from dc2g_jax.errors import InputError, require_extra
from dc2g_jax.estimation.compact_unet import Architecture, CompactUNet
from dc2g_jax.estimation.estimators import NetworkCostToGo, TranslatorCostToGo
from dc2g_jax.estimation.pix2pix import Generator, TranslatorArchitecture
from dc2g_jax.estimation.weights import flattened, read_safetensors, read_weights, shapes_of_weights, write_safetensors
from dc2g_jax.files.atomic import write_json
from dc2g_jax.files.digests import arrays_sha256
from dc2g_jax.files.resources import resource
from dc2g_jax.grid.terrain import CLASS_NAMES

#: The trained networks that come with the package: for maps without errors, and for maps that a camera has made.
SHIPPED_NETWORK, SHIPPED_NOISY_NETWORK = "weights/compact_unet", "weights/compact_unet_noisy"

#: What a network is, written after its weights.
CARD = "network.json"
_WEIGHTS = "weights.safetensors"
_ORBAX_WEIGHTS = "weights"
_CONFIG = "config.json"
_STATES = "states"

TrainedNetwork = NetworkCostToGo | TranslatorCostToGo


class _Kind(NamedTuple):
    """A kind of network: the estimator it makes, how its card is read, and its class."""

    estimator: type[TrainedNetwork]
    read_architecture: Callable[[Any], Any]
    network: type[nnx.Module]


def _read_compact(facts: Any) -> Architecture:
    return Architecture(
        widths=tuple(int(width) for width in facts["widths"]),
        quantiles=tuple(float(level) for level in facts["quantiles"]),
        cost_scale=float(facts["cost_scale"]),
    )


def _read_translator(facts: Any) -> TranslatorArchitecture:
    return TranslatorArchitecture(
        size=int(facts["size"]), base_filters=int(facts["base_filters"]), compute_dtype=facts["compute_dtype"]
    )


_KINDS = {
    "compact_unet": _Kind(NetworkCostToGo, _read_compact, CompactUNet),
    "pix2pix": _Kind(TranslatorCostToGo, _read_translator, Generator),
}


def _orbax() -> Any:
    """Orbax, which takes a second to import and serves only training states and networks of version 0.1."""
    require_extra("orbax")
    import orbax.checkpoint

    return orbax.checkpoint


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


def _reason(error: Exception) -> str:
    """What Orbax says is wrong, in a part of a line."""
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__


def save_network(folder: str | Path, network: TrainedNetwork, card: dict[str, Any] | None = None) -> Path:
    """Save a network: `network.json` (what it is) and `weights.safetensors`. Replaces a network already there.

    Args:
      folder: where to save.
      network: what to save.
      card: further facts about the network for `network.json`: data, seed, command, metrics.
    """
    folder = Path(folder).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {name: np.asarray(leaf) for name, leaf in flattened(network.weights).items()}
    write_safetensors(folder / _WEIGHTS, tensors, {})
    facts = {
        "network": next(name for name, kind in _KINDS.items() if isinstance(network, kind.estimator)),
        "architecture": dataclasses.asdict(network.architecture),
        "classes": list(CLASS_NAMES),
        "sha256": arrays_sha256(network.weights),
        **(card or {}),
    }
    write_json(folder / CARD, facts)
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


def _read_card(folder: Path) -> tuple[_Kind, Any, str | None]:
    """Kind, architecture and digest of a saved network, once it is sure that this package can run it."""
    remedy = "give a folder written by `dc2g train` or `dc2g train-translator`"
    if (folder / "network" / CARD).exists():
        remedy = f"give {folder / 'network'}"
    facts = _read_json(folder / CARD, remedy)
    named = facts.get("network")
    kind = _KINDS.get(str(named))
    if kind is None:
        raise InputError(
            f"{folder / CARD}: {f'its network is {named!r}' if named else 'names no kind of network'}, but planners "
            f"take {' or '.join(_KINDS)}; {remedy}"
        )
    if facts.get("classes") != list(CLASS_NAMES):
        raise InputError(f"{folder / CARD}: the network was trained on another list of terrain classes; train it anew")
    architecture: Any = facts.get("architecture")
    try:
        known = kind.read_architecture(architecture)
        shapes_of_weights(kind.network, known)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder / CARD}: architecture {architecture!r} is not one of this network's ({error}); {remedy}"
        ) from None
    return kind, known, facts.get("sha256")


def _read_orbax_weights(path: Path, shapes: dict[str, Any]) -> dict[str, Any]:
    """Weights in a folder of Orbax, as version 0.1 wrote them."""
    ocp = _orbax()
    try:
        with _quiet(), ocp.StandardCheckpointer() as checkpointer:
            return checkpointer.restore(path, shapes)
    except Exception as error:  # Orbax raises many kinds for a damaged checkpoint
        raise InputError(f"{path}: cannot be read ({_reason(error)}); save or copy the network again") from None


def load_network(folder: str | os.PathLike[str] | None = None) -> TrainedNetwork:
    """Load a network of any kind saved by `save_network`.

    Args:
      folder: where it was saved; the network that comes with the package where `None`.

    Raises:
      InputError: if there is none, it cannot be read, or its weights are those of another architecture.
    """
    folder = Path(resource(SHIPPED_NETWORK) if folder is None else folder).absolute()
    kind, architecture, digest = _read_card(folder)
    shapes, path = shapes_of_weights(kind.network, architecture), folder / _WEIGHTS
    if not path.exists() and (folder / _ORBAX_WEIGHTS / "_CHECKPOINT_METADATA").is_file():
        path = folder / _ORBAX_WEIGHTS
        weights = _read_orbax_weights(path, shapes)
    else:
        weights = read_weights(path, shapes, read_safetensors(path)[0])
    if digest not in (None, arrays_sha256(weights)):
        raise InputError(
            f"{path}: the SHA-256 of the weights is not {digest}, as {CARD} says; "
            "keep the two files of one training together"
        )
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(weights)):
        raise InputError(f"{path}: holds weights that are not finite; train the network anew")
    return kind.estimator(weights=weights, architecture=architecture)


def newest_step(folder: str | Path) -> int:
    """Steps behind the newest training state in a run's folder; 0 where there is none."""
    return max((int(path.name) for path in (Path(folder) / _STATES).glob("*") if path.name.isdigit()), default=0)


class TrainingCheckpoints:
    """Training states of one run in a folder; the newest few are kept.

    Args:
      folder: where they are.
      config: how the run trains. A folder that holds states of another configuration is refused.
      facts: whatever else must be the same for a run to be resumed, such as the data; a JSON object.
      first_state: `config -> state` before the first step, which has a `step`; states restored have its shapes.

    Raises:
      InputError: if the folder holds a run of another configuration, or Orbax is not installed.
    """

    def __init__(
        self,
        folder: str | Path,
        config: Any,
        facts: dict[str, Any] | None = None,
        *,
        first_state: Callable[[Any], Any],
    ):
        self._first_state, self._orbax = functools.partial(first_state, config), _orbax()
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
        else:
            write_json(folder / _CONFIG, wanted)
        self._folder = folder / _STATES
        self._folder.mkdir(exist_ok=True)
        with _quiet():
            self._manager = self._orbax.CheckpointManager(
                self._folder,
                options=self._orbax.CheckpointManagerOptions(
                    max_to_keep=2,
                    create=False,
                    # Each process has a folder of its own.
                    multiprocessing_options=self._orbax.options.MultiprocessingOptions(
                        primary_host=None, active_processes={jax.process_index()}
                    ),
                ),
            )

    def steps(self) -> list[int]:
        """Numbers of the steps after which there are states, ascending."""
        return sorted(self._manager.all_steps())

    def restore(self, step: int | None = None) -> Any:
        """The state after a step, which becomes the newest; the newest where none is named, `None` if there is none.

        Raises:
          InputError: the state is damaged, or of another version of the program.
        """
        if step is None:
            step = self._manager.latest_step()
        if step is None:
            return None
        self.delete(after=step)
        template = jax.eval_shape(self._first_state)
        try:
            with _quiet():
                restored = self._manager.restore(step, args=self._orbax.args.StandardRestore(template))
        except Exception as error:  # Orbax raises many kinds
            raise InputError(
                f"{self._folder / str(step)}: cannot be restored ({_reason(error)}); delete it to go on from an "
                "earlier state, or train anew in another folder"
            ) from None
        # Free to go to other devices than Orbax has put it on.
        return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), restored)

    def delete(self, *, after: int = -1) -> None:
        """Delete the states after a step: all of them where none is named."""
        for step in self.steps():
            if step > after:
                self._manager.delete(step)

    def save(self, state: Any) -> None:
        """Save a state; returns when it is on disk."""
        with _quiet():
            self._manager.save(int(state.step), args=self._orbax.args.StandardSave(jax.tree.map(np.asarray, state)))
            self._manager.wait_until_finished()

    def close(self) -> None:
        """Release the folder."""
        self._manager.close()
