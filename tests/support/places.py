"""Where things lie: the repository, and beside it the recorded data and datasets, where there are any."""

from pathlib import Path

from dc2g_jax._src.cli import commands

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"


def _experiments() -> dict[str, str]:
    """`python -m MODULE` -> MODULE, for all commands in `experiments`."""
    paths = sorted((ROOT / "experiments").rglob("*.py"))
    found = [path for path in paths if "command_line(Options" in path.read_text()]
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in found]
    return {f"python -m {module}": module for module in modules}


#: All commands: as they are typed -> their modules.
COMMANDS = {f"dc2g {name}": module for name, (module, _) in commands.COMMANDS.items()} | _experiments()

PUBLISHED = SHARED / "datasets" / "driveways_bing_iros19"
