"""Resource files of the package: manifests, tables and weights."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def resource(name: str) -> Path:
    """Return the path of a resource file or folder, e.g. `resource("driveways_bing_iros19.sha256")`.

    A wheel contains the data inside the package (`dc2g_jax/data`). In an editable install they are in `data` at the
    root of the repository. The path is not checked for existence.
    """
    inside = _PACKAGE / "data"
    return (inside if inside.is_dir() else _PACKAGE.parent / "data") / name
