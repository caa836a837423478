"""Where things lie: the repository, and beside it the recorded data and datasets, where there are any."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
PUBLISHED = SHARED / "datasets" / "driveways_bing_iros19"
