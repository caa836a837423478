"""Training pairs from houses, and validation episodes (Algorithm 1 and section IV-B)."""

import dataclasses
import functools
import itertools
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt8
from tqdm import tqdm

from dc2g_jax._src.estimation.estimators import Estimator, NetworkCostToGo, world_cost_to_go
from dc2g_jax._src.estimation.weights import read_safetensors, write_safetensors
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.label_noise import IN_MAPS, noisy_map, scaled
from dc2g_jax._src.grid.sampling import sample_grid
from dc2g_jax._src.grid.sensing import PAPER_DEGREES, check_degrees, check_sensing_range, field_of_view
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.rules import SETTINGS, complete_rules
from dc2g_jax._src.readers.houses import PROCEDURAL, House, HouseDataset, stack_worlds, tell_on_stderr
from dc2g_jax._src.readers.starts import sample_starts, usable_houses
from dc2g_jax._src.rollouts.evaluation import Runner, episodes_from
from dc2g_jax._src.runtime.errors import InputError, check_number, short
from dc2g_jax._src.runtime.plugins import plugins
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax._src.training.masks import LEADERS, Masks, View, by_house, collect_masks, leading_planners
from dc2g_jax._src.training.pairs import SYMMETRY_COUNT, Pair, TrainingSet, jittered, make_pair

#: Seed of the procedural validation houses. Seeds of training must be below it.
_VALIDATION_SEED = 10_000

#: Number of validation pairs, and sensing ranges of their robots, in cells.
VALIDATION_PAIRS, _VALIDATION_RANGES = 256, (5, 8)

#: Least number of worlds that robots are run in: there are copies of the last one.
_LEAST_WORLDS = 64

#: Worlds per batch in the computation of labels.
_LABELS_AT_A_TIME = 128


