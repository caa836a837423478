"""One mesh over all devices of all processes: accelerators, or the cores of a CPU.

Pieces of work are dealt out round-robin: of n devices, device i gets the pieces i, i + n, i + 2 n and so on. The first
axis of dealt arrays is that of the devices.
"""

import contextlib
import ctypes
import math
import os
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Int

from dc2g_jax._src.runtime.errors import InputError, check_number

#: The mesh's axis, and the one that trainings of several runs have before it.
AXIS, RUNS = "devices", "runs"

#: A pytree of arrays.
_State = TypeVar("_State")

#: Target duration of one call of a program, in seconds. Progress and interrupts are handled between calls.
_SECONDS_PER_CALL = 0.3

#: Seconds after which the other processes notice that one has died, and end.
_SECONDS_TO_NOTICE = 30

#: On a busy machine, one core can be a minute behind another, after which XLA would abort the process.
_PATIENCE = "--xla_cpu_collective_call_terminate_timeout_seconds=600"


def cores() -> int:
    """Number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def join_processes(
    coordinator: str | None = None, num_processes: int | None = None, process_id: int | None = None
) -> None:
    """Join the other processes that share the work, if there are any. Call it before JAX runs anything.

    Without arguments, Slurm, Open MPI, Kubernetes or the TPU pod provide them. If none of them runs several processes,
    this process works alone.

    Args:
      coordinator: `host:port` of process 0.
      num_processes: number of processes.
      process_id: index of this process.

    Raises:
      InputError: arguments are missing or invalid, or the other processes cannot be reached.
    """
    given = [value for value in (coordinator, num_processes, process_id) if value is not None]
    if len(given) not in (0, 3):
        raise InputError("give --coordinator HOST:PORT, --num-processes and --process-id together, or none of them")
    if num_processes is not None:
        check_number("--process-id", process_id, whole=True, least=0, most=num_processes - 1)
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.config.update("jax_enable_preemption_service", False)  # it would catch SIGTERM, and nobody asks it
    try:
        jax.distributed.initialize(coordinator, num_processes, process_id, heartbeat_timeout_seconds=_SECONDS_TO_NOTICE)
    except (RuntimeError, ValueError) as error:
        if given:
            raise InputError(f"{coordinator}: the processes cannot be joined ({str(error).splitlines()[0]})") from None
        jax.config.update("jax_cpu_collectives_implementation", None)


def use_cores(count: int | None = None) -> None:
    """Make each CPU core a device. Call it before JAX runs anything.

    Without this call, JAX treats a CPU as one device, and rollouts use a single core. Cores wait up to ten minutes for
    each other, unless `XLA_FLAGS` says otherwise.

    Args:
      count: number of devices, which may exceed the number of cores; `None` for all cores.

    Raises:
      InputError: the number is less than 1, or JAX has already started with another number.
    """
    wanted = cores() if count is None else count
    check_number("number of cores", wanted, whole=True, least=1)
    flags = os.environ.get("XLA_FLAGS", "")
    if _PATIENCE not in flags:
        os.environ["XLA_FLAGS"] = f"{_PATIENCE} {flags}"  # the user's own come last, and win
    try:
        jax.config.update("jax_num_cpu_devices", wanted)
    except RuntimeError:
        found = len(jax.local_devices(backend="cpu"))
        if found != wanted:
            raise InputError(
                f"{wanted} cores: JAX has already started with {found}; call use_cores before anything else uses JAX"
            ) from None


def use_devices(count: int | None = None) -> None:
    """Choose the number of accelerators of this process, or of CPU cores if there are none; see `use_cores`.

    Args:
      count: number of devices; `None` for all.

    Raises:
      InputError: there are fewer accelerators, or JAX has already started with others.
    """
    if count is not None and count >= 1:
        jax.config.update("jax_cuda_visible_devices", ",".join(map(str, range(count))))
    use_cores(count)
    if jax.local_device_count() != (count or jax.local_device_count()):
        raise InputError(f"--devices {count}: there are {jax.local_device_count()} ({jax.local_devices()[0]})")


def reuse_memory() -> None:
    """Make the C library keep this process's freed memory for later arrays, if it is glibc; else do nothing.

    Otherwise the library returns the buffers of each step on a large batch to the system, and the next step maps them
    again, page by page, which takes a sixth of its time.
    """
    trim_threshold, mmap_max = -1, -4  # of mallopt
    with contextlib.suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(mmap_max, 0)
        library.mallopt(trim_threshold, 2**31 - 1)


def require_memory(needed: float, option: str) -> None:
    """Check, before minutes of other work, that the devices hold what is surely needed.

    Args:
      needed: bytes, on all devices of all processes together.
      option: option to lower, with its value.

    Raises:
      InputError: they do not, or on a CPU the machine does not.
    """
    limit = (jax.local_devices()[0].memory_stats() or {}).get("bytes_limit")
    if limit is not None:
        limit *= jax.device_count()
    elif hasattr(os, "sysconf"):
        limit = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") * jax.process_count()
    if limit is not None and needed > limit:
        raise InputError(f"{option}: needs more than {needed / 1e9:.3g} GB of memory, of {limit / 1e9:.3g}; lower it")


def mesh_of(devices: Sequence[jax.Device] | None = None) -> Mesh:
    """A mesh of these devices; `None` for all devices of all processes."""
    return Mesh(np.array(jax.devices() if devices is None else devices), (AXIS,))


def mesh_for_batch(size: int, runs: int = 1) -> Mesh:
    """A mesh for training: runs are divided among its first axis, the batch of each run among its second.

    As many devices share a batch of this size as can do so equally, and on a CPU all work on one run. If some device of
    several processes would be left over, each process works on its own, on one device.
    """
    groups = 1 if platform(mesh_of()) == "cpu" else math.gcd(runs, jax.device_count())
    each = math.gcd(size, jax.device_count() // groups)
    if jax.process_count() > 1 and groups * each < jax.device_count():
        return Mesh(np.array(jax.local_devices()[:1]).reshape(1, 1), (RUNS, AXIS))
    return Mesh(np.array(jax.devices()[: groups * each]).reshape(groups, each), (RUNS, AXIS))


def settle(tree: Any) -> None:
    """Wait for arrays around a program in which devices exchange data. Only cores of a CPU as devices need this.

    They share a few threads. Each device holds one while it waits for the data of another, and one while it starts a
    program and 32 wait already. Together they can hold all of them, and nothing goes on.
    """
    if jax.device_count() > 1 and jax.default_backend() == "cpu":
        jax.block_until_ready(tree)


def platform(mesh: Mesh) -> str:
    """Platform of the devices: `cpu`, `gpu` or `tpu`."""
    return mesh.devices.flat[0].platform


def replicate(tree: Any, mesh: Mesh) -> Any:
    """Copy arrays to every device."""
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec()))


def divide(batch: Any, mesh: Mesh) -> Any:
    """Divide a batch, on the first axis of arrays, equally among the devices; only inside a compiled function."""
    return jax.lax.with_sharding_constraint(batch, NamedSharding(mesh, PartitionSpec(AXIS)))


def deal(tree: Any, count: int, mesh: Mesh, own: int | None = None) -> Any:
    """Deal pieces of work out to the devices.

    Args:
      tree: arrays with the pieces on the first axis.
      count: number of pieces.
      mesh: the devices.
      own: pieces per device, reached by repeating pieces; `None` for as few as possible.

    Returns:
      Arrays of shape `[devices, own, ...]`, with each device's part on that device.
    """
    own = -(-count // mesh.size) if own is None else own
    numbers = np.stack([np.resize(np.arange(first, count, mesh.size), own) for first in range(mesh.size)])
    sharding = NamedSharding(mesh, PartitionSpec(AXIS))
    return jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf)[numbers], sharding), tree)


def dealt_counts(count: int, mesh: Mesh) -> Int[np.ndarray, "devices"]:
    """Number of pieces that each device gets."""
    return np.bincount(np.arange(count) % mesh.size, minlength=mesh.size).astype(np.int32)


def not_repeated(count: int, mesh: Mesh) -> Bool[np.ndarray, "devices own"]:
    """Whether each dealt piece is not a repetition."""
    counts = dealt_counts(count, mesh)
    return np.arange(counts.max()) < counts[:, None]


def gather(tree: Any, count: int) -> Any:
    """The results of dealt pieces `[devices, own, ...]` in the order of the pieces, as NumPy arrays.

    Args:
      tree: arrays of results; those of repeated pieces are dropped.
      count: number of pieces.
    """

    def in_order(leaf: Array) -> np.ndarray:
        dealt = fetch(leaf)
        return np.swapaxes(dealt, 0, 1).reshape(dealt.shape[0] * dealt.shape[1], *dealt.shape[2:])[:count]

    return jax.tree.map(in_order, tree)


def fetch(array: Array | np.ndarray) -> np.ndarray:
    """The whole array as a NumPy array, in every process."""
    whole = isinstance(array, np.ndarray) or array.is_fully_addressable or array.is_fully_replicated
    return np.asarray(array if whole else multihost_utils.process_allgather(array, tiled=True))


def in_any_process(flag: bool) -> bool:
    """Whether the flag is set in any process. All processes must call this at the same point."""
    return flag if jax.process_count() == 1 else bool(np.any(multihost_utils.process_allgather(np.array(flag))))


def first_copy(tree: Any) -> Any:
    """One device's copy of replicated arrays, for programs that run on a single device."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)


