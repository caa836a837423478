"""Download of the published dataset from its authors' repository into a cache folder.

pooch checks every file against the package's manifest of SHA-256 sums (the images themselves are not part of the
package) and moves it to its place once it is complete. An interrupted download resumes with the missing files, and
several processes may download at once.
"""

import os
import re
import sys
import threading
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from urllib.parse import urlsplit

import pooch
import requests
from tqdm import tqdm

from dc2g_jax._src.files.cache import cache_folder
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.runtime.errors import InputError

#: The authors' files at the pinned commit, and mirrors, tried in turn if the first answers "no such file". Checksums
#: make the source irrelevant.
URLS = (
    "https://raw.githubusercontent.com/mit-acl/dc2g/6f739e1/data/datasets/driveways_bing_iros19/",
    "https://github.com/mit-acl/dc2g/raw/6f739e1/data/datasets/driveways_bing_iros19/",
    "https://raw.githubusercontent.com/mit-acl/dc2g/HEAD/data/datasets/driveways_bing_iros19/",
)

FOLDER_NAME = "driveways_bing_iros19"
#: Where the authors keep it.
ORIGIN = f"data/datasets/{FOLDER_NAME} from github.com/mit-acl/dc2g"
_MANIFEST_NAME = "driveways_bing_iros19.sha256"

#: Retries per file; pooch waits 1 s before the first and 2 s before the second.
_RETRIES = 2

#: Time for the server to answer before the network counts as unavailable, and for each answer after that.
_PROBE_SECONDS, _TIMEOUT_SECONDS = 6.0, 10.0

_REMEDY = "pass --dataset FOLDER (or set DC2G_DATA) with a copy of the dataset, or 'procedural'"


class NetworkUnavailable(Exception):
    """The server does not answer: no route, no name service, refused, timed out or a broken connection.

    The message gives the reason in a few words.
    """


def read_manifest(path: Path | None = None) -> dict[str, str]:
    """A manifest in the format of sha256sum, by default the package's own: relative path -> SHA-256, lowercase hex."""
    lines = (path or resource(_MANIFEST_NAME)).read_text().splitlines()
    return {name: digest for digest, name in (line.split("  ", 1) for line in lines)}


def matches_published(folder: Path) -> bool:
    """Whether the folder contains every file of the published dataset, byte for byte."""
    return all(
        os.path.isfile(folder / name) and pooch.file_hash(folder / name) == digest
        for name, digest in read_manifest().items()
    )


def fetch_dataset(*, urls: Sequence[str] = URLS, manifest: Path | None = None) -> Path:
    """Return the folder of the published dataset, after downloading the files that the cache lacks.

    Args:
        urls: addresses of the folder of files, tried in turn.
        manifest: file of checksums that lists the files; None for the package's manifest.

    Returns:
        The folder. Every file in it has been verified in this call.

    Raises:
        NetworkUnavailable: the server does not answer.
        InputError: a file (in the cache or downloaded) does not match the manifest, the server refuses a file, the
            download is interrupted, or the cache folder cannot be read or written.
    """
    entries = read_manifest(manifest)
    folder = cache_folder() / FOLDER_NAME
    try:
        missing = _missing(folder, entries)
        if missing:
            # The network is probed first, so that without it the cache is not touched.
            session = requests.Session()
            _require_answer(session, urls[0])
            _download(session, folder, entries, missing, urls)
    except OSError as error:
        raise InputError(
            f"{error.filename or folder}: cannot be used ({error.strerror or error}); set DC2G_CACHE to a folder that "
            "you can write"
        ) from None
    return folder


def _missing(folder: Path, entries: Mapping[str, str]) -> list[str]:
    """The files to fetch. Raises InputError if a file is present but differs from the published one."""
    missing = []
    for name, digest in entries.items():
        path = folder / name
        if not os.path.isfile(path):
            missing.append(name)
        elif (found := pooch.file_hash(path)) != digest:
            raise InputError(f"{path}: SHA-256 is {found}, expected {digest}; delete the file to download it again")
    return missing


def _download(
    session: requests.Session, folder: Path, entries: Mapping[str, str], missing: Collection[str], urls: Sequence[str]
) -> None:
    def fetch(url: str, file: str, _store: object) -> None:
        for base_url in urls:
            answer = session.get(url.replace(urls[0], base_url), timeout=_TIMEOUT_SECONDS)
            if answer.status_code not in (404, 410):
                break
        answer.raise_for_status()
        Path(file).write_bytes(answer.content)

    pooch.get_logger().setLevel("WARNING")  # the progress bar is enough
    store = pooch.create(path=folder, base_url=urls[0], registry=dict(entries), retry_if_failed=_RETRIES)
    bar = tqdm(
        total=len(entries),
        initial=len(entries) - len(missing),
        desc="Downloading the DC2G houses",
        unit="file",
        file=sys.stderr,
    )
    try:
        with bar:
            for name in missing:
                # pooch also makes it, but fails if another process does so at the same time.
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                store.fetch(name, downloader=fetch)
                bar.update()
    except requests.HTTPError as error:
        raise InputError(f"{error}; run again later, or {_REMEDY}") from None
    except requests.RequestException as error:
        kept = sum(os.path.isfile(folder / name) for name in entries)
        raise InputError(
            f"{folder}: the download broke off ({_words(error)}); {kept} of {len(entries)} files are kept: run again "
            f"to fetch the others, or {_REMEDY}"
        ) from None
    except ValueError as error:  # pooch found a wrong checksum, which it names last
        *_, found = re.findall("[0-9a-f]{64}", str(error)) or [str(error)]
        raise InputError(
            f"{name}: SHA-256 is {found}, expected {entries[name]}; try again later, or {_REMEDY}"
        ) from None


def _require_answer(session: requests.Session, url: str) -> None:
    """Check that a server answers, with any status.

    The request runs on a thread, because name resolution and attempts at several addresses cannot be interrupted.
    """
    answer: Future[requests.Response] = Future()

    def ask() -> None:
        try:
            answer.set_result(session.head(url, timeout=_PROBE_SECONDS))
        except requests.RequestException as error:
            answer.set_exception(error)

    threading.Thread(target=ask, name="dc2g-download-probe", daemon=True).start()
    try:
        answer.result(_PROBE_SECONDS)
    except (TimeoutError, requests.Timeout):
        reason = f"no answer within {_PROBE_SECONDS:g} s"
    except requests.RequestException as error:
        reason = _words(error)
    else:
        return
    raise NetworkUnavailable(f"{urlsplit(url).netloc}: {reason}")


def _words(error: BaseException) -> str:
    """The innermost reason of an error in a few words: requests wraps errors that urllib3 already wraps."""
    while error.__context__ is not None:
        error = error.__context__
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
