"""What programs would cost on a GPU, compiled without one: `python -m experiments.compile_for h100`."""

import dataclasses
import sys
from typing import Annotated, Literal

import jax
import tyro

from dc2g_jax.cli.common import OutOption, command_line
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.errors import InputError
from dc2g_jax.files.atomic import write_json
from dc2g_jax.rollouts.devices import mesh_of

from .benchmarks.compiled_for import Cost, cost, open_target, table
from .benchmarks.hot_programs import hot_programs

# Before JAX starts: its plugin for CUDA would look for a GPU, and refuse to load where there is none.
jax.config.update("jax_platforms", "cpu")


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Compile the programs that take the time for a GPU, which need not be there, and count what a step costs.

    Writes `compiled.json` after each program, and prints a table. Needs `pip install -e ".[cuda-compile]"`.

    Attributes:
      target: the GPU.
      program: names of programs; all where not given.
      robots: robots side by side in a rollout, on each device.
      driving: robots that drive or search for objects, on each device.
      out: folder to write to; a new one below outputs/ where not given.
    """

    target: Annotated[Literal["h100"], tyro.conf.Positional] = "h100"
    program: tuple[str, ...] = ()
    robots: int = 65536
    driving: int = 1024
    out: OutOption = None


def main(options: Options) -> None:
    """Compile, count and write."""
    if min(options.robots, options.driving) < 1:
        raise InputError(f"--robots {options.robots} --driving {options.driving}: give 1 or more")
    programs = hot_programs(options.robots, options.driving)
    if unknown := [name for name in options.program if name not in programs]:
        raise InputError(f"--program {unknown[0]}: no program is called that; use one of: {', '.join(programs)}")
    target = open_target(options.target)
    out = output_folder(options, "compile_for")
    costs: list[Cost] = []
    for name in options.program or programs:
        print(f"{name} ...", file=sys.stderr, flush=True)
        try:
            count, make = programs[name]
            costs.append(cost(name, make(mesh_of(target.devices[:count])), target))
        except Exception as error:  # whatever the compiler says, the others go on
            line = (str(error).strip().splitlines() or [""])[0][:200]
            costs.append(Cost(name, error=f"{type(error).__name__}: {line}"))
        print(table(costs)[-1], file=sys.stderr, flush=True)
        facts = {"target": options.target, "programs": [dataclasses.asdict(each) for each in costs]}
        write_json(out / "compiled.json", facts)
    print("\n".join(table(costs)))
    print(f"Written: {out / 'compiled.json'}")


if __name__ == "__main__":
    command_line(Options, main)
