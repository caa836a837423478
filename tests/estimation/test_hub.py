"""Networks on a Hub: a small server on this machine that keeps files as the real one does."""

import base64
import hashlib
import json
import shutil
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import jax
import numpy as np
import pytest

import dc2g_jax as dc2g
from dc2g_jax._src.estimation.hub import local_folder
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.runtime.errors import InputError
from tests.support.refusals import refusal

constants = pytest.importorskip("huggingface_hub.constants")

COMPACT, INDOORS = resource("weights/compact_unet"), resource("weights/cost_maps_indoors")


class Hub(BaseHTTPRequestHandler):
    """What is asked of the Hub to save a repository and to download it. Repository -> file -> content."""

    repositories: dict[str, dict[str, bytes]]

    def log_message(self, *words):
        pass

    def answer(self, content=b"", status=200, **headers):
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        for name, value in {"Content-Length": len(body), "X-Request-Id": "1", **headers}.items():
            self.send_header(name.replace("_", "-"), str(value))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def do_POST(self):
        data = self.rfile.read(int(self.headers["Content-Length"] or 0))
        parts = self.path.strip("/").split("/")  # api models OWNER NAME WHAT main
        if parts[:3] == ["api", "repos", "create"]:
            asked = json.loads(data)
            name = f"{asked['organization']}/{asked['name']}"
            self.repositories.setdefault(name, {})
            return self.answer({"url": f"https://huggingface.co/{name}", "id": name, "name": name})
        files = self.repositories["/".join(parts[2:4])]
        if parts[4] == "preupload":
            names = [file["path"] for file in json.loads(data)["files"]]
            kept = [{"path": name, "uploadMode": "regular", "shouldIgnore": False} for name in names]
            return self.answer({"files": kept})
        for line in map(json.loads, data.splitlines()):
            if line["key"] == "file":
                files[line["value"]["path"]] = base64.b64decode(line["value"]["content"])
        address = f"https://huggingface.co/{'/'.join(parts[2:4])}/commit/{'1' * 40}"
        return self.answer({"commitUrl": address, "commitOid": "1" * 40})

    def do_GET(self):
        parts = self.path.partition("?")[0].strip("/").split("/")
        asked = parts[2:4] if parts[:2] == ["api", "models"] else parts[:2]
        files = self.repositories.get("/".join(asked))
        if files is None:
            return self.answer({"error": "Repository not found"}, 404, X_Error_Code="RepoNotFound")
        if parts[0] == "api" and parts[4] == "tree":
            entries = [{"type": "file", "path": name, "size": len(data), "oid": "0"} for name, data in files.items()]
            return self.answer(entries)
        if parts[0] == "api":
            siblings = [{"rfilename": name, "size": len(data)} for name, data in files.items()]
            return self.answer({"id": "/".join(asked), "sha": "1" * 40, "siblings": siblings})
        content = files["/".join(parts[4:])]  # OWNER NAME resolve REVISION FILE
        etag = hashlib.sha256(content).hexdigest()
        return self.answer(content, ETag=f'"{etag}"', X_Repo_Commit="1" * 40)

    do_HEAD = do_GET


def at(endpoint: str, monkeypatch) -> None:
    """Have the Hub elsewhere, as HF_ENDPOINT does before its library is imported."""
    monkeypatch.setattr(constants, "ENDPOINT", endpoint)
    template = "{repo_id}/resolve/{revision}/{filename}"
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", f"{endpoint}/{template}")


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A Hub with no repository: its files by repository, which tests may change."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("OwnHub", (Hub,), {"repositories": {}}))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    at(f"http://127.0.0.1:{server.server_port}", monkeypatch)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("HF_TOKEN", "hf_test")
    yield server.RequestHandlerClass.repositories
    server.shutdown()
    server.server_close()


def test_a_network_travels(hub, tmp_path):
    network = dc2g.load_network()
    assert dc2g.estimation.push(COMPACT, "hf://someone/network").endswith("/commit/" + "1" * 40)
    assert set(hub["someone/network"]) == {"network.json", "weights.safetensors"}
    found = dc2g.load_network("hf://someone/network")
    assert found.architecture == network.architecture
    jax.tree.map(np.testing.assert_array_equal, found.weights, network.weights)
    assert dc2g.make_planner("dc2g", network="hf://someone/network").estimator.architecture == network.architecture


def test_a_folder_travels_with_its_card_and_nothing_else(hub, tmp_path):
    folder = shutil.copytree(COMPACT, tmp_path / "network")
    (folder / "notes.txt").write_text("private")
    dc2g.estimation.push(folder, "hf://someone/network")
    there = local_folder("hf://someone/network")
    assert {path.name for path in there.iterdir()} == {"network.json", "weights.safetensors"}
    assert (there / "network.json").read_bytes() == (COMPACT / "network.json").read_bytes()


def test_an_indoor_network_travels_with_its_encoder(hub):
    from dc2g_jax.indoor.learning.networks import load_costs

    dc2g.estimation.push(INDOORS, "hf://someone/indoors")
    costs, own = load_costs("hf://someone/indoors"), load_costs(INDOORS)
    jax.tree.map(np.testing.assert_array_equal, costs.weights, own.weights)


def test_what_cannot_be_used_is_refused_in_a_line(hub, tmp_path):
    dc2g.estimation.push(COMPACT, "hf://someone/network")
    refusal(
        lambda: dc2g.load_network("hf://someone/else"), "hf://someone/else", "cannot be downloaded", "check the name"
    )
    for place in ("hf://network", "hf://some one/network/weights"):
        refusal(lambda place=place: dc2g.load_network(place), place, "not a network on the Hub", "hf://owner/name")
    refusal(lambda: dc2g.estimation.push(COMPACT, str(tmp_path)), "not a network on the Hub")
    refusal(lambda: dc2g.estimation.push(tmp_path, "hf://someone/empty"), str(tmp_path), "holds no network.json")
    assert "someone/empty" not in hub
    weights = hub["someone/network"]["weights.safetensors"]
    hub["someone/network"]["weights.safetensors"] = weights[:-4] + b"\0\0\0\0"
    refusal(lambda: dc2g.load_network("hf://someone/network"), "SHA-256", "network.json")


@pytest.mark.parametrize("where", ["kind", "class"])
def test_a_card_from_the_hub_chooses_no_code_to_import(hub, where):
    dc2g.estimation.push(COMPACT, "hf://someone/network")
    card = json.loads(hub["someone/network"]["network.json"])
    (card if where == "kind" else card["architecture"])["network"] = "antigravity:Flight"
    hub["someone/network"]["network.json"] = json.dumps(card).encode()
    refusal(
        lambda: dc2g.load_network("hf://someone/network"),
        "hf://someone/network",
        "'antigravity:Flight'",
        "if you trust",
    )


def test_without_a_connection_the_last_download_is_used(hub, monkeypatch):
    dc2g.estimation.push(COMPACT, "hf://someone/network")
    downloaded = local_folder("hf://someone/network")
    at("http://127.0.0.1:9", monkeypatch)
    assert local_folder("hf://someone/network") == downloaded
    refusal(lambda: local_folder("hf://someone/else"), "hf://someone/else", "cannot be downloaded", "the connection")
    refusal(lambda: dc2g.estimation.push(COMPACT, "hf://someone/network"), "cannot be saved", "hf auth login")


def test_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda module: None)
    with pytest.raises(InputError, match=r'huggingface_hub: not installed; run: pip install "dc2g_jax\[hub\]"'):
        dc2g.load_network("hf://someone/network")
