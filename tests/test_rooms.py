"""Imports go down: rooms know no room above them, and clients of the package only know its public names."""

import ast
import graphlib
import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.places import ROOT

PACKAGE = ROOT / "dc2g_jax"
SRC = PACKAGE / "_src"

#: Sub-packages that use the core as any other package can.
CLIENTS = ("demo", "families", "gymnasium", "indoor", "onnx", "osm", "rivals", "robot")


def imports(path: Path) -> Iterator[str]:
    """What a module imports, anywhere in it: `module.name`, or the module itself."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def arrows(folder: Path) -> dict[str, set[str]]:
    """Room -> the other rooms of the folder that its modules import from."""
    prefix = (*folder.relative_to(ROOT).parts,)
    found: dict[str, set[str]] = {room.name: set() for room in folder.iterdir() if (room / "__init__.py").exists()}
    for room, others in found.items():
        parts = [name.split(".") for path in (folder / room).rglob("*.py") for name in imports(path)]
        others |= {part[len(prefix)] for part in parts if (*part[: len(prefix)],) == prefix}
        others &= found.keys() - {room}
    return found


@pytest.mark.parametrize("folder", [SRC, PACKAGE / "indoor", PACKAGE / "robot"], ids=lambda folder: folder.name)
def test_no_circle_of_rooms(folder):
    found = arrows(folder)
    order = list(graphlib.TopologicalSorter(found).static_order())
    if folder == SRC:
        assert order.index("grid") < order.index("rollouts") < order.index("training") < order.index("cli")
    elif folder == PACKAGE / "indoor":
        assert (order[0], order[-1]) == ("maps", "search")
    else:
        assert found == {"driving": set(), "mapping": set()}


def public(name: str) -> bool:
    """Whether a module of the package, or a name in one, is for its users."""
    module, _, attribute = name.rpartition(".")
    if any(part.startswith("_") for part in name.split(".")):
        return False
    if module == "dc2g_jax" or module.count(".") == 1:
        return hasattr(importlib.import_module(module), attribute)
    return False


@pytest.mark.parametrize("client", CLIENTS)
def test_clients_only_import_public_names(client):
    own = f"dc2g_jax.{client}"
    found = {name for path in (PACKAGE / client).rglob("*.py") for name in imports(path)}
    foreign = {name for name in found if name.split(".")[0] == "dc2g_jax" and not f"{name}.".startswith(f"{own}.")}
    assert {name for name in foreign if not public(name)} == set()


def test_clients_know_only_clients_below_them():
    found = arrows(PACKAGE)
    known = {client: found[client] & {*CLIENTS} for client in CLIENTS}
    assert known == {client: set() for client in CLIENTS} | {"indoor": {"families", "robot"}, "osm": {"families"}}


def test_the_core_names_no_client():
    paths = [*SRC.rglob("*.py"), *PACKAGE.glob("*.py"), *PACKAGE.glob("*.pyi")]
    for path in paths:
        strings = [
            node.value
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        ]
        names = [*imports(path), *strings]
        assert [name for name in names for client in CLIENTS if f"dc2g_jax.{client}" in name] == [], path
