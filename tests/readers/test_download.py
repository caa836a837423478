"""The download, against a server on this machine that can be made to misbehave."""

import functools
import hashlib
import http.server
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import types
import urllib.parse
from collections import Counter
from pathlib import Path

import pytest

from dc2g_jax._src.readers import _download
from dc2g_jax._src.readers._download import (
    FOLDER_NAME,
    URLS,
    NetworkUnavailable,
    fetch_dataset,
    matches_published,
    read_manifest,
)
from dc2g_jax._src.runtime.errors import InputError
from tests.support.places import PUBLISHED, SHARED
from tests.support.refusals import refusal_of

needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")


class Server(http.server.ThreadingHTTPServer):
    """Serves a folder.

    `script` holds, by file, what happens instead at its next requests, `greetings` what happens at the next questions
    whether the server is there.
    """

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.folder = folder
        self.script: dict[str, list[object]] = {}
        self.greetings: list[object] = []
        self.requests: Counter[str] = Counter()
        self.open_after = 10**9
        self.lock = threading.Lock()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/some/folder/"

    def handle_error(self, request, client_address) -> None:
        """A client that hangs up is no trouble."""


class Handler(http.server.BaseHTTPRequestHandler):
    server: Server

    def log_message(self, format: str, *args: object) -> None:
        pass

    def do_HEAD(self) -> None:
        step = self.server.greetings.pop(0) if self.server.greetings else 404
        if step == "hang up":
            self.close_connection = True
            return
        if step == "stall":
            time.sleep(3)
        self.send_error(step if isinstance(step, int) else 404)

    def do_GET(self) -> None:
        name = urllib.parse.unquote(self.path).removeprefix("/some/folder/")
        with self.server.lock:
            self.server.requests[name] += 1
            dead = self.server.requests.total() > self.server.open_after
            steps = self.server.script.get(name, [])
            step = "hang up" if dead else steps.pop(0) if steps else None
        path = self.server.folder / name
        if step == "hang up":
            self.close_connection = True
            return
        if isinstance(step, int):
            self.send_error(step)
            return
        if not path.is_file():
            self.send_error(404)
            return
        body = path.read_bytes()
        if step == "stall":
            time.sleep(3)
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if step == "changed":
            body = body[:-1] + bytes([body[-1] ^ 1])
        self.wfile.write(body[: len(body) // 2] if step == "cut" else body)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    for index in range(12):
        path = folder / ("list.csv" if index == 0 else f"full/{'train' if index % 2 else 'test'}/a {index}.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes([index]) * (100 + 5000 * index))
    return folder


@pytest.fixture
def manifest(tmp_path: Path, source: Path) -> Path:
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(source).as_posix()}"
        for path in sorted(source.rglob("*"))
        if path.is_file()
    ]
    path = tmp_path / "manifest.sha256"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def server(source: Path, monkeypatch):
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pooch.core.time", types.SimpleNamespace(sleep=lambda _seconds: None))
    with Server(source) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture
def cache(tmp_path: Path, monkeypatch) -> Path:
    """The folder of downloads."""
    monkeypatch.setenv("DC2G_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def fetch(cache: Path, server: Server, manifest: Path):
    return functools.partial(fetch_dataset, urls=(server.url,), manifest=manifest)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def only_whole_files(cache: Path, source: Path) -> bool:
    return contents(cache / FOLDER_NAME).items() <= contents(source).items()


# --- success --------------------------------------------------------------------------------------------


def test_download_is_complete_and_happens_once(fetch, source, server, tmp_path, capsys):
    folder = fetch()
    assert folder == tmp_path / "cache" / FOLDER_NAME
    assert contents(folder) == contents(source)
    assert os.listdir(folder.parent) == [FOLDER_NAME]
    assert set(server.requests.values()) == {1}
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "12/12" in captured.err
    assert fetch() == folder
    assert server.requests.total() == 12
    assert capsys.readouterr() == ("", "")


def test_no_thread_is_left_behind(fetch):
    fetch()
    until = time.monotonic() + 2
    while time.monotonic() < until and any(t.name.startswith("dc2g-download") for t in threading.enumerate()):
        time.sleep(0.01)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("dc2g-download")]


def test_trouble_that_passes_is_tried_again(fetch, source, server):
    server.script = {
        "list.csv": [503],
        "full/train/a 1.png": ["cut"],
        "full/test/a 2.png": [500, "hang up"],
        "full/train/a 3.png": [429, "cut"],
    }
    assert contents(fetch()) == contents(source)
    assert server.requests["full/test/a 2.png"] == 3


def test_download_goes_to_the_cache_of_the_environment(server, manifest, source, tmp_path, monkeypatch):
    monkeypatch.setenv("DC2G_CACHE", str(tmp_path / "chosen"))
    folder = fetch_dataset(urls=(server.url,), manifest=manifest)
    assert folder == tmp_path / "chosen" / FOLDER_NAME
    assert contents(folder) == contents(source)


def test_the_next_address_is_asked_where_the_first_lacks_the_file(fetch, server, source):
    folder = fetch(urls=(server.url + "moved/", server.url))
    assert contents(folder) == contents(source)


@needs_shared
def test_the_published_dataset_through_the_shipped_manifest(cache, server):
    server.folder = PUBLISHED
    folder = fetch_dataset(urls=(server.url,))
    assert matches_published(folder)
    assert len(contents(folder)) == 81
    for name, data in contents(folder).items():
        assert (PUBLISHED / name).read_bytes() == data
    (folder / "labels_colors.csv").write_bytes(b"")
    assert not matches_published(folder)


def test_shipped_manifest_lists_every_house_list_palette_and_image():
    entries = read_manifest()
    assert len(entries) == 77 + 3 + 1
    assert sum(name.startswith("full_semantic/") and name.endswith(".png") for name in entries) == 77
    assert URLS[0].endswith("/6f739e1/data/datasets/driveways_bing_iros19/")


# --- interruption and company ---------------------------------------------------------------------------


def test_a_server_that_dies_midway_leaves_whole_files_and_the_rest_is_fetched_later(fetch, server, source, tmp_path):
    server.open_after = 6
    refusal_of(InputError, fetch, "6 of 12 files are kept", "run again")
    assert only_whole_files(tmp_path / "cache", source)
    assert len(contents(tmp_path / "cache")) == 6
    server.open_after = 10**9
    server.requests.clear()
    assert contents(fetch()) == contents(source)
    assert server.requests.total() == 12 - 6


def test_a_complete_cache_needs_no_network(fetch, server, source, tmp_path):
    shutil.copytree(source, tmp_path / "cache" / FOLDER_NAME)
    assert contents(fetch(urls=("http://127.0.0.1:9/",))) == contents(source)
    assert server.requests.total() == 0


def test_files_missing_from_the_cache_are_supplied_and_others_left_alone(fetch, server, source):
    folder = fetch()
    (folder / "full/train/a 1.png").unlink()
    shutil.rmtree(folder / "full/test")
    (folder / "notes.txt").write_text("mine")
    server.requests.clear()
    assert fetch() == folder
    assert contents(folder) == {**contents(source), "notes.txt": b"mine"}
    assert server.requests.total() == 1 + 5
    assert os.listdir(folder.parent) == [FOLDER_NAME]


def test_many_at_once_all_get_the_whole_dataset(fetch, server, source, tmp_path):
    outcomes: list[object] = []

    def call() -> None:
        try:
            folder = fetch()
            outcomes.append(all((folder / name).read_bytes() == data for name, data in contents(source).items()))
        except Exception as error:
            outcomes.append(error)

    threads = [threading.Thread(target=call) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert outcomes == [True] * 6
    assert contents(tmp_path / "cache" / FOLDER_NAME) == contents(source)


@pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")
def test_interrupt_ends_the_download_at_once_and_leaves_whole_files(cache, server, manifest, source):
    server.script = {f"full/train/a {index}.png": ["stall"] for index in range(1, 12, 2)}
    code = (
        # Where the tests run in the background, processes start with interrupts ignored.
        "import pathlib, signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from dc2g_jax._src.readers._download import fetch_dataset;"
        f"fetch_dataset(urls=({server.url!r},), manifest=pathlib.Path({str(manifest)!r}))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 10
    while server.requests.total() < 6 and time.monotonic() < until:
        time.sleep(0.02)
    time.sleep(0.1)
    started = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=10)
    assert time.monotonic() - started < 2  # the stalled server would hold it for 3
    assert process.returncode not in (0, None)
    assert errors.rstrip().endswith("KeyboardInterrupt")
    assert only_whole_files(cache, source)


# --- what is refused ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["list.csv", "full/train/a 11.png"])
def test_a_file_other_than_the_published_one(fetch, server, source, tmp_path, name):
    server.script = {name: ["changed"] * 9}
    data = (source / name).read_bytes()
    right, wrong = (hashlib.sha256(d).hexdigest() for d in (data, data[:-1] + bytes([data[-1] ^ 1])))
    refusal_of(InputError, fetch, name, right, wrong, "--dataset", "try again")
    assert only_whole_files(tmp_path / "cache", source)


@pytest.mark.parametrize("name", ["full/test/a 10.png", "list.csv"])
def test_a_file_that_is_gone_from_the_server(fetch, server, source, tmp_path, name):
    (source / name).unlink()
    refusal_of(InputError, fetch, server.url + name.replace(" ", "%20"), "404", "--dataset", "DC2G_DATA")
    assert only_whole_files(tmp_path / "cache", source)


#: The first file that is asked for, and one of those after it.
_FIRST, _LATER = "full/test/a 10.png", "full/train/a 11.png"


@pytest.mark.parametrize("name", [_FIRST, _LATER])
@pytest.mark.parametrize("status", [503, 429, 403])
def test_a_server_that_refuses_is_no_missing_network(fetch, server, source, name, status, tmp_path):
    server.greetings = [status]
    server.script = {name: [status] * 9}
    refusal_of(InputError, fetch, server.url + name.replace(" ", "%20"), f"{status} ", "run again", "--dataset")
    assert server.requests[name] == 3
    assert only_whole_files(tmp_path / "cache", source)


@pytest.mark.parametrize("name", [_FIRST, _LATER])
@pytest.mark.parametrize(("step", "words"), [("cut", "bytes read"), ("hang up", "closed")])
def test_a_connection_that_breaks_every_time_is_no_missing_network(fetch, server, source, tmp_path, name, step, words):
    server.script = {name: [step] * 9}
    refusal_of(InputError, fetch, tmp_path, words, "files are kept")
    assert server.requests[name] == 3
    assert only_whole_files(tmp_path / "cache", source)


def test_a_connection_that_breaks_before_any_answer_is_a_missing_network(fetch, server, tmp_path):
    server.greetings = ["hang up"]
    refusal_of(NetworkUnavailable, fetch, "127.0.0.1", "closed")
    assert not (tmp_path / "cache").exists()


def test_no_network_is_found_out_fast_and_nothing_is_written(fetch, tmp_path):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{unused.getsockname()[1]}/"
        started = time.monotonic()
        refusal_of(NetworkUnavailable, lambda: fetch(urls=(url,)), "127.0.0.1", "refused")
    refusal_of(NetworkUnavailable, lambda: fetch(urls=("http://no-such-host.invalid/",)), "no-such-host.invalid")
    assert time.monotonic() - started < 5
    assert not (tmp_path / "cache").exists()


def test_a_network_that_swallows_everything_is_found_out_in_time(fetch, server, tmp_path, monkeypatch):
    monkeypatch.setattr(_download, "_PROBE_SECONDS", 0.3)
    server.greetings = ["stall"]
    started = time.monotonic()
    refusal_of(NetworkUnavailable, fetch, "127.0.0.1", "no answer within 0.3 s")
    assert time.monotonic() - started < 2
    assert not (tmp_path / "cache").exists()


def test_a_read_that_takes_too_long_is_tried_again(fetch, server, source, monkeypatch):
    monkeypatch.setattr(_download, "_TIMEOUT_SECONDS", 0.3)
    server.script = {"full/train/a 11.png": ["stall"]}
    assert contents(fetch()) == contents(source)
    assert server.requests["full/train/a 11.png"] == 2


def test_a_changed_file_in_the_cache(fetch, server, source):
    folder = fetch()
    path = folder / "full" / "train" / "a 1.png"
    right = hashlib.sha256(path.read_bytes()).hexdigest()
    path.write_bytes(b"other")
    wrong = hashlib.sha256(b"other").hexdigest()
    refusal_of(InputError, fetch, path, right, wrong, "delete the file")
    assert path.read_bytes() == b"other"


def test_a_cache_that_cannot_be_written(fetch, cache, server, source):
    cache.write_text("x")
    refusal_of(InputError, fetch, cache, "DC2G_CACHE")
    cache.unlink()
    cache.mkdir()
    (cache / FOLDER_NAME).write_text("x")
    refusal_of(InputError, fetch, cache / FOLDER_NAME, "DC2G_CACHE")


def test_a_cache_folder_that_may_not_be_created(fetch, tmp_path, monkeypatch):
    def deny(path, **_options):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "mkdir", deny)
    refusal_of(InputError, fetch, tmp_path / "cache", "Permission denied", "DC2G_CACHE")
