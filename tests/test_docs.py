"""The documents say what is so: their Python examples run and print what they show, their names and commands exist."""

import dataclasses
import fnmatch
import functools
import importlib
import importlib.util
import json
import re
import shlex
from pathlib import Path
from typing import Any

import jax
import pytest
import tyro

from dc2g_jax._src.cli.commands import COMMANDS
from dc2g_jax._src.runtime import devices
from dc2g_jax._src.runtime.errors import InputError
from experiments.results import RESULTS, Options, main, run_in, templates, with_figures
from tests.support.places import ROOT

PAGES = [ROOT / "README.md", ROOT / "BENCHMARKS.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

#: Packages of extras: examples that need them are run where they are installed.
OPTIONAL = ("gymnasium", "stable_baselines3", "torch")

#: A Python example, the file that it is to be saved as, if any, and what it prints, where a block of text follows it.
_EXAMPLE = re.compile(r'^```python(?: title="(\w+\.py)")?\n(.*?)^```\n(?:\s*^```text\n(.*?)^```\n)?', flags=re.S | re.M)
_SHELL = re.compile(r"^```bash\n(.*?)^```", flags=re.S | re.M)
_COMMAND = re.compile(
    rf"(?:python|\bdc2g) (-m experiments\.\w+\b(?!\.)|examples/\w+\.py|(?:{'|'.join(COMMANDS)})(?![\w-]))([^`\n|&#$]*)"
)
_NAME = re.compile(r"(?<!entry-points\.\")\bdc2g_jax(?:\.\w+)+")


def page_id(page: Path) -> str:
    return str(page.relative_to(ROOT))


def examples(page: Path) -> list[tuple[str | None, str, str | None]]:
    """The Python examples of a page: the file of each, its code, and what it is said to print."""
    return [(found[1], found[2], found[3]) for found in _EXAMPLE.finditer(page.read_text())]


#: Pages with examples; those of the README and the tutorials take long.
WITH_EXAMPLES = [
    pytest.param(page, id=page_id(page), marks=[] if page.parent.name == "how_it_works" else [pytest.mark.slow])
    for page in PAGES
    if examples(page)
]


@pytest.mark.parametrize("page", WITH_EXAMPLES)
def test_python_examples_print_what_the_page_shows(page, tmp_path, monkeypatch, capsys):
    """All examples of a page, in order, in one namespace and an empty folder, without a network."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("DC2G_DATA", "procedural")
    monkeypatch.setattr(devices, "cores", jax.device_count)  # JAX has started, with as many as tests use
    namespace: dict[str, Any] = {"__name__": "__page__"}
    for number, (file, code, shown) in enumerate(examples(page), start=1):
        if file is not None:
            Path(file).write_text(code)
        try:
            exec(compile(code, f"{page_id(page)}, example {number}", "exec"), namespace)
        except ModuleNotFoundError as error:
            if error.name not in OPTIONAL:
                raise
            pytest.skip(f"example {number} needs {error.name}")
        printed = capsys.readouterr().out
        if shown is not None:
            assert printed == shown, f"example {number} prints:\n{printed}"


@functools.cache
def exists(name: str) -> bool:
    """Is this dotted name a module, or an attribute of one, or a field of a dataclass?"""
    found: Any = importlib.import_module("dc2g_jax")
    parts = name.split(".")
    for place, part in enumerate(parts[1:], start=2):
        path = ".".join(parts[:place])
        if not hasattr(found, part) and hasattr(found, "__path__") and importlib.util.find_spec(path):
            importlib.import_module(path)
        if hasattr(found, part):
            found = getattr(found, part)
        elif dataclasses.is_dataclass(found) and part in {field.name for field in dataclasses.fields(found)}:
            return place == len(parts)
        else:
            return False
    return True


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_names_exist(page):
    assert [name for name in sorted(set(_NAME.findall(page.read_text()))) if not exists(name)] == []


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_linked_files_exist(page):
    links = re.findall(r"\]\((?!\w+:)([^)#\s]+)", page.read_text())
    assert [link for link in links if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_tests_exist(page):
    named = set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page.read_text()))
    missing = [f"{file}::{name}" for file, name in sorted(named) if f"\ndef {name}(" not in (ROOT / file).read_text()]
    assert missing == []
    assert named or page.stem != "what_it_promises"


def test_every_module_is_in_the_reference():
    text = "".join(page.read_text() for page in (ROOT / "docs" / "reference").glob("*.md"))
    shown = tuple(name + suffix for name in re.findall(r"^::: ([\w.]+)$", text, flags=re.M) for suffix in ("", ".*"))
    files = [path for path in (ROOT / "dc2g_jax/_src").rglob("*.py") if path.stem != "__init__"]
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files]
    assert [name for name in modules if not any(fnmatch.fnmatch(name, one) for one in shown)] == []


def test_a_name_that_does_not_exist_is_noticed():
    assert exists("dc2g_jax._src.grid.gridworld.Belief.seen")
    assert not exists("dc2g_jax._src.grid.gridworld.Belief.heard")
    assert not exists("dc2g_jax._src.grid.no_such_module")


@functools.cache
def options_of(program: str) -> Any:
    """The options dataclass of a command: one of `dc2g`, `-m experiments.NAME` or `examples/NAME.py`."""
    if program in COMMANDS:
        return importlib.import_module(COMMANDS[program][0]).Options
    if program.startswith("-m "):
        return importlib.import_module(program[3:]).Options
    spec = importlib.util.spec_from_file_location(Path(program).stem, ROOT / program)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except ModuleNotFoundError as error:
        if error.name not in OPTIONAL:
            raise
        pytest.skip(f"{program} needs {error.name}")
    return module.Options


def commands(text: str) -> list[tuple[str, str]]:
    """The programs that a text runs, and what is written after each."""
    return _COMMAND.findall(text.replace("\\\n", " "))


def option_names(options: Any) -> set[str]:
    """The options of a command as they are written, those of its groups among them."""
    names: set[str] = set()
    for field in dataclasses.fields(options):
        default = field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default
        names |= option_names(type(default)) if dataclasses.is_dataclass(default) else {field.name.replace("_", "-")}
    return names


def shell_commands() -> list[Any]:
    found = []
    for page in PAGES:
        for block in _SHELL.findall(page.read_text()):
            found += [pytest.param(*one, id=f"{page_id(page)}: {one[0]}{one[1].rstrip()}") for one in commands(block)]
    return found


@pytest.mark.parametrize(("program", "arguments"), shell_commands())
def test_commands_are_understood(program, arguments):
    """The command line as written is taken by the command's own options."""
    tyro.cli(options_of(program), args=shlex.split(arguments), console_outputs=False)


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_options_named_in_the_text_exist(page):
    """In passing a command may be named without all that it needs, but not with an option that it has not."""
    for program, arguments in commands(_SHELL.sub("", page.read_text())):
        names = {word[2:].partition("=")[0] for word in arguments.split() if word.startswith("--")} - {"help"}
        assert names <= option_names(options_of(program)), f"{program}{arguments}"


@pytest.mark.parametrize("page", templates())
def test_figures_are_those_of_the_results(page):
    """Otherwise `python -m experiments.results` writes them."""
    text = (ROOT / page).read_text()
    assert with_figures(text, page, json.loads(RESULTS.read_text())) == text


def test_another_figure_is_put_right_and_a_missing_one_is_noticed():
    text, results = (ROOT / "README.md").read_text(), json.loads(RESULTS.read_text())
    assert text.count("| 31.6 (12.2) |") == text.count("averages 23.5 %") == 1
    wrong = text.replace("| 31.6 (12.2) |", "| 1.25 (0.0) |").replace("averages 23.5 %", "averages\n7 %")
    assert with_figures(wrong, "README.md", results).split() == text.split()
    with pytest.raises(InputError, match=r"README.md: 0 places, not one, .*`dc2g_uncertain`"):
        with_figures(text.replace("`dc2g_uncertain`", ""), "README.md", results)


def test_a_run_says_where_its_figures_come_from(tmp_path):
    run = {"began": "2026-01-02T03:04:05+00:00", "commit": "c", "versions": {"jax": "0"}}
    runs = [
        run | {"command": "python -m experiments.reproduce_fig7"},
        run | {"command": "python -m experiments.reproduce_fig7 --out here --resume --dataset /a/b"},
    ]
    (tmp_path / "run.json").write_text(json.dumps({"runs": runs}))
    (tmp_path / "results.json").write_text(
        json.dumps({"seconds": 1.5, "paper": {"frontier": [1 / 3, None], "dc2g": {}}})
    )
    facts = {
        "command": "python -m experiments.reproduce_fig7 --dataset FOLDER",
        "date": "2026-01-02",
        "commit": "c",
        "versions": {"jax": "0"},
    }
    assert run_in(tmp_path) == facts | {"paper": {"frontier": [0.333333, None]}}
    before = RESULTS.read_text()
    with pytest.raises(InputError, match="pages show 'published', which a run there lacks"):
        main(Options(take=("fig7", tmp_path)))
    assert RESULTS.read_text() == before
