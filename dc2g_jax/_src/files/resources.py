"""Resource files of the package: manifests, tables and weights."""

from pathlib import Path

_DATA = Path(__file__).resolve().parents[2] / "data"


def resource(name: str) -> Path:
    """Return the path of a resource file or folder, e.g. `resource("driveways_bing_iros19.sha256")`.

    The path is not checked for existence.
    """
    return _DATA / name
