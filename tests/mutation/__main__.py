"""Mutation testing: small changes to the code, each of which a test should notice.

    python -m tests.mutation --count 50 --seed 0 grid planning environments rollouts

draws 50 mutants of these rooms, and runs the tests that import the changed module until one of them fails. It prints
the mutants that no test noticed, and the share that one did. Results are kept in `--out`, and continued: tests that
have found mutants of a module come first, then its own tests, then those of its room. `equivalent.csv` lists mutants
that change nothing that a caller could notice, with the reason; they are not run.

Each mutant is a fork of a process that has imported the package, with the code of a function exchanged, or with the
package imported anew where the change is in no function. No file is changed.
"""

import argparse
import collections
import csv
import gc
import importlib.machinery
import json
import os
import random
import re
import resource
import sys
import time
import types
from collections.abc import Iterator
from pathlib import Path

import pytest
from beartype import beartype
from hypothesis import Phase, settings

import tests.conftest  # noqa: F401  checks of types, and how programs are compiled
from tests.mutation.mutants import Mutant, mutants
from tests.support.places import ROOT

ROOMS = ("grid", "planning", "rollouts", "environments")
EQUIVALENT = Path(__file__).with_name("equivalent.csv")

#: Seconds of CPU time after which no more tests of a mutant are begun, and after which one is in an endless loop; bytes
#: of memory of its own.
_BUDGET, _ENDLESS, _BYTES = 20, 60, 10 * 2**30

# That an example fails is enough: to shrink it takes longer than all other tests together.
settings.register_profile("mutation", settings.get_profile("tests"), phases=[Phase.explicit, Phase.generate])
settings.load_profile("mutation")


def modules_of(room: str) -> list[Path]:
    """The modules of a room of the core or of a client, or one module such as `grid/search.py`."""
    folders = (ROOT / "dc2g_jax" / "_src", ROOT / "dc2g_jax")
    return sorted(
        path for folder in folders for path in folder.glob(room if room.endswith(".py") else f"{room}/**/*.py")
    )


def tests_of(path: str) -> list[str]:
    """The test files of these rooms that import a module, its own first; of all rooms where these have none."""
    package, name = path.removesuffix(".py").rsplit("/", 1)
    room = package.removeprefix("dc2g_jax/").removeprefix("_src/")
    own = ROOT / "tests" / room / f"test_{name}.py"
    imports = rf"{re.escape(package.replace('/', '.'))}(\.{name}| import .*\b{name})\b"
    files = [file for file in sorted((ROOT / "tests").rglob("test_*.py")) if re.search(imports, file.read_text())]
    near = [file for file in files if file.parent.name in ROOMS]
    return [str(file) for file in dict.fromkeys([own, *near] if own.exists() else near or files)]


class Order:
    """A plugin of pytest: tests that found mutants come first, then the module's own, then the room's, each by time.

    None is begun beyond the budget.

    Attributes:
      seen: (test, seconds, whether it failed), for each test that ran.
    """

    def __init__(self, path: str, seconds: dict[str, float], kills: collections.Counter[str]):
        self.seen: list[tuple[str, float, bool]] = []
        self._path, self._seconds, self._kills = Path(path), seconds, kills

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        def order(item: pytest.Item) -> tuple[int, int, float]:
            elsewhere = item.path.parent.name != self._path.parent.name
            distance = 2 * elsewhere + (item.path.stem != f"test_{self._path.stem}")
            return -self._kills[item.nodeid], distance, self._seconds.get(item.nodeid, 0.0)

        items.sort(key=order)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or report.failed:
            self.seen.append((report.nodeid, report.duration, report.failed))

    def pytest_runtest_setup(self) -> None:
        if time.process_time() > _BUDGET:
            pytest.exit("no test has failed so far", returncode=0)


def swap_functions(mutant: Mutant) -> bool:
    """Give functions of the loaded module the mutant's code. Returns whether that was the change, or it was outside."""
    target = str(ROOT / mutant.path)

    def codes(code: types.CodeType) -> Iterator[types.CodeType]:
        yield code
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                yield from codes(constant)

    before, after = (compile(text, target, "exec") for text in ((ROOT / mutant.path).read_text(), mutant.text))
    old, new = ({code.co_qualname: code for code in codes(whole)} for whole in (before, after))
    changed = {name for name, code in new.items() if code != old[name]} - {"<module>"}
    swapped = set()
    for function in gc.get_objects():
        if isinstance(function, types.FunctionType) and function.__code__.co_filename == target:
            name = function.__code__.co_qualname
            if name in changed and function.__code__.co_freevars == new[name].co_freevars:
                function.__code__ = new[name]
                swapped.add(name)
    outermost = {name.split(".<locals>")[0] for name in changed}
    return bool(outermost) and outermost <= swapped


