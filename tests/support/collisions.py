"""Every boundary where a user's class enters a compiled program, under a `jax.jit` that takes one class for another.

JAX confuses two classes of equal structure only where their hashes happen to meet. Here they always meet: the first of
two equal structures stands in for both. `python -m tests.support.collisions` prints, for each boundary, whether the
second class was asked. A class that is asked says so with an exception. A program with the first class's code in it is
only traced, not compiled: that is enough for the second to get it.
"""

import contextlib
import functools
import inspect
import itertools
import json
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax  # noqa: F401 before the change: what libraries compile is theirs
import orbax.checkpoint  # noqa: F401
from flax import nnx, struct  # noqa: F401

_jit = jax.jit

#: Calls of the first class's code.
_calls: list[str] = []


class Traced(Exception):
    """A program that holds the code of the first class would run now."""


class Asked(Exception):
    """The code of the second class runs."""


def colliding_jit(function: Callable | None = None, **options: Any) -> Any:
    """`jax.jit` with a cache in which all structures have one hash."""
    if function is None:
        return functools.partial(colliding_jit, **options)
    program = _jit(function, **options)
    parameters = list(inspect.signature(function).parameters)
    numbers, names = options.get("static_argnums", ()), options.get("static_argnames", ())
    numbers = (numbers,) if isinstance(numbers, int) else numbers
    static = {*((names,) if isinstance(names, str) else names), *(parameters[number] for number in numbers)}
    known: list[Any] = []
    holds_first = False

    def mistaken(value: Any) -> Any:
        leaves, structure = jax.tree.flatten(value)
        if structure not in known:
            known.append(structure)
        return jax.tree.unflatten(known[known.index(structure)], leaves)

    @functools.wraps(function)
    def call(*args, **kwargs):
        nonlocal holds_first
        named = itertools.chain(parameters, itertools.repeat(""))  # the last one may stand for any number
        args = tuple(arg if name in static else mistaken(arg) for name, arg in zip(named, args, strict=False))
        kwargs = {name: arg if name in static else mistaken(arg) for name, arg in kwargs.items()}
        if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((args, kwargs))):
            before = len(_calls)
            program.trace(*args, **kwargs)
            holds_first |= len(_calls) > before
            if holds_first:
                raise Traced
        return program(*args, **kwargs)

    call.lower, call.trace, call._cache_size = program.lower, program.trace, program._cache_size
    return call


def asked(*args, **kwargs):
    """Say so."""
    raise Asked


def variants(base: type, name: str) -> tuple[type, type]:
    """Two classes like `base`, with equal structures, that tell of the calls of a method or property."""
    member = inspect.getattr_static(base, name)
    kind, function = (property, member.fget) if isinstance(member, property) else (lambda same: same, member)

    @functools.wraps(function)
    def counted(*args, **kwargs):
        _calls.append(name)
        return function(*args, **kwargs)

    first, second = (
        type(title, (base,), {name: kind(told)}) for title, told in (("First", counted), ("Second", asked))
    )
    return struct.dataclass(first), struct.dataclass(second)


def with_property(whole: Any, name: str) -> tuple[tuple[type, type], Callable[[type], Any]]:
    """Two classes with the fields of a dataclass, one of them behind a property; and what makes an object of them."""
    fields = {field: getattr(whole, field) for field in whole.__dataclass_fields__ if field != name}
    annotations = {"held": Any, **dict.fromkeys(fields, Any)}
    base = struct.dataclass(type("Base", (), {"__annotations__": annotations, name: property(lambda self: self.held)}))
    return variants(base, name), lambda cls: cls(held=getattr(whole, name), **fields)


