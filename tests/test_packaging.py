"""What the packaging files say of each other."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from tests.support.places import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
REQUIREMENTS = [
    Requirement(line)
    for lines in (PROJECT["dependencies"], *PROJECT["optional-dependencies"].values())
    for line in lines
    if not line.startswith("dc2g_jax[")  # another extra
]


def read(name: str) -> dict:
    return yaml.safe_load((ROOT / name).read_text())


@pytest.mark.parametrize("requirement", REQUIREMENTS, ids=str)
def test_every_dependency_is_bounded_on_both_sides(requirement):
    assert {bound.operator for bound in requirement.specifier} == {">=", "<"}


def test_a_dependency_of_two_extras_has_the_same_bounds_in_both():
    bounds = {(requirement.name, str(requirement.specifier)) for requirement in REQUIREMENTS}
    assert len(bounds) == len({name for name, _ in bounds})


def test_commits_are_checked_by_the_linter_that_tests_install():
    (revision,) = (repo["rev"] for repo in read(".pre-commit-config.yaml")["repos"] if "ruff" in repo["repo"])
    (ruff,) = {str(requirement.specifier) for requirement in REQUIREMENTS if requirement.name == "ruff"}
    assert Requirement(f"ruff{ruff}").specifier.contains(revision.removeprefix("v"))


def test_ci_runs_on_the_versions_of_python_that_are_promised():
    promised = [re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", line) for line in PROJECT["classifiers"]]
    run = read(".github/workflows/ci.yml")["jobs"]["test"]["strategy"]["matrix"]["python-version"]
    assert [match[1] for match in promised if match] == run
    assert PROJECT["requires-python"] == f">={run[0]}"


def test_the_version_is_the_same_everywhere():
    first = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)
    assert first is not None
    assert first[1] == read("CITATION.cff")["version"] == PROJECT["version"]


def undefined_names(folder) -> list[str]:
    """Names that the linter does not find, apart from those in strings: shapes of arrays are written as such."""
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--select=F821", "--output-format=json", "-e"]
    wrong = json.loads(subprocess.run([*command, str(folder)], capture_output=True, check=True).stdout)
    undefined = []
    for found in wrong:
        place, tree = found["location"], ast.parse(Path(found["filename"]).read_text())
        names = {(node.lineno, node.col_offset + 1) for node in ast.walk(tree) if isinstance(node, ast.Name)}
        if (place["row"], place["column"]) in names:
            undefined.append(f"{found['filename']}:{place['row']}")
    return undefined


def test_names_are_defined(tmp_path):
    assert undefined_names(ROOT) == []
    (tmp_path / "wrong.py").write_text('x: Float["h w"] = there_is_no_such_name\n')
    assert undefined_names(tmp_path) == [f"{tmp_path / 'wrong.py'}:1"] * 2
