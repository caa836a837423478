"""The programs that take the time, by the shapes of their arguments: to be compiled without any data."""

import functools
import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec as P

from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.rollouts import rollout
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT
from dc2g_jax._src.runtime.devices import AXIS, RUNS
from dc2g_jax._src.training.cost_to_go import CostToGoTraining, TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.pairs import TrainingSet
from dc2g_jax._src.training.step import Supervised, draw_batches, learn
from dc2g_jax.indoor.learning.networks import load_costs
from dc2g_jax.indoor.search import searches
from dc2g_jax.indoor.search.guides import agent_with
from dc2g_jax.indoor.search.searches import IndoorSite, leg
from dc2g_jax.robot.driving import robot
from dc2g_jax.robot.driving.robot import Step
from dc2g_jax.robot.mapping.scene import TILES, Scene
from experiments.driving import drive
from experiments.driving.drive import Site
from experiments.reproduce_fig5 import TranslationOptions
from experiments.support.driving import DrivingOptions, equipment
from experiments.translator.pairs import ImageSet
from experiments.translator.training import TranslatorTraining

#: Sides of a house and of an indoor house, in cells; houses; masks to train on; runs of a sweep.
_CELLS, _INDOOR_CELLS, _HOUSES, _MASKS, _RUNS = 50, 200, 77, 12_000, 64

#: The programs of an optimizer step; the second is by far the most of it.
StepPart = Literal["draw", "learn"]
_PARTS_OF_A_STEP: tuple[StepPart, ...] = get_args(StepPart)

#: Arguments of which each device has its own part, and those that all have.
_DEALT, _WHOLE = P(AXIS), P()


class HotProgram(NamedTuple):
    """A program and the shapes it is compiled for.

    Attributes:
      program: the program.
      arguments: arrays or their shapes.
      specs: how each argument is divided among the devices.
      static: static arguments.
      batch: robots, pairs or runs that a step takes on, all devices together.
      mesh: the devices.
      depth: loops around one another that each turn once a step; 0 where the whole program is a step.
    """

    program: Any
    arguments: tuple[Any, ...]
    specs: tuple[P, ...]
    static: dict[str, Any]
    batch: int
    mesh: Mesh
    depth: int = 0


def _array(*shape: int, dtype: Any = jnp.int32) -> Any:
    """The shape of an array, which stands for one."""
    return jax.ShapeDtypeStruct(shape, dtype)


def _rollout(name: str, robots: int, mesh: Mesh) -> HotProgram:
    """The loop of a rollout; a step is one decision of every robot, and new robots where some have finished."""
    rules = SETTINGS["paper"].rules()
    planner = planner_with(name, rules, network_in_folder(None))
    worlds = jax.eval_shape(World.from_terrain, _array(_CELLS, _CELLS, _HOUSES, dtype=jnp.uint8))
    each, static = _array(mesh.size, robots), {"mesh": mesh, "sensing": rules.sensing}
    first = functools.partial(rollout._first_states, n_slots=robots, kept_steps=STEP_LIMIT, **static)
    queues, states = jax.eval_shape(first, planner, worlds, each, Pose(each, each, each), _array(mesh.size))
    return HotProgram(
        rollout._run,
        arguments=(states, _array(), queues, planner),
        specs=(_DEALT, _WHOLE, _DEALT, _WHOLE),
        static={**static, "step_limit": STEP_LIMIT},
        batch=robots * mesh.size,
        mesh=mesh,
        depth=2,
    )


def _step_program(
    part: StepPart, training: Supervised, data: Any, state: Any, hyperparameters: Any, mesh: Mesh, batch: int
) -> HotProgram:
    """One of the two programs of an optimizer step."""
    runs, pairs = (P("runs"), P("runs", AXIS)) if state.step.ndim else (_WHOLE, _DEALT)
    static = {"training": training, "mesh": mesh}
    draw = HotProgram(draw_batches, (state, data, hyperparameters), (runs, _WHOLE, runs), static, batch, mesh)
    if part == "draw":
        return draw
    drawn = jax.eval_shape(functools.partial(draw_batches, **static), *draw.arguments)
    return HotProgram(learn, (state, drawn, hyperparameters), (runs, pairs, runs), {"training": training}, batch, mesh)


