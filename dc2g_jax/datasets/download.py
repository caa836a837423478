"""Fetching the published dataset once, from its authors' repository, into a cache folder.

Every file is checked against a manifest of SHA-256 sums that the package ships; the images themselves are
not part of it. A download is built up beside its final place and renamed when whole, so that what is in the
cache is complete, whatever was interrupted and however many processes fetched at once.
"""

import errno
import hashlib
import http.client
import os
import queue
import re
import secrets
import shutil
import socket
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from dc2g_jax.errors import InputError
from dc2g_jax.shipped import shipped

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
FILE_SECONDS = 60.0
#: How long the first file may take before the network counts as absent.
PROBE_SECONDS = 6.0
#: Waits before the second and the third try of a file.
BACKOFF_SECONDS = (0.5, 1.5)
THREADS = 8

_CHUNK_BYTES = 1 << 16
_REMEDY = "pass --dataset FOLDER (or set DC2G_DATA) with a copy of the dataset, or 'procedural'"


class NetworkUnavailable(Exception):
    """Nothing answers where the files lie: no route, no name service, refused, timed out or a broken connection.

    The message says in a few words why.
    """


class _MissingFile(InputError):
    """The server is there and says that the file is not."""


class _MayPass(Exception):
    """Trouble that another try may not meet.

    Args:
        lasting: what to raise where it lasts.
    """

    def __init__(self, lasting: Exception):
        super().__init__(str(lasting))
        self.lasting = lasting


def read_manifest(path: Path | None = None) -> dict[str, str]:
    """Read a manifest in the format of sha256sum: relative path -> SHA-256, lowercase hex.

    Args:
        path: the manifest; None for the shipped one of the published dataset.

    Raises:
        InputError: the file is missing, empty, or a line has another form.
    """
    path = shipped(MANIFEST_NAME) if path is None else Path(path)
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
    return all(_has(folder / name, digest) for name, digest in read_manifest().items())


def cache_folder() -> Path:
    """Return where downloads are kept: `DC2G_CACHE`, else `dc2g_jax` in the user's cache folder."""
    chosen, base = os.environ.get("DC2G_CACHE"), os.environ.get("XDG_CACHE_HOME")
    try:
        if chosen:
            return Path(chosen).expanduser()
        return (Path(base) if base else Path.home() / ".cache") / "dc2g_jax"
    except RuntimeError:
        what = f"DC2G_CACHE={chosen!r}" if chosen else "the cache folder ~/.cache/dc2g_jax"
        raise InputError(f"{what}: there is no such home folder; set DC2G_CACHE to a folder") from None


