"""Cost of programs on a GPU, compiled without one: `python -m experiments.compile_for h100`."""

import dataclasses
import sys
from typing import Annotated, Literal

import jax
import tyro

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.runtime.devices import mesh_of
from dc2g_jax._src.runtime.errors import InputError

from .benchmarks.compiled_for import Cost, cost, open_target, table
from .benchmarks.hot_programs import hot_programs

# Before JAX starts: its CUDA plugin looks for a GPU, and does not load without one.
jax.config.update("jax_platforms", "cpu")


@dataclasses.dataclass(frozen=True)
class Options(OutOptions):
    """Compile the hot programs for a GPU, without needing one, and count the cost of a step.

    Writes `compiled.json` after each program and prints a table. Needs `pip install -e ".[cuda-compile]"`.

    Attributes:
      target: the GPU.
      program: names of programs; all by default.
      robots: robots of a rollout on each device.
      driving: robots that drive or search for objects on each device.
    """

    target: Annotated[Literal["h100"], tyro.conf.Positional] = "h100"
    program: tuple[str, ...] = ()
    robots: int = 65536
    driving: int = 1024


def main(options: Options) -> None:
    """Compile, count and write."""
    require_positive(options, "robots", "driving")
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
        except Exception as error:  # whatever the error, the other programs still run
            line = (str(error).strip().splitlines() or [""])[0][:200]
            costs.append(Cost(name, error=f"{type(error).__name__}: {line}"))
        print(table(costs)[-1], file=sys.stderr, flush=True)
        facts = {"target": options.target, "programs": [dataclasses.asdict(each) for each in costs]}
        write_json(out / "compiled.json", facts)
    print("\n".join(table(costs)))
    print(f"Written: {out / 'compiled.json'}")


if __name__ == "__main__":
    command_line(Options, main)
