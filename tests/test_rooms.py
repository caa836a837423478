"""Imports go down: no room knows of a room above it, in the package and among the inner rooms of `search_indoors`."""

import ast
import graphlib
from pathlib import Path

import pytest

from tests.support.places import ROOT

SRC = ROOT / "dc2g_jax" / "_src"


def arrows(folder: Path) -> dict[str, set[str]]:
    """Room -> the other rooms of the folder that its modules import from, anywhere in them."""
    prefix = (*folder.relative_to(ROOT).parts,)
    found: dict[str, set[str]] = {room.name: set() for room in folder.iterdir() if (room / "__init__.py").exists()}
    for room, others in found.items():
        for path in (folder / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    names = [f"{node.module}.{alias.name}" for alias in node.names]
                parts = [name.split(".") for name in names]
                others |= {part[len(prefix)] for part in parts if (*part[: len(prefix)],) == prefix}
        others &= found.keys() - {room}
    return found


@pytest.mark.parametrize("folder", [SRC, SRC / "search_indoors"], ids=lambda folder: folder.name)
def test_no_circle_of_rooms(folder):
    found = arrows(folder)
    order = list(graphlib.TopologicalSorter(found).static_order())
    if folder.name == "search_indoors":
        assert order == ["maps", "houses", "learning", "search"]
    else:
        assert order.index("grid") < order.index("rollouts") < order.index("search_indoors") < order.index("cli")