def _training(part: StepPart, runs: int, devices: Mesh) -> HotProgram:
    """One of the two programs of an optimizer step of the cost-to-go network, for so many stacked runs, or for one."""
    config = TrainingConfig()
    worlds = _HOUSES + (DataConfig().for_steps(TrainingConfig.steps).extra_houses or 0)
    groups = math.gcd(runs, devices.size)
    mesh = Mesh(devices.devices.reshape(groups, -1), (RUNS, AXIS))
    data = TrainingSet(
        terrain=_array(worlds, _CELLS, _CELLS, dtype=jnp.uint8),
        cost_to_go=_array(worlds, _CELLS, _CELLS, dtype=jnp.float32),
        masks=_array(_MASKS, bitboard.word_count(_CELLS), _CELLS, dtype=jnp.uint32),
        mask_world=_array(_MASKS),
        n_own=_array(),
    )
    training = CostToGoTraining(config.recipe, DataConfig().draw_batch)
    one = jax.eval_shape(lambda: (training.first_state(config.hyperparameters), config.hyperparameters))
    state, numbers = jax.tree.map(lambda leaf: _array(runs, *leaf.shape, dtype=leaf.dtype), one) if runs > 1 else one
    return _step_program(part, training, data, state, numbers, mesh, runs if runs > 1 else config.batch_size)


def _translator_step(mesh: Mesh) -> HotProgram:
    options = TranslationOptions()
    config, size, houses = options.config("l1+gan"), options.size, 31
    pairs = _array(houses * options.train_masks)
    data = ImageSet(
        terrain=_array(houses, size, size, dtype=jnp.uint8),
        cost_to_go=_array(houses, size, size, dtype=jnp.float32),
        masks=_array(options.train_masks, bitboard.word_count(size), size, dtype=jnp.uint32),
        pair_house=pairs,
        pair_mask=pairs,
    )
    training = TranslatorTraining(config, options.draw(config.batch_size))
    seed = _array(dtype=jnp.uint32)
    state = jax.eval_shape(training.first_state, seed)
    return _step_program("learn", training, data, state, seed, mesh, config.batch_size)


def _scene(houses: int, side: int) -> Scene:
    cells, number = (houses, side, side), _array(houses, dtype=jnp.float32)
    return Scene(_array(*cells, dtype=jnp.float32), _array(*cells, dtype=jnp.uint8), number, number)


def _robots_steps(
    reset: robot.Reset, number: int, step: Step, own: Any, sites: Any, components: Any, mesh: Mesh
) -> HotProgram:
    n, each = jax.tree.leaves(own)[-1].shape
    where = _array(n, each)
    begin = functools.partial(robot._at_starts, mesh=mesh, reset=reset, number=number)
    robots = jax.eval_shape(begin, where, _array(n, each, 2, dtype=jnp.uint32), own, sites, components)
    arguments = (where, _array(n, each, dtype=jnp.bool_), sites, components, _array(), robots, _array())
    specs = (_DEALT, _DEALT, _WHOLE, _WHOLE, _WHOLE, _DEALT, _WHOLE)
    return HotProgram(robot._go_on, arguments, specs, {"mesh": mesh, "step": step}, where.size, mesh, depth=1)


def _search_leg(robots: int, mesh: Mesh) -> HotProgram:
    agent, houses, side, n = agent_with("promising", load_costs()), 8, _INDOOR_CELLS, mesh.size
    sites = IndoorSite(
        scene=_scene(houses, side),
        paint=_array(houses, side, side, 3, dtype=jnp.uint8),
        free=_array(houses, side, side, dtype=jnp.bool_),
        true_distance=None,
    )
    own = _array(n, robots, 3, dtype=jnp.float32), _array(n, robots)
    return _robots_steps(searches.at_start, searches.TIME_LIMIT, leg, own, sites, agent, mesh)


def _drive_step(robots: int, mesh: Mesh) -> HotProgram:
    equipped, n = equipment("dc2g", network_in_folder(None), (_CELLS, _CELLS), 1.0, DrivingOptions()), mesh.size
    sites = Site(_array(_HOUSES, _CELLS, _CELLS, dtype=jnp.uint8), _scene(_HOUSES, _CELLS * TILES))
    each = _array(n, robots)
    own = Pose(each, each, each), _array(n, robots, dtype=jnp.bool_)
    return _robots_steps(drive.reset, 0, drive.step, own, sites, equipped, mesh)


def hot_programs(robots: int, driving: int) -> dict[str, tuple[int, Callable[[Mesh], HotProgram]]]:
    """Programs by name: how many devices each is for, and what makes it for a mesh of them.

    Args:
      robots: robots of a rollout in the gridworld, on each device.
      driving: robots that drive or search for objects, on each device.
    """
    planners = {f"rollout {name}": functools.partial(_rollout, name, robots) for name in ("oracle", "frontier", "dc2g")}
    training = {
        f"{what} {part}": functools.partial(_training, part, runs)
        for what, runs in (("training", 1), ("sweep", _RUNS))
        for part in _PARTS_OF_A_STEP
    }
    return {
        **{name: (1, make) for name, make in (planners | training).items()},
        "translator step": (1, _translator_step),
        "object-goal leg": (1, functools.partial(_search_leg, driving)),
        "drive step": (1, functools.partial(_drive_step, driving)),
        "rollout frontier, 8 devices": (8, planners["rollout frontier"]),
        **{f"training {part}, 8 devices": (8, training[f"training {part}"]) for part in _PARTS_OF_A_STEP[1:]},
    }