@dataclasses.dataclass(frozen=True)
class DataConfig:
    """Training data of a network.

    Attributes:
      extra_houses: number of procedural houses besides the dataset's training houses; by default a tenth of the steps,
        2000 at most.
      starts_per_house: episodes in each of the dataset's training houses, for each sensing range and leading planner;
        by default one for every 500 steps, 12 at most.
      starts_per_extra_house: the same for the procedural houses.
      masks_per_episode: number of moments of each episode that become observation masks.
      ranges: sensing ranges, in cells, of the robots that collect the masks.
      field_of_view: width of their field of view in degrees; validation always uses the paper's 90.
      own_share: share of a batch drawn from the dataset's houses rather than procedural ones, 0 to 1.
      edge_weight: loss weight of cells within 2 cells of unobserved ground; others have weight 1.
      half_weight_cost: cost-to-go, in cells, at which a cell has half the weight of a goal; `inf` for equal weights.
      jitter: logarithm of the largest factor by which half of the maps are stretched; they are shifted by up to 40
        cells times it.
      whole_share: share of pairs with a fully observed map, 0 to 1.
      map_noise: highest level of camera noise in the maps; 0 for none.
      data_seed: seed of houses and masks, 0 to 9999.
    """

    extra_houses: int | None = None
    starts_per_house: int | None = None
    starts_per_extra_house: int = 1
    masks_per_episode: int = 4
    ranges: tuple[int, ...] = (4, 5, 6, 8, 10, 12)
    field_of_view: float = PAPER_DEGREES
    own_share: float = 0.4
    edge_weight: float = 4.0
    half_weight_cost: float = 16.0
    jitter: float = 0.15
    whole_share: float = 0.2
    map_noise: float = 0.0
    data_seed: int = 0

    def __post_init__(self) -> None:
        check_number("data seed", self.data_seed, whole=True, least=0, most=_VALIDATION_SEED - 1)
        if not self.ranges:
            raise InputError("sensing ranges: give one at least")
        for sensing_range in self.ranges:
            check_sensing_range("sensing range", sensing_range)
        check_degrees("field of view", self.field_of_view)
        for name, least in (
            ("extra_houses", 0), ("starts_per_house", 1), ("starts_per_extra_house", 1), ("masks_per_episode", 1),
        ):  # fmt: skip
            if getattr(self, name) is not None:
                check_number(name, getattr(self, name), whole=True, least=least)
        for name, most in (
            ("own_share", 1), ("whole_share", 1), ("edge_weight", math.inf), ("jitter", math.inf),
            ("map_noise", math.inf),
        ):  # fmt: skip
            check_number(name, getattr(self, name), least=0, most=most)
        if self.half_weight_cost != math.inf:
            check_number("half_weight_cost", self.half_weight_cost, above=0, hint="or inf")

    def for_steps(self, steps: int) -> "DataConfig":
        """The configuration with the numbers that depend on the steps of the training."""
        houses, starts = min(2000, steps // 10), min(12, max(1, steps // 500))
        return dataclasses.replace(
            self,
            extra_houses=houses if self.extra_houses is None else self.extra_houses,
            starts_per_house=starts if self.starts_per_house is None else self.starts_per_house,
        )

    def draw_batch(self, key: Array, data: TrainingSet, *, batch_size: int) -> Pair:
        """A random batch of training pairs, each in a random symmetry (Algorithm 1, line 9).

        Args:
          key: PRNG key.
          data: labels and masks. If there are masks of one kind of houses only, pairs are of these.
          batch_size: number of pairs.
        """
        which, place, turn, change, lift, noise = jax.random.split(key, 6)
        count = len(data.mask_world)
        own = (jax.random.uniform(which, (batch_size,)) < self.own_share) & (data.n_own > 0) | (data.n_own == count)
        low, high = jnp.where(own, 0, data.n_own), jnp.where(own, data.n_own, count)
        position = jax.random.uniform(place, (batch_size,))
        index = jnp.minimum(low + (position * (high - low)).astype(jnp.int32), high - 1)
        symmetry = jax.random.randint(turn, (batch_size,), 0, SYMMETRY_COUNT)
        whole = jax.random.bernoulli(lift, self.whole_share, (batch_size,))
        make = functools.partial(make_pair, data, edge_weight=self.edge_weight, half_weight_cost=self.half_weight_cost)
        pairs = jax.vmap(make)(index, symmetry, whole)

        def degraded(key: Array, terrain: UInt8[Array, "h w"]) -> UInt8[Array, "h w"]:
            level_key, noise_key = jax.random.split(key)
            level = jax.random.uniform(level_key, maxval=self.map_noise)
            return noisy_map(noise_key, terrain, scaled(IN_MAPS, level))

        if self.map_noise:
            keys = jax.random.split(noise, batch_size)
            pairs = dataclasses.replace(pairs, terrain=jax.vmap(degraded)(keys, pairs.terrain))
        if not self.jitter:
            return pairs
        return jax.vmap(functools.partial(jittered, jitter=self.jitter))(jax.random.split(change, batch_size), pairs)


def drawn_houses(prefix: str, split: str, count: int, seed: int, cells: int) -> list[House]:
    """Procedural houses on a grid of `cells` x `cells`."""
    images = plugins("training_houses")[PROCEDURAL].load()(count, seed)
    return [House(f"{prefix}{index:05d}", split, sample_grid(image, cells)) for index, image in enumerate(images)]


def _require_squares(own: list[House], drawn: int) -> None:
    """Check that procedural houses, if there are any, can be combined with a dataset's."""
    height, width = own[0].terrain.shape
    if drawn and height != width:
        raise InputError(
            f"{own[0].name}: has {width} x {height} cells, and drawn houses, which are square, are run beside it; "
            "sample the maps to squares, or have none drawn: --extra-houses 0, and --validate-every 0 (training) or "
            "--no-episodes (sweeps)"
        )


def check_houses(dataset: HouseDataset, *, extra: int, drawn: bool, validated: bool) -> None:
    """Check quickly, before anything is written, that a dataset can be trained on.

    Args:
      dataset: the houses.
      extra: number of procedural houses to train on besides.
      drawn: whether validation runs episodes in procedural houses.
      validated: whether the dataset's validation houses are used.

    Raises:
      InputError: no episode can be run in the houses of a split, or procedural houses cannot be combined with them.
    """
    _require_squares(usable_houses(dataset, "train"), extra)
    if validated:
        _require_squares(usable_houses(dataset, "val"), int(drawn))


def _with_drawn(own: list[House], prefix: str, count: int, seed: int) -> list[House]:
    """Houses of a dataset, followed by procedural ones on a grid of the same size.

    Raises:
      InputError: a house of the dataset is not square or has the name of a procedural house.
    """
    _require_squares(own, count)
    drawn = drawn_houses(prefix, own[0].split, count, seed, len(own[0].terrain))
    taken = {house.name for house in drawn}
    for house in own:
        if house.name in taken:
            raise InputError(f"{house.name}: a drawn house that is run beside it has this name; rename the house")
    return own + drawn


def training_houses(dataset: HouseDataset, config: DataConfig) -> tuple[list[House], int]:
    """The dataset's training houses followed by procedural ones of the same size; and the number of the former."""
    own = usable_houses(dataset, "train")
    return _with_drawn(own, "e", config.extra_houses or 0, config.data_seed), len(own)


def observation_masks(
    config: DataConfig,
    houses: Sequence[House],
    n_own: int,
    on_progress: Callable[[int, int], None],
    network: Estimator | None = None,
) -> Masks:
    """Masks of robots of all sensing ranges in all houses, ordered by house.

    Robots explore frontiers or are led by the exact cost-to-go with errors. With a network, it leads them instead, so
    that it learns from its own mistakes (DAgger). They then use every other sensing range of the configuration, and
    four times as many moments of each episode.

    Args:
      config: configuration of the training data.
      houses: the houses; those of the dataset first.
      n_own: number of houses of the dataset.
      on_progress: called as `on_progress(finished rollouts, total rollouts)`.
      network: network of the `dc2g` planner.
    """
    if network is not None:
        config = dataclasses.replace(config, ranges=config.ranges[::2], masks_per_episode=4 * config.masks_per_episode)
    index = {house.name: number for number, house in enumerate(houses)}
    # As many worlds as in other trainings, and the same ranges: one program.
    some = max(_LEAST_WORLDS, 1 << (len(houses) - 1).bit_length())
    worlds = stack_worlds([*houses, *(some - len(houses)) * [houses[-1]]])
    ranges = tuple(sorted({*config.ranges, *_VALIDATION_RANGES}))
    collected: list[Masks] = []
    rollouts = len(config.ranges) * (LEADERS if network is None else 1)
    on_progress(0, rollouts)
    for place, sensing_range in enumerate(config.ranges):
        view, sensing = None, field_of_view(sensing_range, config.field_of_view)
        if network is None:
            view = View(jnp.int32(ranges.index(sensing_range)), ranges, config.field_of_view)
            leaders, sensing = leading_planners(view, *houses[0].terrain.shape, seed=config.data_seed), view.widest
        else:
            leaders = [planner_with("dc2g", complete_rules(sensing_range, degrees=config.field_of_view), network)]
        for turn, planner in enumerate(leaders):
            seed = (config.data_seed * len(config.ranges) + place) * LEADERS + turn
            starts = sample_starts(houses[:n_own], config.starts_per_house or 1, seed=seed)
            starts += sample_starts(houses[n_own:], config.starts_per_extra_house, seed=seed)
            collected.append(
                collect_masks(
                    planner,
                    worlds,
                    *episodes_from(starts, index),
                    sensing=sensing,
                    view=view,
                    per_episode=config.masks_per_episode,
                    seed=seed,
                )
            )
            on_progress(len(collected), rollouts)
    return by_house(collected)


def check_masks(masks: Masks, houses: Sequence[House], where: str) -> None:
    """Check that masks belong to these houses.

    Args:
      masks: the masks.
      houses: the houses.
      where: source of the masks, for the message.

    Raises:
      InputError: the masks have another size or belong to other houses.
    """
    height, width = houses[0].terrain.shape
    boards, world = masks
    fit = boards.dtype == np.uint32 and boards.shape == (*world.shape[:1], bitboard.word_count(width), height)
    numbers = world.ndim == 1 and np.issubdtype(world.dtype, np.integer)
    if not fit or not numbers or np.any((world < 0) | (world >= len(houses))):
        raise InputError(
            f"{where}: masks of other houses than these {len(houses)} of {width} x {height} cells; delete the file to "
            "collect them anew"
        )


def training_set(houses: Sequence[House], n_own: int, masks: Masks) -> TrainingSet:
    """The training set of houses with their labels (Algorithm 1, line 5) and masks."""
    solve = jit(world_cost_to_go)
    labels = []
    for first in range(0, len(houses), _LABELS_AT_A_TIME):
        # The last call repeats the last house, so that all calls have the same shape.
        some = np.minimum(np.arange(first, first + _LABELS_AT_A_TIME), len(houses) - 1)
        labels.append(np.moveaxis(np.asarray(solve(stack_worlds([houses[number] for number in some]))), -1, 0))
    return TrainingSet(
        terrain=jnp.asarray(np.stack([house.terrain for house in houses])),
        cost_to_go=jnp.asarray(np.concatenate(labels)[: len(houses)]),
        masks=jnp.asarray(masks.boards),
        mask_world=jnp.asarray(masks.world, jnp.int32),
        n_own=jnp.int32(np.sum(masks.world < n_own)),
    )


#: Collects an object with arrays as attributes. Takes a function to report the finished and the total number of parts.
Collect = Callable[[Callable[[int, int], None]], object]


def kept_arrays(path: Path, names: Sequence[str], collect: Collect, *, unit: str) -> dict[str, np.ndarray]:
    """Arrays from a file, collected and saved there the first time.

    Args:
      path: the file.
      names: names of the arrays.
      collect: collects an object that has the arrays as attributes.
      unit: unit of the progress bar.

    Raises:
      InputError: the file cannot be read.
    """
    if path.exists():
        remedy = "delete it to collect its contents anew"
        found = read_safetensors(path, remedy, at_most=None)
        if set(found) != set(names):
            raise InputError(f"{path}: has the arrays {short(sorted(found))}, not {', '.join(names)}; {remedy}")
        return found
    with tqdm(desc=path.stem, unit=unit, delay=1e-9, file=sys.stderr) as bar:  # shown once its total is known

        def show(done: int, total: int) -> None:
            bar.n, bar.total = done, total
            bar.refresh()

        collected = collect(show)
    arrays = {name: np.asarray(getattr(collected, name)) for name in names}
    write_safetensors(path, arrays)
    return arrays


def open_training_set(
    folder: Path, dataset: HouseDataset, config: DataConfig, network: NetworkCostToGo | None = None
) -> TrainingSet:
    """The training set of the compact network. Its masks are saved in `folder`.

    Args:
      folder: folder for the masks.
      dataset: the houses.
      config: configuration of the training set.
      network: if given, masks of robots that this network leads are added.

    Raises:
      InputError: no house can be trained on, or saved masks cannot be read or belong to other houses.
    """
    houses, n_own = training_houses(dataset, config)

    def kept_masks(name: str, leader: NetworkCostToGo | None = None) -> Masks:
        collect = functools.partial(observation_masks, config, houses, n_own, network=leader)
        masks = Masks(**kept_arrays(folder / name, Masks._fields, collect, unit="rollout"))
        check_masks(masks, houses, str(folder / name))
        return masks

    parts = [kept_masks("masks.safetensors")]
    if network is not None:
        parts.append(kept_masks("masks_of_network.safetensors", network))
    data = training_set(houses, n_own, by_house(parts))
    tell_on_stderr(
        f"Training on {n_own} houses of the dataset ({dataset.name}) and {config.extra_houses} more that are drawn: "
        f"{len(data.mask_world)} observation masks, {int(data.n_own)} of the dataset's houses"
    )
    return data


def validation_pairs(dataset: HouseDataset, *, count: int = VALIDATION_PAIRS, edge_weight: float) -> Pair:
    """Validation pairs, the same in every run: half from the dataset's validation houses, half from procedural ones.

    Procedural houses are square. If the dataset's maps are not, all pairs are from the dataset.

    Args:
      dataset: dataset of the validation houses.
      count: number of pairs.
      edge_weight: see `training.pairs.make_pair`.
    """
    own = usable_houses(dataset, "val")
    height, width = own[0].terrain.shape
    houses = _with_drawn(own, "v", 32 if height == width else 0, _VALIDATION_SEED)
    config = DataConfig(
        starts_per_house=8, ranges=_VALIDATION_RANGES, own_share=0.5, edge_weight=edge_weight,
        half_weight_cost=math.inf, jitter=0.0, whole_share=0.0,
    )  # fmt: skip
    masks = observation_masks(config, houses, len(own), lambda done, total: None)
    data = training_set(houses, len(own), masks)
    return jit(functools.partial(config.draw_batch, batch_size=count))(jax.random.key(0), data)


def episodes_to_validate(
    dataset: HouseDataset, progress: Callable[[str, int, int], None]
) -> Callable[[Estimator], dict[str, float]]:
    """Episodes in validation houses: those of the dataset, and procedural ones that are not used in training.

    Args:
      dataset: dataset of the validation houses.
      progress: see `rollouts.evaluation.Runner`.

    Returns:
      A function of an estimator: mean and median extra steps of planner `dc2g` in percent, for 5-cell (`published`) and
      8-cell sensing (`paper`). `mean_extra`, the mean of the four means, is the figure for model selection.

    Raises:
      InputError: no episode can be run in any validation house, the oracle exceeds the step limit in one, or procedural
        houses cannot be combined with the dataset's.
    """
    own = usable_houses(dataset, "val")
    houses = HouseDataset("validation", "folder", tuple(_with_drawn(own, "v", 64, _VALIDATION_SEED)))
    runners = {name: Runner(houses, SETTINGS[name], progress=progress) for name in ("published", "paper")}
    starts = {"own": sample_starts(own, 20, seed=0), "procedural": sample_starts(houses.houses[len(own) :], 3, seed=0)}
    for runner, some in itertools.product(runners.values(), starts.values()):
        runner.run(some, ["oracle"])  # cached for later; raises before any training

    def figures(estimator: Estimator) -> dict[str, float]:
        found: dict[str, float] = {}
        for (settings, runner), (kind, some) in itertools.product(runners.items(), starts.items()):
            extra = np.array([result.extra for result in runner.run(some, ["dc2g"], estimator)])
            found[f"{settings}_{kind}_mean_extra"] = float(extra.mean())
            found[f"{settings}_{kind}_median_extra"] = float(np.median(extra))
        found["mean_extra"] = float(np.mean([value for name, value in found.items() if name.endswith("mean_extra")]))
        return {name: round(value, 2) for name, value in found.items()}

    return figures
