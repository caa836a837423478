"""The real commands, run as users run them."""

import subprocess
import sys

from tests.support.places import ROOT


def run(*arguments: object) -> subprocess.CompletedProcess:
    """Run `python -m experiments.<arguments>`."""
    command = [sys.executable, "-m", *(str(argument) for argument in arguments)]
    command[2] = f"experiments.{command[2]}"
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)


def complaint(result: subprocess.CompletedProcess) -> str:
    """The one line a refused command prints."""
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    return lines[0]
