"""Networks (safetensors and a card) and training states (Orbax) on disk, validated when loaded."""

import contextlib
import dataclasses
import functools
import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from flax import nnx

from dc2g_jax._src.estimation.compact_unet import COMPACT_UNET, Architecture, make_network
from dc2g_jax._src.estimation.estimators import Estimator, NetworkCostToGo
from dc2g_jax._src.estimation.weights import read_weights, shapes_of_weights, write_safetensors
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.digests import arrays_sha256
from dc2g_jax._src.files.reading import finite_number, number, read_object, whole_number
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.grid.sensing import check_degrees
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.runtime.errors import InputError, check_number, require_extra, short
from dc2g_jax._src.runtime.own_parts import is_own_part, own_part

#: The shipped networks: for maps without errors, and for maps from a camera.
SHIPPED_NETWORK, SHIPPED_NOISY_NETWORK = "weights/compact_unet", "weights/compact_unet_noisy"

#: Files of a network: its card, which is written last, and its weights.
CARD, WEIGHTS = "network.json", "weights.safetensors"

_CONFIG, _STATES = "config.json", "states"


class Kind(NamedTuple):
    """A kind of networks.

    Attributes:
      name: its name in cards: `package.module:Name` of this value, by which `load_network` finds it. (Kinds that are
        only read by a program that knows them may have any name.)
      architecture: dataclass of an architecture, whose attributes have defaults.
      network: class of the network, called as `network(architecture, rngs=...)`.
      command: trains it.
      estimator: class of its estimator, called with `weights` and `architecture`; `None` if it is for no planner.
      classes: names of the classes that maps for it may have.
      dtype: precision of saved weights.
    """

    name: str
    architecture: type
    network: Callable[..., nnx.Module]
    command: str
    estimator: Callable[..., Estimator] | None = None
    classes: Sequence[str] = CLASS_NAMES
    dtype: npt.DTypeLike = np.float32


#: The compact network, or one of the user's own in its place, whose class cards name.
COMPACT = Kind(COMPACT_UNET, Architecture, make_network, "dc2g train", NetworkCostToGo)


def _like(default: Any, value: Any) -> Any:
    """A value of a JSON document with the type of a default. JSON has lists instead of tuples."""
    if isinstance(default, tuple):
        return tuple(_like(default[0], one) for one in value)
    return whole_number(value) if isinstance(default, int) else number(value) if isinstance(default, float) else value


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


def write_network(
    folder: str | Path, weights: dict[str, Any], architecture: Any, kind: Kind, card: dict[str, Any] | None = None
) -> Path:
    """Save a network as `network.json` (its card) and `weights.safetensors`. Replaces an existing network.

    Args:
      folder: folder to save to.
      weights: see `estimation.weights`.
      architecture: architecture of the network.
      kind: kind of the network.
      card: further facts for `network.json`, such as data, seed, command and metrics.
    """
    folder = Path(folder).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    saved = jax.tree.map(lambda leaf: np.asarray(leaf, kind.dtype), weights)
    write_safetensors(folder / WEIGHTS, saved)
    facts = {
        "network": getattr(architecture, "network", kind.name),
        "architecture": dataclasses.asdict(architecture),
        "classes": list(kind.classes),
        "sha256": arrays_sha256(jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), saved)),
        **(card or {}),
    }
    write_json(folder / CARD, facts)
    return folder


def save_network(folder: str | Path, network: NetworkCostToGo, card: dict[str, Any] | None = None) -> Path:
    """Save a compact network, or one of the user's own in its place, see `write_network`."""
    score = {} if network.score is None else {"score": jax.tree.map(float, dict(network.score))}
    return write_network(folder, network.weights, network.architecture, COMPACT, {**score, **(card or {})})


def code_in_card(card: dict[str, Any]) -> str | None:
    """The `package.module:Name` that a card has imported when its network is loaded, if any."""
    architecture = card.get("architecture")
    named = (card.get("network"), architecture.get("network") if isinstance(architecture, dict) else None)
    return next(filter(is_own_part, named), None)


def _kind_of(named: Any) -> Kind | None:
    """The kind of a planner's network by its name in the card."""
    if not is_own_part(named):
        return COMPACT if named == COMPACT.name else None
    found = own_part("network", named, [COMPACT.name])
    # Whatever is no kind has to be a network's class.
    return found if isinstance(found, Kind) and found.estimator else COMPACT