def on_each(function: Callable[..., Any], mesh: Mesh, dealt: Any, *shared: Any) -> Any:
    """Call `function(part, *shared)` on every device with its part of the dealt arrays.

    Args:
      function: a pure function.
      mesh: the devices.
      dealt: arrays whose first axis is that of the devices. The function gets them without it.
      *shared: arguments that are the same for all.

    Returns:
      The results, with a first axis of devices.
    """

    def own(dealt: Any, shared: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], function(jax.tree.map(lambda leaf: leaf[0], dealt), *shared))

    split, whole = PartitionSpec(AXIS), PartitionSpec()
    mapped = jax.shard_map(own, mesh=mesh, in_specs=(split, whole), out_specs=split, check_vma=False)
    return mapped(dealt, shared)


def batched(mesh: Mesh) -> Callable[..., Any]:
    """`jax.vmap` on accelerators; on a CPU a loop, which skips branches that are not taken."""

    def one_by_one(call: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *batch: jax.lax.map(lambda args: call(*args), batch)

    return one_by_one if platform(mesh) == "cpu" else jax.vmap


def serve_paced(
    state: _State,
    go_on: Callable[[_State, np.int32], tuple[_State, Int[Array, "devices"]]],
    n_pieces: int,
    on_progress: Callable[[int], None] | None = None,
    *,
    first_steps: int,
) -> _State:
    """Run pieces of work in calls of about the same duration.

    Args:
      state: the first state.
      go_on: `(state, steps) ->` the state after at most `steps` more steps of each piece, and the number of pieces that
        each device has finished.
      n_pieces: total number of pieces.
      on_progress: called with the number of finished pieces, before the first call and after each call.
      first_steps: steps of the first call.

    Returns:
      The state in which all pieces are finished.
    """
    finished, steps = 0, first_steps
    while True:
        if on_progress is not None:
            on_progress(finished)
        if finished >= n_pieces:
            return state
        began = time.perf_counter()
        state, counts = go_on(state, np.int32(steps))
        finished = min(int(fetch(counts).sum()), n_pieces)
        # Low if the call also compiled the program: the next one is short.
        pace = steps / (time.perf_counter() - began)
        steps = max(1, int(pace * _SECONDS_PER_CALL))
        if jax.process_count() > 1:  # all make the same number of calls
            steps = int(multihost_utils.broadcast_one_to_all(np.int32(steps)))
