"""The command `dc2g`, which runs all commands by name.

The module imports nothing heavy, so that `dc2g --help` is fast.
"""

import difflib
import importlib
import importlib.metadata
import os
import sys
from typing import Annotated, Any, NoReturn, Union

from dc2g_jax._src.cli import prepare
from dc2g_jax._src.runtime.errors import InputError, reader_may_leave
from dc2g_jax._src.runtime.plugins import plugins

#: The package's commands by name: module and description. `COMMANDS` of a plug-in has the same form.
_OWN = "dc2g_jax._src.cli.commands"
COMMANDS = {
    "run": (f"{_OWN}.run_episodes", "run planners from the starts in a CSV file"),
    "compare": (
        f"{_OWN}.compare",
        "all planners in all families of maps: a table, a figure and the page leaderboard.md",
    ),
    "map check": (f"{_OWN}.check_map", "check a map of your own"),
    "map explore": (f"{_OWN}.explore_map", "run planners on a map of your own"),
    "draw dataset": (f"{_OWN}.draw_dataset", "every house of a dataset as a small map"),
    "draw episodes": (f"{_OWN}.draw_episodes", "figures of earlier episodes"),
    "train": (f"{_OWN}.train", "train the cost-to-go network"),
    "sweep": (f"{_OWN}.sweep", "train networks with many losses, learning rates, widths and seeds"),
}
for _plugin in plugins("commands").values():
    COMMANDS |= _plugin.load()

#: First words of commands of two words.
_GROUPS = dict.fromkeys(name.partition(" ")[0] for name in COMMANDS if " " in name)


def main() -> None:
    """Run a command: `dc2g NAME OPTIONS`."""
    words = sys.argv[1:]
    match words:
        case [] | ["-h" | "--help", *_]:
            _show(_overview())
        case [group] | [group, "-h" | "--help"] if group in _GROUPS:
            _show(_overview(f"{group} "))
        case ["--version"]:
            _show(f"dc2g {importlib.metadata.version('dc2g_jax')}")
        case ["--completion", "bash" | "zsh" as shell]:
            _print_completion(shell)
        case ["--completion", *_]:
            _refuse("--completion: give bash or zsh")
        case _:
            _run(words)


def _show(text: str) -> None:
    """Print a text, which may be cut off."""
    with reader_may_leave():
        print(text)


def _run(words: list[str]) -> None:
    for count in (2, 1):
        name = " ".join(words[:count])
        if name in COMMANDS:
            # As with `python -m`: Python finds the user's planners, `package.module:Name`, here.
            sys.path.append(os.getcwd())
            sys.argv = [f"dc2g {name}", *words[count:]]
            try:
                prepare()
                command = importlib.import_module(COMMANDS[name][0])
                from dc2g_jax._src.cli.common import command_line
            except InputError as error:
                _refuse(error)
            except KeyboardInterrupt:  # slow imports
                print("interrupted", file=sys.stderr)
                sys.exit(130)
            command_line(command.Options, command.main)
            return
    asked = " ".join(words[:2]) if words[0] in _GROUPS else words[0]
    close = difflib.get_close_matches(asked, [*COMMANDS, *_GROUPS], n=1, cutoff=0.75)
    close = close or [name for name in COMMANDS if words[0] in name.split()]
    remedy = f"did you mean {' or '.join(f'dc2g {name}' for name in close)}?" if close else "dc2g --help lists all"
    _refuse(f"no command is called {asked!r}; {remedy}")


def _refuse(message: object) -> NoReturn:
    print(f"error: {message}", file=sys.stderr)
    sys.exit(2)


def _overview(group: str = "") -> str:
    """The commands of a group, or all, one per line."""
    shown = {name: words for name, (_, words) in COMMANDS.items() if name.startswith(group)}
    width = max(map(len, shown))
    lines = [f"  {name:{width}}  {words}" for name, words in shown.items()]
    hints = ["Options of a command: dc2g COMMAND --help"]
    if not group:
        hints += ["Version: dc2g --version", "A script for the shell's completion: dc2g --completion bash (or zsh)"]
    return "\n".join([f"usage: dc2g {group}COMMAND [OPTIONS]", "", *lines, "", *hints])


def _print_completion(shell: str) -> NoReturn:
    """Print a script that completes commands and options in a shell, and exit."""
    prepare()
    import tyro

    def one_of(commands: dict[str, Any]) -> Any:
        """A type of whose subcommands one is chosen: a command's options, or those of a group."""
        return Union[  # noqa: UP007
            tuple(Annotated[options, tyro.conf.subcommand(name)] for name, options in commands.items())
        ]

    groups: dict[str, dict[str, Any]] = {}
    for name, (module, _) in COMMANDS.items():
        first, _, second = name.partition(" ")
        groups.setdefault(first, {})[second] = importlib.import_module(module).Options
    every = {first: own.get("") or one_of(own) for first, own in groups.items()}
    words, config = ["--tyro-write-completion", shell, "-"], (tyro.conf.FlagCreatePairsOff,)
    with reader_may_leave():
        tyro.cli(one_of(every), prog="dc2g", args=words, config=config)
    raise AssertionError("tyro exits when it has printed")