def load_mutant(mutant: Mutant) -> None:
    """Let the module be imported as the mutant, and everything anew."""
    loader = importlib.machinery.SourceFileLoader
    get_data, target = loader.get_data, str(ROOT / mutant.path)
    compiled = f"{Path(target).parent / '__pycache__' / Path(target).stem}."

    def mutated(self: object, path: str) -> bytes:
        if str(path).startswith(compiled):
            raise FileNotFoundError(path)
        return mutant.text.encode() if str(path) == target else get_data(self, path)  # type: ignore[arg-type]

    loader.get_data = mutated  # type: ignore[method-assign]
    for name in [name for name in sys.modules if name.split(".")[0] == "dc2g_jax"]:
        del sys.modules[name]
    # beartype keeps hints by their text, and would reject the new classes. A class that comes again makes it forget.
    for _ in range(2):
        beartype(type("Again", (), {}))


def run_tests(mutant: Mutant, order: Order) -> int:
    """Run the tests of a mutant in this process. Returns pytest's exit status."""
    files = tests_of(mutant.path)
    sys.dont_write_bytecode = True
    if not swap_functions(mutant):
        load_mutant(mutant)
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    return int(pytest.main([*options, "-m", "not release", *files], plugins=[order]))


def outcome(mutant: Mutant, order: Order) -> tuple[str, list[tuple[str, float, bool]]]:
    """`killed` (by a test, a module that cannot be imported, or a limit) or `survived`; and `Order.seen`."""
    told, tell = os.pipe()
    child = os.fork()
    if child == 0:
        status = 99
        try:
            silent = os.open(os.environ.get("MUTATION_LOG", os.devnull), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            resource.setrlimit(resource.RLIMIT_CPU, (_ENDLESS, _ENDLESS))
            resource.setrlimit(resource.RLIMIT_DATA, (_BYTES, _BYTES))
            status = run_tests(mutant, order)
            os.write(tell, json.dumps(order.seen).encode())
        finally:
            os._exit(status)
    os.close(tell)
    with open(told, "rb") as file:
        seen = json.loads(file.read() or "[]")
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status > pytest.ExitCode.INTERRUPTED:
        raise RuntimeError(f"{mutant.path}: {mutant.after}: the tests could not be run ({status}); see MUTATION_LOG")
    return "killed" if status else "survived", seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", help="rooms, or modules such as grid/search.py")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("outputs/mutants.jsonl"))
    options = parser.parse_args()
    with EQUIVALENT.open(newline="") as file:
        left_out = {tuple(row[:3]) for row in csv.reader(file)}
    every = [mutant for room in options.rooms for path in modules_of(room) for mutant in mutants(path)]
    drawn = random.Random(options.seed).sample(every, min(options.count, len(every)))
    chosen = [mutant for mutant in drawn if mutant.key not in left_out]
    for file in sorted((ROOT / "dc2g_jax").rglob("*.py")):  # once for all mutants
        if file.name == "__main__.py":
            continue
        importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.touch()
    found: dict[tuple[str, ...], str] = {}
    seconds: dict[str, float] = {}
    kills: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)

    def note(line: str) -> None:
        path, before, after, end, seen = json.loads(line)
        found[path, before, after] = end
        for test, taken, failed in seen:
            seconds[test] = taken
            kills[path][test] += failed

    for line in options.out.read_text().splitlines():
        note(line)
    for number, mutant in enumerate(chosen, start=1):
        if mutant.key not in found:
            line = json.dumps([*mutant.key, *outcome(mutant, Order(mutant.path, seconds, kills[mutant.path]))])
            note(line)
            with options.out.open("a") as file:
                file.write(line + "\n")
            print(f"{number:4} {found[mutant.key]:8} {mutant.path}: {mutant.after}", flush=True)
    survivors = [mutant for mutant in chosen if found[mutant.key] == "survived"]
    print(
        f"\n{len(drawn)} of {len(every)} mutants: {len(chosen) - len(survivors)} killed, {len(survivors)} survived, "
        f"{len(drawn) - len(chosen)} equivalent"
    )
    for mutant in survivors:
        print(f"{mutant.path}\n  - {mutant.before}\n  + {mutant.after}")


if __name__ == "__main__":
    main()
