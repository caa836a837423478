"""Networks (safetensors and a card) and training states (Orbax) on disk, validated when loaded."""

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

from dc2g_jax._src.errors import InputError, require_extra, short
from dc2g_jax._src.estimation.compact_unet import COMPACT_UNET, Architecture, network_class
from dc2g_jax._src.estimation.estimators import NetworkCostToGo, TranslatorCostToGo
from dc2g_jax._src.estimation.pix2pix import Generator, TranslatorArchitecture
from dc2g_jax._src.estimation.weights import read_safetensors, read_weights, shapes_of_weights, write_safetensors
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.digests import arrays_sha256
from dc2g_jax._src.files.reading import number, read_object, whole_number
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.own_parts import is_own_part

#: The shipped networks: for maps without errors, and for maps from a camera.
SHIPPED_NETWORK, SHIPPED_NOISY_NETWORK = "weights/compact_unet", "weights/compact_unet_noisy"

#: File with the card of a network, written after its weights.
CARD = "network.json"
_WEIGHTS = "weights.safetensors"
_CONFIG = "config.json"
_STATES = "states"

TrainedNetwork = NetworkCostToGo | TranslatorCostToGo


class _Kind(NamedTuple):
    """A kind of network: its estimator, the functions that read its architecture, and its class from that."""

    estimator: type[TrainedNetwork]
    read_architecture: Callable[[Any], Any]
    network: Callable[[Any], type[nnx.Module]]


def _read_compact(facts: Any) -> Architecture:
    return Architecture(
        widths=tuple(whole_number(width) for width in facts["widths"]),
        quantiles=tuple(map(number, facts["quantiles"])),
        cost_scale=number(facts["cost_scale"]),
        side=whole_number(facts["side"]),
        patch=whole_number(facts["patch"]),
        embedding=whole_number(facts["embedding"]),
        network=facts.get("network", COMPACT_UNET),
    )


def _read_translator(facts: Any) -> TranslatorArchitecture:
    return TranslatorArchitecture(
        size=whole_number(facts["size"]),
        base_filters=whole_number(facts["base_filters"]),
        compute_dtype=facts["compute_dtype"],
    )


_KINDS = {
    "compact_unet": _Kind(NetworkCostToGo, _read_compact, network_class),
    "pix2pix": _Kind(TranslatorCostToGo, _read_translator, lambda architecture: Generator),
}


def _orbax() -> Any:
    """Import Orbax, which takes a second and is only needed for training states."""
    require_extra("orbax")
    import orbax.checkpoint

    return orbax.checkpoint


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence Orbax's progress reports, which go to absl's logger."""
    loggers = [logging.getLogger(name) for name in ("absl", "asyncio")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def reason(error: Exception) -> str:
    """The first nonblank line of an error's message."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)[:160]


def save_network(folder: str | Path, network: TrainedNetwork, card: dict[str, Any] | None = None) -> Path:
    """Save a network as `network.json` (its card) and `weights.safetensors`. Replaces an existing network.

    Args:
      folder: folder to save to.
      network: the network.
      card: further facts for `network.json`, such as data, seed, command and metrics.
    """
    folder = Path(folder).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    write_safetensors(folder / _WEIGHTS, network.weights, {})
    facts = {
        "network": getattr(network.architecture, "network", "pix2pix"),
        "architecture": dataclasses.asdict(network.architecture),
        "classes": list(CLASS_NAMES),
        "sha256": arrays_sha256(network.weights),
        **(card or {}),
    }
    write_json(folder / CARD, facts)
    return folder


def _read_card(folder: Path) -> tuple[_Kind, Any, Any]:
    """Kind, architecture and digest of a saved network, after checking that this package can run it."""
    remedy = "give a folder written by `dc2g train` or `dc2g fig5`"
    if (folder / "network" / CARD).exists():
        remedy = f"give {folder / 'network'}"
    facts = read_object(folder / CARD, remedy)
    named = facts.get("network")
    kind = _KINDS.get(COMPACT_UNET if is_own_part(named) else named) if isinstance(named, str) else None
    if kind is None:
        raise InputError(
            f"{folder / CARD}: {f'its network is {short(named)}' if named else 'names no kind of network'}, but "
            f"planners take {' or '.join(_KINDS)}; {remedy}"
        )
    if facts.get("classes") != list(CLASS_NAMES):
        raise InputError(f"{folder / CARD}: the network was trained on another list of terrain classes; train it anew")
    architecture: Any = facts.get("architecture")
    try:
        known = kind.read_architecture(architecture)
        shapes_of_weights(kind.network(known), known)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder / CARD}: architecture {short(architecture)} is not one of this network's ({error}); {remedy}"
        ) from None
    return kind, known, facts.get("sha256")


