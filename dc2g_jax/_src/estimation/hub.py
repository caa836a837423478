"""Load and save trained networks: in a folder, or at `hf://owner/name` on the Hugging Face Hub."""

import os
from pathlib import Path

import jax

from dc2g_jax._src.estimation.checkpoints import CARD, WEIGHTS, code_in_card, network_in_folder, reason
from dc2g_jax._src.estimation.estimators import Ensemble, Estimator
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.runtime.errors import InputError, require_extra, short
from dc2g_jax._src.runtime.own_parts import is_own_part, own_part

#: Prefix of places on the Hub.
_HUB = "hf://"

#: The files of a network, whatever its kind, and of an encoder in its folder.
_FILES = [f"*{CARD}", f"*{WEIGHTS}"]


def _on_hub(place: str) -> tuple[str, str | None]:
    """The repository and the revision of `hf://owner/name@revision`, after checking for the extra `hub`."""
    require_extra("huggingface_hub", extra="hub")
    repository, _, revision = place.removeprefix(_HUB).partition("@")
    if not place.startswith(_HUB) or len(repository.split("/")) != 2:
        raise InputError(f"{place}: not a network on the Hub; give {_HUB}owner/name")
    return repository, revision or None


def local_folder(place: str | os.PathLike[str]) -> Path:
    """The folder of a network. Networks on the Hub are downloaded to the cache of `huggingface_hub`.

    Args:
      place: a folder; or a string, `hf://owner/name` or `hf://owner/name@revision` with a branch, tag or commit.

    Raises:
      InputError: it is not in the cache and cannot be downloaded, its card names code to import, or the extra `hub` is
        not installed.
    """
    if not str(place).startswith(_HUB):
        return Path(place)
    repository, revision = _on_hub(str(place))
    import huggingface_hub

    try:
        folder = Path(huggingface_hub.snapshot_download(repository, revision=revision, allow_patterns=_FILES))
    except Exception as error:  # from several libraries
        raise InputError(
            f"{place}: cannot be downloaded ({reason(error)}); check the name, and the connection to the Hub"
        ) from None
    card = read_object(folder / CARD, "give another network") if (folder / CARD).is_file() else {}
    if named := code_in_card(card):
        raise InputError(
            f"{place}: its card names {named!r}, which loading it would import; if you trust that, give the folder "
            f"that it was downloaded to: {folder}"
        )
    return folder


def load_network(place: Estimator | str | os.PathLike[str] | None = None) -> Estimator:
    """Load a planner's network of any kind, or an estimator of the user's own.

    Args:
      place: see `local_folder`; several places with commas between them for the mean of their networks;
        `package.module:Name` for an estimator, or a class or function that is called without arguments to make one;
        `None` for the shipped network. An estimator is returned as it is.

    Raises:
      InputError: there is no estimator of that name, or several networks are not alike; see also `local_folder` and
        `estimation.checkpoints.network_in_folder`, which checks the SHA-256 of the weights.
    """
    if place is not None and not isinstance(place, str | os.PathLike):
        return place
    if "," in str(place) and not Path(str(place)).exists():
        return _ensemble(str(place))
    if not is_own_part(place):
        return network_in_folder(None if place is None else local_folder(place))
    found = own_part("estimator", str(place), ())
    try:
        estimator: Estimator = found() if callable(found) else found
    except TypeError as error:
        raise InputError(f"estimator {place!r}: {error}; give what is called without arguments") from error
    if not hasattr(estimator, "estimate") or jax.tree_util.all_leaves([estimator]):
        raise InputError(
            f"estimator {place!r}: is {short(estimator)}; give a class with init and estimate, decorated with "
            "flax.struct.dataclass"
        )
    return estimator


def _ensemble(place: str) -> Ensemble:
    """The mean of the networks in several places, with commas between them."""
    places = [one.strip() for one in place.split(",")]
    if len(set(places)) < len(places) or "" in places or any(map(is_own_part, places)):
        raise InputError(f"{place}: give folders of networks, or hf://owner/name, each once, with commas between them")
    members = tuple(network_in_folder(local_folder(one)) for one in places)
    first = members[0]
    for one, member in zip(places, members, strict=True):
        if type(member) is not type(first) or getattr(member, "architecture", 0) != getattr(first, "architecture", 0):
            raise InputError(f"{one}: differs in its architecture from {places[0]}; give networks that are alike")
    return Ensemble(members)


def push(folder: str | os.PathLike[str], place: str) -> str:
    """Save a network on the Hub, in a new repository or as a new version. First log in with `hf auth login`.

    Args:
      folder: the folder of a trained network of any kind.
      place: `hf://owner/name`.

    Returns:
      The address of the new version.

    Raises:
      InputError: the folder holds no network, or the Hub rejects it.
    """
    repository, revision = _on_hub(place)
    import huggingface_hub

    folder = Path(folder)
    if not ((folder / CARD).is_file() and (folder / WEIGHTS).is_file()):
        raise InputError(f"{folder}: holds no {CARD} and {WEIGHTS}; give the folder of a trained network")
    try:
        hub = huggingface_hub.HfApi()
        hub.create_repo(repository, exist_ok=True)
        done = hub.upload_folder(repo_id=repository, folder_path=folder, revision=revision, allow_patterns=_FILES)
        return str(done.commit_url)
    except Exception as error:  # of many libraries
        raise InputError(
            f"{place}: cannot be saved ({reason(error)}); log in with `hf auth login`, and check the name"
        ) from None