def fetch_dataset(
    cache_dir: str | os.PathLike[str] | None = None,
    *,
    base_url: str | None = None,
    manifest: Path | None = None,
    progress: bool = True,
) -> Path:
    """Return the folder of the published dataset, downloading it where the cache does not have it whole.

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
    cache = cache_folder() if cache_dir is None else Path(cache_dir)
    final = cache / FOLDER_NAME
    try:
        if _is_complete(final, entries):
            return final
        _download(final, entries, (base_url,) if base_url else (BASE_URL, *OTHER_URLS), progress)
    except OSError as error:
        # Another process may have finished first and cleared everyone's working folders.
        if _is_complete(final, entries):
            return final
        where = error.filename or cache
        raise InputError(
            f"{where}: cannot be used ({error.strerror or error}); set DC2G_CACHE to a folder that you can write"
        ) from None
    if not _is_complete(final, entries):
        raise InputError(f"{final}: files vanished from it as soon as they were written; run again")
    return final


def _is_complete(final: Path, entries: Mapping[str, str]) -> bool:
    """False where files are missing; InputError where one is there but is not the published one."""
    missing = False
    for name, digest in entries.items():
        path = final / name
        if not os.path.isfile(path):
            missing = True
        elif (found := _digest(path)) != digest:
            raise InputError(
                f"{path}: SHA-256 is {found}, expected {digest}; delete the folder {final} to download it again"
            )
    return not missing


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        return f"unknown ({error.strerror})"


def _has(path: Path, digest: str) -> bool:
    return os.path.isfile(path) and _digest(path) == digest


def _download(final: Path, entries: Mapping[str, str], base_urls: Sequence[str], progress: bool) -> None:
    """Fetch what no earlier attempt left behind, then put the whole folder in place."""
    earlier = [*_working_folders(final), final]
    at_hand: dict[str, Path] = {}
    for name, digest in entries.items():
        for folder in earlier:
            if _has(folder / name, digest):
                at_hand[name] = folder / name
                break
    wanted = {name: digest for name, digest in entries.items() if name not in at_hand}
    # The first file comes before anything is written: without a network nothing is touched.
    first, base_url = _probe(*next(iter(wanted.items())), base_urls) if wanted else (b"", "")
    working = final.with_name(f"{final.name}.partial-{os.getpid()}-{secrets.token_hex(4)}")
    for name in entries:
        (working / name).parent.mkdir(parents=True, exist_ok=True)
    for name, path in at_hand.items():
        shutil.copyfile(path, working / name)
    with tqdm(
        total=len(entries),
        initial=len(at_hand),
        desc="Downloading the DC2G houses",
        unit="file",
        file=sys.stderr,
        disable=not progress,
    ) as bar:
        if wanted:
            name = next(iter(wanted))
            (working / name).write_bytes(first)
            del wanted[name]
            bar.update()
        try:
            _fetch_all(wanted, base_url, working, bar)
        except NetworkUnavailable as reason:
            kept = sum(_has(working / name, digest) for name, digest in entries.items())
            raise InputError(
                f"{final}: the download broke off ({reason}); {kept} of {len(entries)} files are kept: run again to "
                f"fetch the others, or {_REMEDY}"
            ) from None
    _publish(working, final, entries)


def _working_folders(final: Path) -> list[Path]:
    """Folders of downloads under way or broken off."""
    return sorted(final.parent.glob(f"{final.name}.partial-*"))


def _publish(working: Path, final: Path, entries: Mapping[str, str]) -> None:
    """Give the finished folder its name, and clear away what broken downloads left."""
    try:
        os.rename(working, final)
    except OSError:
        if not final.is_dir():
            raise
        # Another process was first, or files had been missing from the folder: supply what it lacks.
        for name, digest in entries.items():
            if not _has(final / name, digest):
                (final / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(working / name, final / name)
    for folder in _working_folders(final):
        shutil.rmtree(folder, ignore_errors=True)


def _probe(name: str, digest: str, base_urls: Sequence[str]) -> tuple[bytes, str]:
    """Fetch one file, within `PROBE_SECONDS` in all, from the first address that has it.

    The wait is on a thread, because looking a name up and trying address after address cannot be cut short.
    """
    outcomes: queue.SimpleQueue[tuple[bytes, str] | Exception] = queue.SimpleQueue()
    stop = threading.Event()
    met: list[Exception] = []

    def work() -> None:
        outcome: tuple[bytes, str] | Exception = NetworkUnavailable("no address to ask")
        for base_url in base_urls:
            try:
                outcome = (_fetch(base_url, name, digest, stop, met), base_url)
                break
            except Exception as error:
                outcome = error
                if not isinstance(error, _MissingFile):
                    break
        outcomes.put(outcome)

    threading.Thread(target=work, name="dc2g-download-probe", daemon=True).start()
    try:
        outcome = outcomes.get(timeout=PROBE_SECONDS)
    except queue.Empty:
        if met:  # what a server has said tells more than that another try got no answer
            raise next((trouble for trouble in met if not isinstance(trouble, NetworkUnavailable)), met[-1]) from None
        host = urllib.parse.urlsplit(base_urls[0]).netloc
        raise NetworkUnavailable(f"no answer from {host} within {PROBE_SECONDS:g} s") from None
    finally:
        stop.set()
    if isinstance(outcome, Exception):
        raise outcome
    return outcome


def _fetch_all(entries: Mapping[str, str], base_url: str, working: Path, bar: tqdm) -> None:
    """Fetch files on a few threads into the working folder; the first failure ends it.

    The threads are daemons, so that neither a failure nor Ctrl-C waits for what a server still owes.
    """
    todo: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
    outcomes: queue.SimpleQueue[Exception | None] = queue.SimpleQueue()
    stop = threading.Event()
    for entry in entries.items():
        todo.put(entry)

    def work() -> None:
        while not stop.is_set():
            try:
                name, digest = todo.get_nowait()
            except queue.Empty:
                return
            try:
                (working / name).write_bytes(_fetch(base_url, name, digest, stop))
                outcomes.put(None)
            except Exception as error:
                outcomes.put(error)
                stop.set()

    threads = [
        threading.Thread(target=work, name=f"dc2g-download-{index}", daemon=True)
        for index in range(min(THREADS, len(entries)))
    ]
    for thread in threads:
        thread.start()
    try:
        for _ in entries:
            outcome = outcomes.get()
            if outcome is not None:
                raise outcome
            bar.update()
    finally:
        stop.set()


def _fetch(base_url: str, name: str, digest: str, stop: threading.Event, met: list[Exception] | None = None) -> bytes:
    """Fetch one file whole and check it; trouble that may pass is given two more tries, and noted in `met`."""
    url = base_url + urllib.parse.quote(name)
    for wait in (*BACKOFF_SECONDS, None):
        try:
            data = _request(url, stop)
            break
        except _MayPass as trouble:
            if met is not None:
                met.append(trouble.lasting)
            if wait is None or stop.wait(wait):
                raise trouble.lasting from None
    found = hashlib.sha256(data).hexdigest()
    if found != digest:
        raise InputError(
            f"{url}: SHA-256 of {name} is {found}, expected {digest}, so this is not the published file; "
            f"try again later, or {_REMEDY}"
        )
    return data


def _request(url: str, stop: threading.Event) -> bytes:
    """Ask for a file once."""
    host = urllib.parse.urlsplit(url).netloc
    give_up = time.monotonic() + FILE_SECONDS
    pieces = []
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_SECONDS) as response:
            expected = response.headers.get("Content-Length")
            while piece := response.read1(_CHUNK_BYTES):
                pieces.append(piece)
                if stop.is_set():
                    raise NetworkUnavailable("the download was stopped")
                if time.monotonic() > give_up:
                    raise NetworkUnavailable(f"{host} took more than {FILE_SECONDS:g} s for {url}")
    except urllib.error.HTTPError as answer:
        with answer:
            raise _judge_status(url, answer.code) from None
    except (OSError, http.client.HTTPException) as error:
        raise _judge_failure(host, error) from None
    data = b"".join(pieces)
    if expected is not None and expected.isdecimal() and len(data) != int(expected):
        raise _MayPass(
            NetworkUnavailable(f"{host} closed the connection after {len(data)} of {expected} bytes of {url}")
        )
    return data


def _judge_status(url: str, status: int) -> Exception:
    if status in (404, 410):
        return _MissingFile(f"{url}: the server has no such file (HTTP {status}); {_REMEDY}")
    refused = InputError(f"{url}: the server answers HTTP {status}; run again later, or {_REMEDY}")
    return _MayPass(refused) if status >= 500 or status in (408, 429) else refused


def _judge_failure(host: str, error: Exception) -> Exception:
    cause = error.reason if isinstance(error, urllib.error.URLError) else error
    words = " ".join(str(getattr(cause, "strerror", None) or cause).split()) or type(cause).__name__
    message = f"{host}: {words}"
    unreachable = isinstance(cause, OSError) and cause.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH)
    if unreachable or isinstance(cause, socket.gaierror | ConnectionRefusedError):
        return NetworkUnavailable(message)
    return _MayPass(NetworkUnavailable(message))
