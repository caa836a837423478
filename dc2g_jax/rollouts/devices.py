"""One mesh over every device: accelerators, or the cores of a CPU, of all processes.

Pieces of work are dealt out: of n devices, device i gets the pieces i, i + n, i + 2 n and so on. Arrays that are dealt
out have an axis of devices before all others.
"""

import os
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Int

from dc2g_jax.errors import InputError

#: The mesh's only axis.
AXIS = "devices"

#: A pytree of arrays.
_State = TypeVar("_State")

#: Seconds that one call of a program should take: between two calls progress is reported, and an interrupt heard.
_SECONDS_PER_CALL = 0.3

#: Seconds after which a process that has died is missed by the others, which then end.
_SECONDS_TO_NOTICE = 30


def cores() -> int:
    """Cores of the CPU that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def join_processes(
    coordinator: str | None = None, num_processes: int | None = None, process_id: int | None = None
) -> None:
    """Join the other processes that share the work, if there are any. Call it before JAX runs anything.

    Without arguments this asks Slurm, Open MPI, Kubernetes or the TPU pod; where none of them runs several processes,
    this one works alone.

    Args:
      coordinator: `host:port` of process 0.
      num_processes: how many there are.
      process_id: number of this one.

    Raises:
      InputError: some of the arguments are missing or wrong, or the others cannot be reached.
    """
    given = [value for value in (coordinator, num_processes, process_id) if value is not None]
    if len(given) not in (0, 3):
        raise InputError("give --coordinator HOST:PORT, --num-processes and --process-id together, or none of them")
    if num_processes is not None and process_id is not None and not 0 <= process_id < num_processes:
        raise InputError(f"--process-id {process_id}: give a number from 0 to {num_processes - 1}")
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.config.update("jax_enable_preemption_service", False)  # it would catch SIGTERM, and nobody asks it
    try:
        jax.distributed.initialize(coordinator, num_processes, process_id, heartbeat_timeout_seconds=_SECONDS_TO_NOTICE)
    except (RuntimeError, ValueError) as error:
        if given:
            raise InputError(f"{coordinator}: the processes cannot be joined ({str(error).splitlines()[0]})") from None
        jax.config.update("jax_cpu_collectives_implementation", None)


def use_cores(count: int | None = None) -> None:
    """Make each core of the CPU a device. Call it before JAX runs anything.

    Without this call JAX takes a CPU for one device, and rollouts keep to one core.

    Args:
      count: how many, which may be more than there are; `None` for every core.

    Raises:
      InputError: less than 1, or JAX has already started with another number.
    """
    wanted = cores() if count is None else count
    if wanted < 1:
        raise InputError(f"{wanted} cores: give at least 1")
    try:
        jax.config.update("jax_num_cpu_devices", wanted)
    except RuntimeError:
        found = len(jax.local_devices(backend="cpu"))
        if found != wanted:
            raise InputError(
                f"{wanted} cores: JAX has already started with {found}; call use_cores before anything else uses JAX"
            ) from None


def use_devices(count: int | None = None) -> None:
    """Use so many accelerators in this process, or, where there are none, cores of the CPU; see `use_cores`.

    Args:
      count: how many; `None` for all.

    Raises:
      InputError: there are fewer accelerators, or JAX has already started with others.
    """
    if count is not None and count >= 1:
        jax.config.update("jax_cuda_visible_devices", ",".join(map(str, range(count))))
    use_cores(count)
    if jax.local_device_count() != (count or jax.local_device_count()):
        raise InputError(f"--devices {count}: there are {jax.local_device_count()} ({jax.local_devices()[0]})")


def mesh_of(devices: Sequence[jax.Device] | None = None) -> Mesh:
    """A mesh of these devices; of all, in every process, where `None`."""
    return Mesh(np.array(jax.devices() if devices is None else devices), (AXIS,))


def platform(mesh: Mesh) -> str:
    """What kind of devices these are: `cpu`, `gpu`, `tpu`."""
    return mesh.devices.flat[0].platform


def replicate(tree: Any, mesh: Mesh) -> Any:
    """The same arrays on every device."""
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec()))


def deal(tree: Any, count: int, mesh: Mesh, own: int | None = None) -> Any:
    """Deal pieces of work out to the devices.

    Args:
      tree: arrays, pieces on the first axis.
      count: how many pieces.
      mesh: the devices.
      own: pieces a device, repeated up to this number; as few as possible where `None`.

    Returns:
      Arrays of shape `[devices, own, ...]`, each device's part on that device.
    """
    own = -(-count // mesh.size) if own is None else own
    numbers = np.stack([np.resize(np.arange(first, count, mesh.size), own) for first in range(mesh.size)])
    sharding = NamedSharding(mesh, PartitionSpec(AXIS))
    return jax.tree.map(lambda leaf: jax.device_put(leaf[numbers], sharding), tree)


def dealt_counts(count: int, mesh: Mesh) -> Int[np.ndarray, "devices"]:
    """How many pieces each device gets."""
    return np.bincount(np.arange(count) % mesh.size, minlength=mesh.size).astype(np.int32)


def not_repeated(count: int, mesh: Mesh) -> Bool[np.ndarray, "devices own"]:
    """Which of the dealt pieces are not repetitions of others."""
    counts = dealt_counts(count, mesh)
    return np.arange(counts.max()) < counts[:, None]


def gather(tree: Any, count: int) -> Any:
    """The results of dealt pieces `[devices, own, ...]` in the order of the pieces, as NumPy arrays.

    Args:
      tree: arrays of results; those of repeated pieces are dropped.
      count: how many pieces there were.
    """

    def in_order(leaf: Array) -> np.ndarray:
        dealt = fetch(leaf)
        return np.swapaxes(dealt, 0, 1).reshape(dealt.shape[0] * dealt.shape[1], *dealt.shape[2:])[:count]

    return jax.tree.map(in_order, tree)


def fetch(array: Array | np.ndarray) -> np.ndarray:
    """An array as NumPy's, whole, in every process."""
    whole = isinstance(array, np.ndarray) or array.is_fully_addressable or array.is_fully_replicated
    return np.asarray(array if whole else multihost_utils.process_allgather(array, tiled=True))


