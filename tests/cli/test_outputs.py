"""Output folders: never overwritten, and they say how they were made."""

import dataclasses
import json
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from dc2g_jax._src.cli.outputs import commit, folder_in_use, output_folder
from dc2g_jax._src.files.atomic import replacing
from dc2g_jax._src.runtime.errors import InputError


@dataclasses.dataclass(frozen=True)
class Group:
    steps: int = 5
    minutes: float = 2.0


@dataclasses.dataclass(frozen=True)
class Options:
    out: Path | None = None
    network: Path | None = None
    seeds: tuple[int, ...] = (0, 1)
    training: Group = dataclasses.field(default_factory=Group)


@dataclasses.dataclass(frozen=True)
class OnHouses(Options):
    dataset: str | None = None


@dataclasses.dataclass(frozen=True)
class Resumable(Options):
    resume: bool = False


def test_a_folder_says_how_it_was_made(tmp_path):
    folder = output_folder(Options(out=tmp_path / "deep" / "run", network=Path("weights")), "wander")
    facts = json.loads((folder / "run.json").read_text())
    assert facts["experiment"] == "wander"
    assert facts["options"] == {
        "out": str(tmp_path / "deep" / "run"), "network": "weights", "seeds": [0, 1], "training.steps": 5,
        "training.minutes": 2.0,
    }  # fmt: skip
    (only,) = facts["runs"]
    assert only["command"].startswith("python -m ")
    assert only["versions"]["jax"] == jax.__version__
    assert set(only) == {"command", "began", "commit", "versions"}


def test_a_folder_names_the_houses_that_the_environment_gave(tmp_path, monkeypatch):
    monkeypatch.setenv("DC2G_DATA", "procedural")

    def noted(name: str, dataset: str | None) -> dict:
        output_folder(OnHouses(out=tmp_path / name, dataset=dataset), "wander")
        return json.loads((tmp_path / name / "run.json").read_text())["runs"][0]

    assert noted("by_environment", None)["DC2G_DATA"] == "procedural"
    assert "DC2G_DATA" not in noted("by_option", "houses")
    monkeypatch.delenv("DC2G_DATA")
    assert "DC2G_DATA" not in noted("by_download", None)


def test_without_a_folder_a_new_one_is_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert output_folder(Options(), "wander").parent == Path("outputs")


def test_a_folder_in_use_is_refused(tmp_path):
    (tmp_path / "results.csv").write_text("mine")
    with pytest.raises(InputError, match=r"not an empty folder; give --out a new folder$"):
        output_folder(Options(out=tmp_path), "wander")
    with pytest.raises(InputError, match=r"a new folder$"):  # no run is in it, so none can be resumed
        output_folder(Resumable(out=tmp_path), "wander")
    assert [path.name for path in tmp_path.iterdir()] == ["results.csv"]
    with pytest.raises(InputError, match="not an empty folder"):
        output_folder(Options(out=tmp_path / "results.csv"), "wander")
    with pytest.raises(InputError, match="cannot be written"):
        output_folder(Options(out=tmp_path / "results.csv" / "below"), "wander")


def test_a_run_is_resumed_with_the_options_it_was_begun_with(tmp_path):
    options = Resumable(out=tmp_path / "run")
    output_folder(options, "wander")
    with pytest.raises(InputError, match="add --resume"):
        output_folder(options, "wander")
    again = dataclasses.replace(options, resume=True)
    output_folder(again, "wander")
    facts = json.loads((tmp_path / "run" / "run.json").read_text())
    assert len(facts["runs"]) == 2
    other = dataclasses.replace(again, training=Group(minutes=3.0))
    with pytest.raises(InputError, match=r"begun with --minutes 2\.0, now it is 3\.0"):
        output_folder(other, "wander")
    output_folder(other, "wander", free=("minutes",))
    with pytest.raises(InputError, match="a run of 'wander', not of rest"):
        output_folder(again, "rest")


def test_a_run_is_resumed_with_what_it_has_read(tmp_path):
    options = Resumable(out=tmp_path / "run")
    output_folder(options, "wander", inputs={"dataset": "1a", "noisy_network": "2b"})
    again = dataclasses.replace(options, resume=True)
    output_folder(again, "wander", inputs={"dataset": "1a", "noisy_network": "2b"})
    with pytest.raises(InputError, match=r"what is read for --noisy-network has changed .* give --out another"):
        output_folder(again, "wander", inputs={"dataset": "1a", "noisy_network": "3c"})
    with pytest.raises(InputError, match="what is read for --starts has changed"):
        output_folder(again, "wander", inputs={"dataset": "1a", "noisy_network": "2b", "starts": "4d"})
    assert len(json.loads((tmp_path / "run" / "run.json").read_text())["runs"]) == 2


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX locks of files")
def test_a_folder_that_another_process_writes_to_is_refused(tmp_path):
    run = tmp_path / "run"
    command = (
        "import pathlib, sys; from tests.cli.test_outputs import Resumable, output_folder; "
        "output_folder(Resumable(out=pathlib.Path(sys.argv[1])), 'wander'); print(flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", command, str(run)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=Path(__file__).resolve().parents[2],
    ) as other:
        assert other.stdout.readline() == b"\n"
        with pytest.raises(InputError, match="another process is writing to it; wait for its end"):
            output_folder(Resumable(out=run, resume=True), "wander")
        (run / "network").mkdir()
        with replacing(run / "network" / "network.json") as unfinished:
            unfinished.write_text("{}")
            shutil.copy(unfinished, unfinished.with_stem(f"{unfinished.stem}9"))  # of a writer that was killed
        other.communicate(b"\n")
    output_folder(Resumable(out=run, resume=True), "wander")
    assert sorted(path.name for path in run.rglob("*")) == ["network", "network.json", "run.json"]
    assert folder_in_use() == run.resolve()


def test_a_run_that_was_killed_before_it_wrote_anything_can_be_begun_again(tmp_path):
    (tmp_path / "run").mkdir()
    with replacing(tmp_path / "run" / "run.json") as unfinished:
        unfinished.write_text("{}")
        left = shutil.copy(unfinished, unfinished.with_stem(f"{unfinished.stem}9"))
    (tmp_path / "run" / "run.json").unlink()
    options = Resumable(out=tmp_path / "run")
    with pytest.raises(InputError, match="leave out --resume to begin one"):
        output_folder(dataclasses.replace(options, resume=True), "wander")
    assert Path(left).exists()
    output_folder(options, "wander")
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["run.json"]


def test_without_git_the_commit_is_unknown(monkeypatch):
    def missing(*arguments, **options):
        raise FileNotFoundError("git")

    monkeypatch.setattr(subprocess, "run", missing)
    assert commit.__wrapped__() == "unknown"


def test_what_cannot_be_resumed_is_refused(tmp_path):
    with pytest.raises(InputError, match="which run"):
        output_folder(Resumable(resume=True), "wander")
    with pytest.raises(InputError, match="holds no run to resume"):
        output_folder(Resumable(out=tmp_path / "none", resume=True), "wander")
    for damaged in (
        "{", "[]", '{"options": 3, "runs": []}', '{"options": {}, "runs": [], "inputs": 0}', "[" * 100_000,
        '{"options": {}, "runs": [], "inputs": ' + "9" * 5000 + "}",
    ):  # fmt: skip
        (tmp_path / "run.json").write_text(damaged)
        with pytest.raises(InputError, match=r"run\.json: .*begin anew in another --out folder"):
            output_folder(Resumable(out=tmp_path, resume=True), "wander")