def boundaries() -> dict[str, tuple[Callable[[type], Any], tuple[type, type]]]:
    """Boundary -> what sends an object of a class through it, and the two classes."""
    from dc2g_jax._src.environments import functional
    from dc2g_jax._src.estimation.estimators import ExactCostToGo
    from dc2g_jax._src.figures.replay import replay
    from dc2g_jax._src.grid.poses import make_pose
    from dc2g_jax._src.grid.world import World
    from dc2g_jax._src.planning.online import OnlinePlanner
    from dc2g_jax._src.planning.planners import DC2G, Frontier
    from dc2g_jax._src.planning.rules import SETTINGS, complete_rules
    from dc2g_jax._src.readers.houses import HouseDataset
    from dc2g_jax._src.readers.starts import Start
    from dc2g_jax._src.rollouts.evaluation import Runner, episodes_from
    from dc2g_jax._src.runtime.devices import mesh_for_batch, mesh_of
    from dc2g_jax._src.training import cost_to_go
    from dc2g_jax._src.training.masks import collect_masks
    from dc2g_jax._src.training.step import stacked, supervised_step
    from dc2g_jax.gymnasium import environment as gymnasium_env
    from dc2g_jax.indoor.search import guides, searches
    from experiments.benchmarks import workload
    from experiments.translator import training as translator
    from experiments.translator.evaluation import compare
    from tests.support import drives, trainings
    from tests.support.houses import DATASET, STREET
    from tests.support.two_rooms import AGENT, two_rooms

    rules = complete_rules(4)
    start = Start("street", 0, 4, 0)
    runner = Runner(HouseDataset("street", "toy", DATASET.houses[:1]), SETTINGS["paper"], step_limit=20)
    world = World.from_terrain(STREET)
    batch = jax.tree.map(lambda leaf: leaf[..., None], world)
    episodes = episodes_from([start], {"street": 0})
    house = two_rooms()
    searched = searches.sample_episodes([house], 1, seed=2)
    environment, params = functional.front_door(DATASET.houses[:1], sensing_range=4, step_limit=60)
    of_params, make_params = with_property(params, "worlds")
    of_indoor, make_indoor = with_property(trainings.journeys(), "headings")

    @struct.dataclass
    class Drawer:
        """What a training draws from: a user's class, with a field for the data."""

        data: Any

        def pairs(self, draw, *args, **options):
            return draw(*args, self.data, **options)

    draw_pairs = lambda key, data, **options: data.pairs(trainings.DRAW_PAIRS, key, **options)  # noqa: E731
    draw_images = lambda key, step, data: data.pairs(trainings.DRAW_IMAGES, key, step)  # noqa: E731

    def run(planner: Any) -> None:
        runner.trajectories(planner, rules, [start])

    def train(cls: type) -> None:
        config = trainings.COST_TO_GO
        state, data = trainings.first_state(config), cls(trainings.training_set())
        training = cost_to_go.CostToGoTraining(config.recipe, draw_pairs)
        supervised_step(state, data, config.hyperparameters, training=training, mesh=mesh_of())

    def sweep(cls: type) -> None:
        config = trainings.COST_TO_GO
        numbers = stacked([config.hyperparameters] * 2)
        data = cls(trainings.training_set())
        states = stacked([trainings.first_state(config)] * 2)
        training = cost_to_go.CostToGoTraining(config.recipe, draw_pairs)
        supervised_step(states, data, numbers, training=training, mesh=mesh_for_batch(config.batch_size, 2))

    def translate(cls: type) -> None:
        config = trainings.TRANSLATOR
        data, training = cls(trainings.image_set()), translator.TranslatorTraining(config, draw_images)
        state = training.first_state(config.hyperparameters)
        supervised_step(state, data, config.hyperparameters, training=training, mesh=mesh_of())

    def train_indoors(cls: type) -> None:
        config = trainings.COST_MAPS
        state = config.first_state(None)
        supervised_step(state, make_indoor(cls), training=config, mesh=mesh_of())

    @struct.dataclass
    class Level:
        """Predicts the same costs everywhere, indoors."""

        def estimate(self, maps, target, heading, image):
            return jnp.zeros(maps.shape[1:])

    def search(estimator: Any) -> None:
        agent = AGENT.replace(guide=guides.until_seen(guides.predicted), estimator=estimator)
        searches.search_all(agent, [house], searched, limit=12)

    def benchmark(cls: type) -> None:
        one = workload.make_workload(DATASET, per_house=1)
        workload.active_robots(one, cls(rules), rules.sensing, 2)

    def replayed(planner: Any) -> None:
        replay(world, make_pose(0, 4, 0), np.zeros(2, np.int8), planner=planner, rules=rules)

    def drive(planner: Any) -> None:
        drives.drives(planner, drives.EAST, time_limit=2.0)

    def picture(cls: type) -> None:
        side = np.kron(STREET, np.ones((2, 2), np.uint8))
        compare(cls(), side, np.ones(side.shape, np.float32), np.ones((1, 1), bool))

    of_planner, of_estimator = variants(Frontier, "plan"), variants(ExactCostToGo, "estimate")
    shown = np.full(STREET.shape, STREET[4, 0])
    return {
        "rollout, first state": (lambda cls: run(cls(rules)), variants(Frontier, "init")),
        "rollout, steps": (lambda cls: run(cls(rules)), of_planner),
        "rollout, estimator": (lambda cls: run(DC2G(cls(), rules)), of_estimator),
        "masks": (
            lambda cls: collect_masks(cls(rules), batch, *episodes, sensing=rules.sensing, per_episode=1, seed=0),
            of_planner,
        ),
        "replay": (lambda cls: replayed(cls(rules)), of_planner),
        "replay, estimator": (lambda cls: replayed(DC2G(cls(), rules)), of_estimator),
        "online, planner": (
            lambda cls: OnlinePlanner(cls(rules), sensing_range=4, largest=STREET.shape).plan(shown, (0, 4, 0)),
            of_planner,
        ),
        "online, estimator": (
            lambda cls: OnlinePlanner(network=cls(), sensing_range=4, largest=STREET.shape).plan(shown, (0, 4, 0)),
            of_estimator,
        ),
        "fleet": (lambda cls: drive(cls(drives.RULES)), of_planner),
        "searches, estimator": (lambda cls: search(cls()), variants(Level, "estimate")),
        "training": (train, variants(Drawer, "pairs")),
        "sweep": (sweep, variants(Drawer, "pairs")),
        "translator": (translate, variants(Drawer, "pairs")),
        "indoor training": (train_indoors, of_indoor),
        "environment": (
            lambda cls: gymnasium_env._reset(jax.random.key(0)[None], make_params(cls), environment),
            of_params,
        ),
        "pictures": (picture, of_estimator),
        "benchmark": (benchmark, of_planner),
    }


def main() -> None:
    """Print the verdicts as JSON."""
    jax.jit = colliding_jit
    verdicts = {}
    for name, (use, (first, second)) in boundaries().items():
        with contextlib.suppress(Traced):
            use(first)
        try:
            with contextlib.suppress(Traced):
                use(second)
            verdicts[name] = "the first class ran for the second"
        except Asked:
            verdicts[name] = "right"
        print(name, verdicts[name], flush=True)
    print(json.dumps(verdicts))


if __name__ == "__main__":
    main()
