"""Where things lie: the repository, and beside it the recorded data and datasets, where there are any."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"

#: Files of the commands, those of the package and those that measure it.
COMMANDS = [
    path
    for folder in ("dc2g_jax/_src/cli/commands", "experiments")
    for path in sorted((ROOT / folder).glob("*.py"))
    if "command_line(Options" in path.read_text()
]

PUBLISHED = SHARED / "datasets" / "driveways_bing_iros19"
