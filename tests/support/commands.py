"""The real commands, run as users run them."""

import subprocess
import sys

from dc2g_jax._src.cli import commands
from tests.support.places import ROOT


def _experiments() -> dict[str, str]:
    """`python -m MODULE` -> MODULE, for all commands in `experiments`."""
    paths = sorted((ROOT / "experiments").rglob("*.py"))
    found = [path for path in paths if "command_line(Options" in path.read_text()]
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in found]
    return {f"python -m {module}": module for module in modules}


#: All commands: as they are typed -> their modules.
COMMANDS = {f"dc2g {name}": module for name, (module, _) in commands.COMMANDS.items()} | _experiments()


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
