"""The real commands, run as users run them."""

import subprocess
import sys

from tests.support.places import ROOT


def run(*arguments: object) -> subprocess.CompletedProcess:
    """Run a command: the first argument is `dc2g NAME`, or the name of an experiment."""
    name, *options = map(str, arguments)
    words = ["dc2g_jax", *name.split()[1:]] if name.startswith("dc2g ") else [f"experiments.{name}"]
    command = [sys.executable, "-m", *words, *options]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)


def complaint(result: subprocess.CompletedProcess) -> str:
    """The one line a refused command prints."""
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    return lines[0]
