"""Programs compiled for a GPU that this machine need not have, and what they would cost there."""

import dataclasses
import re
import time
from pathlib import Path
from typing import Any

import jax
from jax._src.lib import _jax
from jax.experimental import topologies
from jax.sharding import NamedSharding, PartitionSpec

from dc2g_jax._src.runtime.errors import InputError

from .hot_programs import HotProgram
from .launches import Launches, count_launches
from .programs import nothing_kept

#: Targets by name, each with the file of its facts: an XLA `GpuTargetConfigProto`.
TARGETS = {"h100": "h100.textproto"}

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
    """A GPU to compile for, by the facts in its file.

    Raises:
      InputError: JAX's plugin for CUDA is not installed.
    """
    text = Path(__file__).with_name(TARGETS[name]).read_text()
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


_COLUMNS = (
    "program",
    "batch",
    "compile s",
    "arguments MB",
    "scratch MB",
    "kernels",
    "MB",
    "Mflop",
    "floor us",
    "loops",
)


def table(costs: list[Cost]) -> list[str]:
    """Lines of a Markdown table."""
    rows = [list(_COLUMNS), ["---"] * len(_COLUMNS)]
    for each in costs:
        if not each.compiled:
            rows.append([each.program, f"failed: {each.error}", *[""] * (len(_COLUMNS) - 2)])
            continue
        loops = ", ".join(f"{kernels} ({size / 1e6:,.0f} MB)" for kernels, size in each.loops)
        numbers = (each.seconds, each.argument_mb, each.temp_mb, each.kernels_a_step)
        amounts = ((each.bytes_a_step or 0) / 1e6, (each.flops_a_step or 0) / 1e6, each.floor_us)
        rows.append([each.program, f"{each.batch:,}", *(f"{value:,.0f}" for value in (*numbers, *amounts)), loops])
    return ["| " + " | ".join(row) + " |" for row in rows]
