"""The command `dc2g`, and what a wheel installs."""

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from dc2g_jax._src.cli import commands
from tests.support.places import ROOT


def ended(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """The exit status of `dc2g WORDS`, run in this process."""
    monkeypatch.setattr(sys, "argv", ["/somewhere/bin/dc2g", *words])
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setenv("TQDM_MININTERVAL", os.environ.get("TQDM_MININTERVAL", "0.1"))
    try:
        commands.main()
    except SystemExit as stopped:
        return int(stopped.code or 0)
    return 0


def test_every_command_has_a_name():
    with_options = [path for path in (ROOT / "dc2g_jax").rglob("*.py") if "\nclass Options(" in path.read_text()]
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in with_options]
    assert sorted(module for module, _ in commands.COMMANDS.values()) == sorted(modules)


def test_the_list_of_commands_loads_nothing(monkeypatch, capsys):
    start = "import sys; from dc2g_jax._src.cli import commands; commands.main()"
    code = f"{start}; assert not {{'jax', 'numpy'}} & {{*sys.modules}}"
    shown = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert all(f"  {name} " in shown for name in commands.COMMANDS)
    assert ended(monkeypatch, "--help") == 0
    assert capsys.readouterr().out == shown


@pytest.mark.parametrize(("name", "is_shared"), [("compare", True), ("map explore", False), ("train", True)])
def test_help_names_the_command_as_it_is_typed_and_machines_last(name, is_shared, monkeypatch, capsys):
    assert ended(monkeypatch, *name.split(), "--help") == 0
    shown = capsys.readouterr().out
    assert f"usage: dc2g {name} " in shown
    assert not re.search(r"\{None\}\||experiments\.", shown)
    groups = re.findall(r"(\w+) options \W", shown)
    assert "machine" not in groups[:-1]
    assert ("machine" in groups) == is_shared


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["trian"], "did you mean dc2g train?"),
        (["mapp"], "did you mean dc2g map?"),
        (["map", "exploer"], "did you mean dc2g map explore?"),
        (["map", "--dataset"], "dc2g map check or dc2g map explore"),
        (["xyzzy"], "dc2g --help lists all"),
    ],
)
def test_a_command_that_is_none(words, meant, monkeypatch, capsys):
    assert ended(monkeypatch, *words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: no command is called '{' '.join(words)}'")
    assert meant in line


@pytest.mark.parametrize("words", [["map"], ["map", "--help"], ["map", "-h"]])
def test_a_group_alone_lists_its_commands(words, monkeypatch, capsys):
    assert ended(monkeypatch, *words) == 0
    usage, *lines = capsys.readouterr().out.splitlines()
    assert usage == "usage: dc2g map COMMAND [OPTIONS]"
    shown = [line.partition("  ")[2].partition("  ")[0].strip() for line in lines if line.startswith("  ")]
    assert shown == [name for name in commands.COMMANDS if name.startswith("map ")]


def test_the_version_is_that_of_the_package(monkeypatch, capsys):
    assert ended(monkeypatch, "--version") == 0
    assert capsys.readouterr().out == f"dc2g {importlib.metadata.version('dc2g_jax')}\n"


def completed(script: Path, shell: str, *words: str) -> list[str]:
    """What a shell offers for the last of the words."""
    if shell == "bash":
        ask = 'source "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _tyro_dc2g; printf "%s\\n" "${COMPREPLY[@]}"'
    else:  # what zsh calls when a key is pressed, noting what would be shown
        ask = (
            '_describe() { print -l -- "${(@)${(@P)2}%%:*}" }; words=("$@"); CURRENT=$#; script=$0; set --; '
            'source "$script"'
        )
    command = [shell, "-c", ask, script, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_completes_commands_and_options(shell, tmp_path, monkeypatch, capsys):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    assert ended(monkeypatch, "--completion", shell) == 0
    script = tmp_path / "_dc2g"
    script.write_text(capsys.readouterr().out)
    assert {"draw", "demo"} <= {*completed(script, shell, "dc2g", "d")}
    assert {"check", "explore", "osm", "recording"} <= {*completed(script, shell, "dc2g", "map", "")}
    assert "--starts" in completed(script, shell, "dc2g", "run", "--st")


def test_a_completion_for_another_shell_is_refused(monkeypatch, capsys):
    assert ended(monkeypatch, "--completion", "fish") == 2
    assert capsys.readouterr().err == "error: --completion: give bash or zsh\n"


@pytest.mark.slow
def test_a_wheel_installs_one_package_and_the_command(tmp_path):
    """In an environment of its own, outside the repository, with this one's dependencies."""
    wheels, environment = tmp_path / "wheels", tmp_path / "environment"
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run(
        [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", wheels, ROOT], check=True, cwd=tmp_path
    )
    (wheel,) = wheels.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].partition("-")[0] for name in names} == {"dc2g_jax"}
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    subprocess.run([*pip, "--python", environment / "bin" / "python", "install", "--no-deps", wheel], check=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    dc2g = environment / "bin" / "dc2g"
    options = ["--family", "procedural", "--maps", "2", "--starts", "2", "--planner", "frontier", "mine:Mine"]
    (tmp_path / "mine.py").write_text("from dc2g_jax._src.planning.planners import Frontier as Mine\n")
    subprocess.run([dc2g, "compare", *options, "--out", "out"], check=True, cwd=tmp_path, env=bare)
    made = json.loads((tmp_path / "out" / "run.json").read_text())
    assert made["runs"][0]["command"].startswith("dc2g compare --family procedural ")
    assert (tmp_path / "out" / "leaderboard.md").stat().st_size > 0