def network_in_folder(folder: str | os.PathLike[str] | None = None) -> TrainedNetwork:
    """Load a network of any kind saved by `save_network`.

    Args:
      folder: folder of the network; `None` for the shipped network.

    Raises:
      InputError: the network is missing, cannot be read, or has weights of another architecture.
    """
    folder = Path(resource(SHIPPED_NETWORK) if folder is None else folder).absolute()
    kind, architecture, digest = _read_card(folder)
    path = folder / _WEIGHTS
    weights = read_weights(path, shapes_of_weights(kind.network(architecture), architecture), read_safetensors(path)[0])
    found = arrays_sha256(weights)
    if digest is None:
        raise InputError(
            f'{folder / CARD}: has no sha256 of the weights; if they belong together, add "sha256": "{found}"'
        )
    if digest != found:
        said = digest if isinstance(digest, str) else short(digest)
        raise InputError(
            f"{path}: the SHA-256 of the weights is not {said}, as {CARD} says; "
            "keep the two files of one training together"
        )
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(weights)):
        raise InputError(f"{path}: holds weights that are not finite; train the network anew")
    return kind.estimator(weights=weights, architecture=architecture)


def newest_step(folder: str | Path) -> int:
    """Number of steps of the newest training state in a run's folder; 0 if there is none."""
    return max((int(path.name) for path in (Path(folder) / _STATES).glob("*") if path.name.isdecimal()), default=0)


class TrainingCheckpoints:
    """Training states of one run in a folder. The newest two are kept.

    Args:
      folder: folder of the run.
      config: training configuration. It must match the states in the folder.
      facts: a JSON object of anything else that must match to resume the run, such as the data.
      first_state: `config -> state` before the first step, with an attribute `step`. It defines the shapes of restored
        states.

    Raises:
      InputError: the folder holds a run of another configuration, or Orbax is not installed.
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
            found = read_object(folder / _CONFIG, "give another folder")
            changed = [name for name in wanted if found.get(name) != wanted[name]]
            if changed:
                name, was, now = changed[0], found.get(changed[0]), wanted[changed[0]]
                if isinstance(was, dict) and isinstance(now, dict):
                    within = next(key for key in {**was, **now} if was.get(key) != now.get(key))
                    name, was, now = f"{name}: {within}", was.get(within), now.get(within)
                raise InputError(
                    f"{folder / _CONFIG}: {name} was {short(was)} in the run that is there, now {short(now)}; give the "
                    "same options to resume it, or another folder"
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
                    enable_async_checkpointing=False,  # its signals may be those of all processes
                    # Each process has its own folder.
                    multiprocessing_options=self._orbax.options.MultiprocessingOptions(
                        primary_host=None, active_processes={jax.process_index()}
                    ),
                ),
            )

    def steps(self) -> list[int]:
        """Steps with a saved state, ascending."""
        return sorted(self._manager.all_steps())

    def restore(self, step: int | None = None) -> Any:
        """Restore the state after `step`, by default the newest, and delete later ones. `None` if there is no state.

        Raises:
          InputError: the state is damaged, or from another version of the program.
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
        except Exception as error:  # Orbax raises many types
            raise InputError(
                f"{self._folder / str(step)}: cannot be restored ({reason(error)}); delete it to go on from an "
                "earlier state, or train anew in another folder"
            ) from None
        # Not bound to the devices that Orbax put it on.
        return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), restored)

    def delete(self, *, after: int = -1) -> None:
        """Delete the states after a step; by default all states."""
        for step in self.steps():
            if step > after:
                self._manager.delete(step)

    def save(self, state: Any) -> None:
        """Save a state and wait until it is on disk."""
        with _quiet():
            self._manager.save(int(state.step), args=self._orbax.args.StandardSave(jax.tree.map(np.asarray, state)))
            self._manager.wait_until_finished()

    def close(self) -> None:
        """Release the folder."""
        self._manager.close()