def _read_card(folder: Path, kind: Kind | None) -> tuple[Kind, Any, dict[str, Any]]:
    """Kind, architecture and card of a saved network, after checking that this package can run it."""
    remedy = f"give a folder written by `{(kind or COMPACT).command}`"
    if (folder / "network" / CARD).exists():
        remedy = f"give {folder / 'network'}"
    facts = read_object(folder / CARD, remedy)
    named = facts.get("network")
    expected = f"{COMPACT.name} or package.module:Name" if kind is None else kind.name
    try:
        kind = _kind_of(named) if kind is None else kind if named == kind.name else None
    except InputError as error:
        raise InputError(f"{folder / CARD}: {error}") from None
    if kind is None:
        raise InputError(
            f"{folder / CARD}: {f'its network is {short(named)}' if named else 'names no kind of network'}, but "
            f"expected {expected}; {remedy}"
        )
    if facts.get("classes") != list(kind.classes):
        raise InputError(f"{folder / CARD}: the network was trained on another list of classes; train it anew")
    architecture: Any = facts.get("architecture")
    try:
        defaults = {field.name: field.default for field in dataclasses.fields(kind.architecture)}
        known = kind.architecture(**{name: _like(value, architecture[name]) for name, value in defaults.items()})
        shapes_of_weights(kind.network, known)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder / CARD}: architecture {short(architecture)} is not one of this network's ({error}); {remedy}"
        ) from None
    return kind, known, facts


def read_network(folder: str | Path, kind: Kind | None = None) -> tuple[Kind, dict[str, Any], Any, dict[str, Any]]:
    """Read a network written by `write_network`: its kind, weights in float32, architecture and card.

    Args:
      folder: folder of the network.
      kind: kind of the network; `None` for any kind for planners, which the card names.

    Raises:
      InputError: the network is missing, cannot be read, is of another kind, or has weights of another architecture.
    """
    folder = Path(folder).absolute()
    kind, architecture, card = _read_card(folder, kind)
    path, digest = folder / WEIGHTS, card.get("sha256")
    weights = read_weights(path, shapes_of_weights(kind.network, architecture))
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
    return kind, weights, architecture, card


def network_in_folder(folder: str | os.PathLike[str] | None = None) -> Any:
    """Load a planner's network of any kind, see `read_network`; `None` for the shipped network."""
    place = resource(SHIPPED_NETWORK) if folder is None else Path(folder)
    kind, weights, architecture, card = read_network(place)
    assert kind.estimator is not None
    network = kind.estimator(weights=weights, architecture=architecture)
    if not isinstance(network, NetworkCostToGo) or "score" not in card:
        return network
    score, remedy = card["score"], "train the score anew"
    if not isinstance(score, dict) or not score or not all(isinstance(terms, dict) for terms in score.values()):
        raise InputError(
            f"{place / CARD}: its score is {short(score)}, not weights by degrees and term; {remedy}, or nest it under "
            'the degrees: "score": {"90": {...}}'
        )
    for degrees, terms in score.items():
        where = f"{place / CARD}: field of view of the score"
        check_degrees(where, finite_number(where, degrees, remedy))
        for term, weight in terms.items():
            check_number(f"{place / CARD}: weight of {term}", weight, hint=remedy)
    return dataclasses.replace(network, score=jax.tree.map(jnp.float32, score))


def newest_step(folder: str | Path) -> int:
    """Number of steps of the newest training state in a run's folder; 0 if there is none."""
    return max((int(path.name) for path in (Path(folder) / _STATES).glob("*") if path.name.isdecimal()), default=0)


def keep_config(folder: Path, config: Any, facts: Mapping[str, Any] | None = None) -> None:
    """Save the configuration of a run in its folder, or check that it is that of the run which is there.

    Raises:
      InputError: the folder holds a run of another configuration.
    """
    folder.mkdir(parents=True, exist_ok=True)
    wanted = json.loads(json.dumps({**dataclasses.asdict(config), **(facts or {})}))
    if not (folder / _CONFIG).exists():
        write_json(folder / _CONFIG, wanted)
        return
    found = read_object(folder / _CONFIG, "give another folder")
    changed = [name for name in wanted if found.get(name) != wanted[name]]
    if changed:
        name, was, now = changed[0], found.get(changed[0]), wanted[changed[0]]
        if isinstance(was, dict) and isinstance(now, dict):
            within = next(key for key in {**was, **now} if was.get(key) != now.get(key))
            name, was, now = f"{name}: {within}", was.get(within), now.get(within)
        raise InputError(
            f"{folder / _CONFIG}: {name} was {short(was)} in the run that is there, now {short(now)}; give the same "
            "options to resume it, or another folder"
        )


class TrainingCheckpoints:
    """Training states of one run in a folder. The newest two are kept.

    Args:
      folder: folder of the run.
      config: training configuration. It must match the states in the folder.
      facts: a JSON object of anything else that must match to resume the run, such as the data.
      first_state: `config -> state` before the first step, with an attribute `step`.

    Raises:
      InputError: the folder holds a run of another configuration, or Orbax is not installed.
    """

    def __init__(
        self,
        folder: str | Path,
        config: Any,
        facts: Mapping[str, Any] | None = None,
        *,
        first_state: Callable[[Any], Any],
    ):
        require_extra("orbax")
        import orbax.checkpoint  # takes a second

        self._first_state, self._orbax = functools.partial(first_state, config), orbax.checkpoint
        folder = Path(folder).absolute()
        keep_config(folder, config, facts)
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
        """The state after `step`, whose later ones are deleted; by default the newest, or the first if none is saved.

        Raises:
          InputError: the state is damaged, or from another version of the program.
        """
        if step is None:
            step = self._manager.latest_step()
        if step is None:
            return self._first_state()
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
