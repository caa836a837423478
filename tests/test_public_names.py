"""The package's front door: public names, imported when they are asked for."""

import re
import subprocess
import sys
import tomllib

import pytest

import dc2g_jax
from tests.support.places import ROOT
from tests.support.refusals import refusal


def modules_after(code: str) -> set[str]:
    """The modules that a new Python has loaded after some code."""
    program = f"{code}\nimport sys; print(*sys.modules)"
    return set(
        subprocess.run([sys.executable, "-c", program], capture_output=True, check=True, text=True).stdout.split()
    )


def test_importing_the_package_imports_nothing_else():
    loaded = modules_after("import dc2g_jax as dc2g; assert 'evaluate' in dir(dc2g); dc2g.InputError")
    assert {name for name in loaded if name.startswith("dc2g_jax")} == {"dc2g_jax", "dc2g_jax.errors"}
    assert not loaded & {"jax", "numpy"}


def test_planners_come_without_what_only_figures_and_files_need():
    loaded = modules_after("import dc2g_jax as dc2g; dc2g.OnlinePlanner, dc2g.evaluate, dc2g.make('frontier')")
    assert "jax" in loaded
    assert not loaded & {"matplotlib", "rerun", "orbax", "tyro"}


@pytest.mark.parametrize("name", dc2g_jax.__all__)
def test_every_public_name_is_there(name):
    found = getattr(dc2g_jax, name)
    assert getattr(found, "__name__", name) == name
    assert not callable(found) or found.__doc__


def test_the_reference_lists_every_name():
    page = (ROOT / "docs" / "reference" / "public_names.md").read_text()
    shown = set(re.findall(r"\[dc2g_jax\.[\w.]+\.(\w+)\]", page))
    assert shown == set(dc2g_jax.__all__) - {"__version__"}


def test_the_version_is_that_of_the_package():
    assert dc2g_jax.__version__ == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_a_name_that_is_none():
    with pytest.raises(AttributeError, match="evaluat"):
        dc2g_jax.evaluat  # noqa: B018


def test_environments_by_name():
    env, params = dc2g_jax.make_env("FrontDoor-v0", dataset="procedural", split="val", sensing_range=5)
    assert (env.sensing.radius, env.observation_shape(params)) == (5, (50, 50))
    refusal(lambda: dc2g_jax.make_env("FrontDoor-v1"), "FrontDoor-v1", "FrontDoor-v0")
