"""Fetching the published dataset once, from its authors' repository, into a cache folder.

pooch checks every file against a manifest of SHA-256 sums that the package ships (the images themselves are not part
of it) and moves it to its place when it is whole. So an interrupted download goes on with the files that are missing,
however many processes fetch at once.
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

from dc2g_jax.errors import InputError
from dc2g_jax.files.resources import resource

#: The authors' files at the pinned commit.
BASE_URL = "https://raw.githubusercontent.com/mit-acl/dc2g/6f739e1/data/datasets/driveways_bing_iros19/"

#: Asked in turn where the address above answers "no such file"; check sums make the source irrelevant.
OTHER_URLS = (
    "https://github.com/mit-acl/dc2g/raw/6f739e1/data/datasets/driveways_bing_iros19/",
    "https://raw.githubusercontent.com/mit-acl/dc2g/HEAD/data/datasets/driveways_bing_iros19/",
)

FOLDER_NAME = "driveways_bing_iros19"
MANIFEST_NAME = "driveways_bing_iros19.sha256"

TIMEOUT_SECONDS = 10.0
#: How long the server may take to answer at all before the network counts as absent.
PROBE_SECONDS = 6.0
#: Further tries of a file; pooch waits 1 s before the first and 2 s before the second.
RETRIES = 2

_REMEDY = "pass --dataset FOLDER (or set DC2G_DATA) with a copy of the dataset, or 'procedural'"


class NetworkUnavailable(Exception):
    """Nothing answers where the files lie: no route, no name service, refused, timed out or a broken connection.

    The message says in a few words why.
    """


def read_manifest(path: Path | None = None) -> dict[str, str]:
    """Read a manifest in the format of sha256sum: relative path -> SHA-256, lowercase hex.

    Args:
        path: the manifest; None for the shipped one of the published dataset.

    Raises:
        InputError: the file is missing, empty, or a line has another form.
    """
    path = resource(MANIFEST_NAME) if path is None else Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the manifest cannot be read ({error}); install the package again") from None
    entries = {}
    for number, line in enumerate(lines, start=1):
        match = re.fullmatch(r"([0-9a-f]{64})  (\S.*)", line)
        if match is None or ".." in match[2].split("/") or match[2].startswith("/"):
            raise InputError(f"{path}: line {number} is {line!r}; expected a SHA-256, two blanks, a relative path")
        entries[match[2]] = match[1]
    if not entries:
        raise InputError(f"{path}: the manifest is empty; install the package again")
    return entries


def matches_published(folder: Path) -> bool:
    """Say whether every file of the published dataset is in the folder, to the byte."""
    return all(
        os.path.isfile(folder / name) and pooch.file_hash(folder / name) == digest
        for name, digest in read_manifest().items()
    )


def cache_folder() -> Path:
    """Return where downloads are kept: `DC2G_CACHE`, else `dc2g_jax` in the user's cache folder."""
    chosen = os.environ.get("DC2G_CACHE")
    try:
        return Path(chosen or pooch.os_cache("dc2g_jax")).expanduser()
    except RuntimeError:
        raise InputError(f"DC2G_CACHE={chosen!r}: there is no such home folder; set DC2G_CACHE to a folder") from None


def fetch_dataset(
    cache_dir: str | os.PathLike[str] | None = None,
    *,
    base_url: str | None = None,
    manifest: Path | None = None,
    progress: bool = True,
) -> Path:
    """Return the folder of the published dataset, downloading what the cache does not have.

    Args:
        cache_dir: folder for downloads; None for `cache_folder()`.
        base_url: where the files lie, a folder's address; None for the authors' repository.
        manifest: file of check sums that says what to fetch; None for the shipped one.
        progress: show a bar on the error stream.

    Returns:
        The folder, every file in it verified just now.

    Raises:
        NetworkUnavailable: nothing answers; found out within `PROBE_SECONDS`.
        InputError: a file is not the one in the manifest (in the cache or as sent), the server does not hand it
            out, the download breaks off midway, or the cache folder cannot be read or written.
    """
    entries = read_manifest(manifest)
    folder = (cache_folder() if cache_dir is None else Path(cache_dir)) / FOLDER_NAME
    try:
        missing = _missing(folder, entries)
        if missing:
            _download(folder, entries, missing, (base_url,) if base_url else (BASE_URL, *OTHER_URLS), progress)
    except OSError as error:
        raise InputError(
            f"{error.filename or folder}: cannot be used ({error.strerror or error}); set DC2G_CACHE to a folder that "
            "you can write"
        ) from None
    return folder


def _missing(folder: Path, entries: Mapping[str, str]) -> list[str]:
    """The files to fetch; InputError where one is there but is not the published one."""
    missing = []
    for name, digest in entries.items():
        path = folder / name
        if not os.path.isfile(path):
            missing.append(name)
        elif (found := pooch.file_hash(path)) != digest:
            raise InputError(
                f"{path}: SHA-256 is {found}, expected {digest}; delete the folder {folder} to download it again"
            )
    return missing


def _download(
    folder: Path, entries: Mapping[str, str], missing: Collection[str], base_urls: Sequence[str], progress: bool
) -> None:
    """Fetch files, one after the other over one connection."""
    session = requests.Session()
    # Without a network nothing is touched, whether or not the cache could be written.
    _require_answer(session, base_urls[0])

    def fetch(url: str, file: str, _store: object) -> None:
        for base_url in base_urls:
            answer = session.get(url.replace(base_urls[0], base_url), timeout=TIMEOUT_SECONDS)
            if answer.status_code not in (404, 410):
                break
        answer.raise_for_status()
        Path(file).write_bytes(answer.content)

    pooch.get_logger().setLevel("WARNING")  # the bar says enough
    store = pooch.create(path=folder, base_url=base_urls[0], registry=dict(entries), retry_if_failed=RETRIES)
    bar = tqdm(
        total=len(entries),
        initial=len(entries) - len(missing),
        desc="Downloading the DC2G houses",
        unit="file",
        file=sys.stderr,
        disable=not progress,
    )
    try:
        with bar:
            for name in missing:
                # pooch would make it too, but not while another process does.
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
    except ValueError as error:  # pooch found another check sum
        raise InputError(f"{name}: {error} Try again later, or {_REMEDY}") from None


def _require_answer(session: requests.Session, url: str) -> None:
    """See that a server answers, whatever it says.

    The wait is on a thread, because looking a name up and trying address after address cannot be cut short.
    """
    answer: Future[requests.Response] = Future()

    def ask() -> None:
        try:
            answer.set_result(session.head(url, timeout=PROBE_SECONDS))
        except requests.RequestException as error:
            answer.set_exception(error)

    threading.Thread(target=ask, name="dc2g-download-probe", daemon=True).start()
    try:
        answer.result(PROBE_SECONDS)
    except TimeoutError:
        reason = f"no answer within {PROBE_SECONDS:g} s"
    except requests.RequestException as error:
        reason = _words(error)
    else:
        return
    raise NetworkUnavailable(f"{urlsplit(url).netloc}: {reason}")


def _words(error: BaseException) -> str:
    """What went wrong, in few words: requests wraps what urllib3 wraps."""
    while error.__context__ is not None:
        error = error.__context__
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
