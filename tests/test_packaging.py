"""What the packaging files say of each other."""

import re
import tomllib

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
