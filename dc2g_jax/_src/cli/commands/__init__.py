"""The command `dc2g`, which runs all commands by name.

The module imports nothing heavy, so that `dc2g --help` is fast.
"""

import difflib
import importlib
import importlib.metadata
import os
import sys
from types import TracebackType
from typing import Annotated, Any, NoReturn, Union

from dc2g_jax._src.errors import InputError, reader_may_leave, require_extra

#: Command name -> its module here, and its description. `python -m experiments.MODULE` runs it in a checkout.
COMMANDS = {
    "fig4": ("reproduce_fig4", "Fig. 4: predictions of a network on whole and partial maps of test houses"),
    "fig5": (
        "reproduce_fig5",
        "Fig. 5: train the paper's image-to-image translator, three losses compared throughout training",
    ),
    "fig6": ("reproduce_fig6", "Fig. 6: networks on every test house, against its distance from training houses"),
    "fig7": ("reproduce_fig7", "Fig. 7: extra steps beyond an oracle, by planner and neighborhood"),
    "fig8": ("reproduce_fig8", "Fig. 8: planners side by side from one start"),
    "fig9": ("reproduce_fig9", "Fig. 9: a vehicle with a camera drives to a front door"),
    "run": ("run_episodes", "run planners from the starts in a CSV file"),
    "head-to-head": ("head_to_head", "the authors' network against ours on the 400 published episodes"),
    "compare": ("compare", "all planners in all families of maps: a table, a figure and the page leaderboard.md"),
    "noisy-mapping": ("noisy_mapping", "drives from camera to door with increasing noise"),
    "map check": ("check_map", "check a map of your own"),
    "map explore": ("explore_map", "run planners on a map of your own"),
    "map osm": ("import_osm", "make maps of the buildings of an OpenStreetMap extract"),
    "map recording": ("map_recording", "map a recorded sequence of depth images"),
    "demo": ("demo", "watch planners step by step in the browser, on a map that you choose or draw"),
    "draw dataset": ("draw_dataset", "every house of a dataset as a small map"),
    "draw episodes": ("draw_episodes", "figures of earlier episodes"),
    "train": ("train", "train the cost-to-go network"),
    "sweep": ("sweep_losses", "train networks with many losses, learning rates, widths and seeds"),
    "export": ("export_network", "write a trained network as an ONNX file"),
    "objectnav fig5": ("objectnav_fig5", "dense cost maps, Figs. 4 and 5: a search for an object"),
    "objectnav table1": ("objectnav_table1", "dense cost maps, Table I: searching houses for objects"),
    "objectnav table2": ("objectnav_table2", "dense cost maps, Table II: inputs of the network"),
    "objectnav train": ("objectnav_train", "train the network that predicts cost maps indoors"),
}

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
    """Run the command that the first or the first two words name."""
    for count in (2, 1):
        name = " ".join(words[:count])
        if name in COMMANDS:
            prepare()
            # As with `python -m`: Python finds the user's planners, `package.module:Name`, here.
            sys.path.append(os.getcwd())
            sys.argv = [f"dc2g {name}", *words[count:]]
            command = _module(COMMANDS[name][0])
            from dc2g_jax._src.cli.common import command_line

            command_line(command.Options, command.main)
            return
    asked = " ".join(words[:2]) if words[0] in _GROUPS else words[0]
    close = difflib.get_close_matches(asked, [*COMMANDS, *_GROUPS], n=1, cutoff=0.75)
    close = close or [name for name in COMMANDS if words[0] in name.split()]
    remedy = f"did you mean {' or '.join(f'dc2g {name}' for name in close)}?" if close else "dc2g --help lists all"
    _refuse(f"no command is called {asked!r}; {remedy}")


def _refuse(message: object) -> NoReturn:
    """Exit with an error message for invalid input."""
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


def _module(name: str) -> Any:
    """The module of a command."""
    return importlib.import_module(f"{__name__}.{name}")


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
        groups.setdefault(first, {})[second] = _module(module).Options
    every = {first: own.get("") or one_of(own) for first, own in groups.items()}
    words, config = ["--tyro-write-completion", shell, "-"], (tyro.conf.FlagCreatePairsOff,)
    with reader_may_leave():
        tyro.cli(one_of(every), prog="dc2g", args=words, config=config)
    raise AssertionError("tyro exits when it has printed")


def prepare() -> None:
    """Set up a command before slow imports: handle Ctrl-C, and limit progress lines in log files.

    Exits if the extra `all`, which every command needs, is not installed.
    """
    if not sys.stderr.isatty():
        os.environ.setdefault("TQDM_MININTERVAL", "15")
    sys.excepthook = _tell_exception
    try:
        require_extra("cv2", "matplotlib", "orbax", "rerun", "tyro")
    except InputError as error:
        _refuse(error)


def _tell_exception(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print the exception that ended the program; a single line for Ctrl-C."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)
