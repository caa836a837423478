"""The package's front door: public names, imported when they are asked for."""

import importlib
import re
import subprocess
import sys
import tomllib

import pytest

import dc2g_jax
from tests.support.places import ROOT
from tests.support.refusals import refusal

MODULES = sorted(path.stem for path in (ROOT / "dc2g_jax").glob("[!_]*.py"))


def modules_after(code: str) -> set[str]:
    """The modules that a new Python has loaded after some code."""
    program = f"{code}\nimport sys; print(*sys.modules)"
    return set(
        subprocess.run([sys.executable, "-c", program], capture_output=True, check=True, text=True).stdout.split()
    )


def test_importing_the_package_imports_nothing_else():
    loaded = modules_after("import dc2g_jax as dc2g; assert 'evaluate' in dir(dc2g); dc2g.InputError")
    ours = {name for name in loaded if name.startswith("dc2g_jax")}
    assert ours == {"dc2g_jax", "dc2g_jax._src", "dc2g_jax._src.runtime", "dc2g_jax._src.runtime.errors"}
    assert not loaded & {"gymnasium", "jax", "numpy"}


def test_importing_the_package_leaves_python_s_imports_alone():
    modules_after("import sys; finders = list(sys.meta_path); import dc2g_jax; assert sys.meta_path == finders")


#: What only the extra `all` installs. (flax installs optax and Orbax too.)
EXTRA_MODULES = {"cv2", "gymnasium", "matplotlib", "orbax", "rerun", "tyro"}

CORE = """
import sys
sys.modules.update(dict.fromkeys({modules}))  # so that their import fails

import numpy as np
import dc2g_jax as dc2g
from dc2g_jax.indoor import OnlineSearcher
from dc2g_jax.robot import plan_controls, render
from dc2g_jax._src.cli import commands

env, params = dc2g.make_env("FrontDoor-v0", dataset="procedural", split="val")
print(len(dc2g.evaluate("frontier", "procedural", split="val", starts_per_house=1, progress=False)))
seen = np.full((8, 9), 3, np.uint8)
print(dc2g.OnlinePlanner("frontier", largest=(8, 9)).plan(seen, (2, 3, 0)).mode)
print(type(dc2g.make_planner("dc2g")).__name__)
try:
    dc2g.plot_results
except dc2g.InputError as error:
    print(error)
sys.argv[1:] = ["train", "--help"]
commands.main()
"""


def test_planners_environments_and_the_network_come_without_the_extra():
    code = CORE.format(modules=sorted(EXTRA_MODULES))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines() == [
        "4",
        "gave_up",
        "LearnedScore",
        'cv2, matplotlib: not installed; run: pip install "dc2g_jax[all]"',
    ]
    assert (
        done.stderr == 'error: cv2, matplotlib, orbax, rerun, tyro: not installed; run: pip install "dc2g_jax[all]"\n'
    )
    assert done.returncode == 2


@pytest.mark.parametrize("name", dc2g_jax.__all__)
def test_every_public_name_is_there(name):
    found = getattr(dc2g_jax, name)
    assert getattr(found, "__name__", name).removeprefix("dc2g_jax.") == name
    assert not callable(found) or found.__doc__


def test_dir_lists_every_public_name_and_module():
    assert dir(dc2g_jax) == sorted(dc2g_jax.__all__)
    assert {"__version__", "evaluate", *MODULES} <= set(dir(dc2g_jax))


def test_the_reference_lists_every_name():
    page = (ROOT / "docs" / "reference" / "public_names.md").read_text()
    shown = set(re.findall(r"\[dc2g_jax\.[\w.]+\.(\w+)\]", page))
    assert shown == set(dc2g_jax.__all__) - {"__version__", *MODULES}


@pytest.mark.parametrize("name", MODULES)
def test_the_reference_lists_the_names_of_every_module(name):
    module = importlib.import_module(f"dc2g_jax.{name}")
    page = (ROOT / "docs" / "reference" / "public_names.md").read_text()
    row = re.search(rf"^\| `dc2g_jax\.{name}` \| (.*) \|$", page, flags=re.M)
    assert row is not None
    names = {one for one in vars(module) if not one.startswith("_")} - {"jaxtyping"}  # which checks shapes in tests
    assert set(re.findall(r"`(\w+)`", row[1])) == names - set(dc2g_jax.__all__)


def test_users_are_shown_public_names_only():
    pages = [ROOT / "README.md", *(ROOT / "docs" / "tutorials").glob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")]
    code = [*(ROOT / "examples").glob("*.py"), *(ROOT / "ros2").rglob("*.py")]
    shown = {path.name: re.findall(r"(?:from|import) dc2g_jax\._src.*", path.read_text()) for path in [*pages, *code]}
    assert not {name: lines for name, lines in shown.items() if lines}


def test_the_version_is_that_of_the_package():
    assert dc2g_jax.__version__ == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_a_name_that_is_none():
    with pytest.raises(AttributeError, match="evaluat"):
        dc2g_jax.evaluat  # noqa: B018


def test_environments_by_name():
    env, params = dc2g_jax.make_env("FrontDoor-v0", dataset="procedural", split="val", sensing_range=5)
    assert (env.sensing.radius, env.observation_space(params).spaces["terrain"].shape) == (5, (50, 50))
    assert env.default_params is params
    refusal(lambda: dc2g_jax.make_env("FrontDoor-v1"), "FrontDoor-v1", "FrontDoor-v0")
