"""Cost of programs on a GPU, compiled without one: `python -m experiments.compile_for h100`."""

import dataclasses
import re
import sys
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import tyro
from jax._src.lib import _jax
from jax.experimental import topologies
from jax.sharding import NamedSharding, PartitionSpec

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.runtime.devices import mesh_of
from dc2g_jax._src.runtime.errors import InputError

from .benchmarks.hot_programs import HotProgram, hot_programs
from .benchmarks.launches import Launches, count_launches
from .benchmarks.programs import nothing_kept

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


#: Floating-point operations of a lane of a GPU in a cycle: a multiplication and an addition.
_OPERATIONS_A_CYCLE = 2


@dataclasses.dataclass(frozen=True)
class Target:
    """A GPU.

    Attributes:
      devices: what programs are compiled for.
      bandwidth: of its memory, bytes a second.
      peak: single-precision operations a second outside of tensor cores.
    """

    devices: tuple[Any, ...]
    bandwidth: float
    peak: float


def open_target(name: str) -> Target:
    """A GPU to compile for, by the facts in its file, an XLA `GpuTargetConfigProto`.

    Raises:
      InputError: JAX's plugin for CUDA is not installed.
    """
    text = (Path(__file__).parent / "benchmarks" / f"{name}.textproto").read_text()
    try:
        devices = topologies.get_topology_desc(platform="cuda", topology="1x1x8", target_config=text).devices
    except NotImplementedError:
        remedy = 'install it with `pip install -e ".[cuda-compile]"`'
        raise InputError(f"{name}: JAX's compiler for CUDA is not installed; {remedy}") from None

    def fact(key: str) -> float:
        found = re.search(rf"\b{key}: ([0-9.]+)", text)
        assert found, key
        return float(found[1])

    peak = _OPERATIONS_A_CYCLE * fact("core_count") * fact("fpus_per_core") * fact("clock_rate_ghz") * 1e9
    return Target(tuple(devices), bandwidth=fact("memory_bandwidth"), peak=peak)


@dataclasses.dataclass(frozen=True)
class Cost:
    """A program on a target.

    Attributes:
      program: its name.
      batch: robots, pairs or runs that a step takes on, all devices together. All else is of one device.
      compiled: did it compile?
      seconds: that took.
      argument_mb: memory of arguments and results.
      temp_mb: scratch memory.
      kernels_a_step: kernels, library calls and copies launched in a step, outside of loops of unknown length.
      bytes_a_step: that these read and write.
      loops: `[kernels, bytes]` of a turn of each such loop in a step. The host waits for each turn to end.
      flops_a_step: operations of the program as written, each loop turned once.
      floor_us: least time of a step in which each loop turns once, by memory bandwidth or arithmetic, microseconds.
      error: why it did not compile.
    """

    program: str
    batch: int | None = None
    compiled: bool = False
    seconds: float | None = None
    argument_mb: float | None = None
    temp_mb: float | None = None
    kernels_a_step: int | None = None
    bytes_a_step: int | None = None
    loops: tuple[tuple[int, int], ...] = ()
    flops_a_step: float | None = None
    floor_us: float | None = None
    error: str | None = None


def step_of(program: Launches, depth: int) -> Launches:
    """What a step launches.

    Args:
      program: what the program launches.
      depth: see `HotProgram.depth`. Of the loops at each depth, the one with most kernels in it is taken.
    """
    path = [program]
    for _ in range(depth):
        path.append(max(path[-1].loops, key=lambda loop: sum(each.kernels for each in (loop, *loop.all_loops))))
    step = Launches()
    for level in path[1:] or path:
        step.add(level)
    return dataclasses.replace(step, loops=[loop for loop in step.loops if not any(loop is level for level in path)])


def lowered(hot: HotProgram) -> Any:
    """The program, ready to be compiled for the devices of its mesh."""

    def placed(tree: Any, spec: PartitionSpec) -> Any:
        sharding = NamedSharding(hot.mesh, spec)
        shapes = jax.eval_shape(lambda tree: tree, tree)
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), shapes)

    return hot.program.lower(*map(placed, hot.arguments, hot.specs), **hot.static)


def cost(name: str, hot: HotProgram, target: Target) -> Cost:
    """Compile a program for a target and count what it costs there."""
    start = time.perf_counter()
    with nothing_kept():
        program = lowered(hot)
        compiled = program.compile()
    seconds = time.perf_counter() - start
    memory = compiled.memory_analysis()
    held = memory.argument_size_in_bytes + memory.output_size_in_bytes - memory.alias_size_in_bytes
    step = step_of(count_launches(compiled.as_text()), hot.depth)
    # JAX asks the target, which does not say; a CPU counts what is written.
    written = program.compiler_ir("hlo").as_hlo_module()
    flops = float(_jax.hlo_module_cost_analysis(jax.devices("cpu")[0].client, written).get("flops", 0.0))
    loops = tuple((loop.kernels, loop.bytes) for loop in step.all_loops)
    moved = step.bytes + sum(size for _, size in loops)
    return Cost(
        program=name,
        batch=hot.batch,
        compiled=True,
        seconds=round(seconds, 1),
        argument_mb=round(held / 1e6, 1),
        temp_mb=round(memory.temp_size_in_bytes / 1e6, 1),
        kernels_a_step=step.kernels,
        bytes_a_step=step.bytes,
        loops=loops,
        flops_a_step=flops,
        floor_us=round(1e6 * max(moved / target.bandwidth, flops / target.peak), 1),
    )


def table(costs: list[Cost]) -> list[str]:
    """Lines of a Markdown table."""
    lines = [
        "| program | batch | compile s | arguments MB | scratch MB | kernels | MB | Mflop | floor us | loops |",
        "|" + 10 * " --- |",
    ]
    for each in costs:
        if not each.compiled:
            lines.append(f"| {each.program} | failed: {each.error} |" + 8 * "  |")
            continue
        loops = ", ".join(f"{kernels} ({size / 1e6:,.0f} MB)" for kernels, size in each.loops)
        numbers = (each.seconds, each.argument_mb, each.temp_mb, each.kernels_a_step)
        amounts = ((each.bytes_a_step or 0) / 1e6, (each.flops_a_step or 0) / 1e6, each.floor_us)
        cells = (each.program, f"{each.batch:,}", *(f"{value:,.0f}" for value in (*numbers, *amounts)), loops)
        lines.append(f"| {' | '.join(cells)} |")
    return lines


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