def in_any_process(flag: bool) -> bool:
    """Is it so in any of the processes? All ask at the same point of their work, and hear the same."""
    return flag if jax.process_count() == 1 else bool(np.any(multihost_utils.process_allgather(np.array(flag))))


def first_copy(tree: Any) -> Any:
    """One device's copy of arrays that every device has, for programs that run on one."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)


def on_each(function: Callable[..., Any], mesh: Mesh, dealt: Any, *shared: Any) -> Any:
    """Call `function(part, *shared)` on every device with its part of the dealt arrays.

    Args:
      function: a pure function.
      mesh: the devices.
      dealt: arrays with an axis of devices, which the function does not see.
      *shared: the same for all.

    Returns:
      What it gives, with an axis of devices first.
    """

    def own(dealt: Any, shared: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], function(jax.tree.map(lambda leaf: leaf[0], dealt), *shared))

    split, whole = PartitionSpec(AXIS), PartitionSpec()
    mapped = jax.shard_map(own, mesh=mesh, in_specs=(split, whole), out_specs=split, check_vma=False)
    return mapped(dealt, shared)


def spread(batch: Any, rest: Any) -> tuple[Any, Any]:
    """Divide a batch among the devices inside a jitted function, if its size allows; otherwise one device has it.

    Args:
      batch: arrays with the batch on the first axis.
      rest: what every device has whole, such as weights.

    Returns:
      Both, placed.
    """
    mesh, size = mesh_of(), len(jax.tree.leaves(batch)[0])
    if size % mesh.size:
        return batch, rest
    place = jax.lax.with_sharding_constraint
    split, whole = NamedSharding(mesh, PartitionSpec(AXIS)), NamedSharding(mesh, PartitionSpec())
    return place(batch, split), place(rest, whole)


def batched(mesh: Mesh) -> Callable[..., Any]:
    """`jax.vmap` for accelerators; for a CPU a loop, which does not compute branches that are not taken."""

    def one_by_one(call: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *batch: jax.lax.map(lambda args: call(*args), batch)

    return one_by_one if platform(mesh) == "cpu" else jax.vmap


def serve_paced(
    state: _State,
    go_on: Callable[[_State, Int[Array, ""]], _State],
    count_finished: Callable[[_State], Int[Array, "devices"]],
    n_pieces: int,
    on_progress: Callable[[int], None] | None = None,
    *,
    first_steps: int,
) -> _State:
    """Do pieces of work, so many steps a call that each call takes about as long.

    Args:
      state: the first state.
      go_on: `(state, steps) ->` the state after at most so many more steps of each piece.
      count_finished: `state ->` how many pieces each device has finished.
      n_pieces: how many there are.
      on_progress: called after each call with the number of pieces finished so far.
      first_steps: steps of the first call that takes any.

    Returns:
      The state in which all pieces are finished.
    """
    # Takes no step: this is where the program is compiled.
    state = jax.block_until_ready(go_on(state, jnp.int32(0)))
    finished, steps = 0, first_steps
    while True:
        if on_progress is not None:
            on_progress(finished)
        if finished >= n_pieces:
            return state
        began = time.perf_counter()
        state = go_on(state, jnp.int32(steps))
        finished = min(int(fetch(count_finished(state)).sum()), n_pieces)
        pace = steps / (time.perf_counter() - began)
        steps = max(1, min(int(pace * _SECONDS_PER_CALL), 2 * steps))
        if jax.process_count() > 1:  # all take the same number of calls
            steps = int(multihost_utils.broadcast_one_to_all(np.int32(steps)))
