"""Training pairs of the translator: images of whole maps, observation masks and costs (Algorithm 1)."""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import jax.numpy as jnp
import numpy as np

from dc2g_jax.datasets.drawn_masks import drawn_masks
from dc2g_jax.datasets.houses import House, HouseDataset, stack_worlds
from dc2g_jax.datasets.starts import sample_starts, why_no_episode
from dc2g_jax.errors import InputError
from dc2g_jax.grid.sampling import sample_grid
from dc2g_jax.planning.rules import SETTINGS
from dc2g_jax.rollouts.evaluation import episodes_from
from dc2g_jax.training.image_evaluation import GRID_CELLS
from dc2g_jax.training.image_pairs import ImageSet, all_pairs, houses_with_door, labeled_maps
from dc2g_jax.training.mask_collection import LEADERS, Masks, collect_masks, concatenate_masks, leading_planners

#: `paper` draws strokes, blobs and strips; `rollout` takes the observed cells of exploring robots.
MaskKind = Literal["paper", "rollout"]

#: Seeds of the masks by split. They are the same in every run.
MASK_SEEDS = {"train": 0, "val": 1, "test": 2}

#: Number of moments of a rollout that become masks.
_MOMENTS = 8


def rollout_masks(houses: Sequence[House], per_house: int, *, seed: int) -> Masks:
    """Observed cells of robots with 8-cell sensing at random moments, with the same number of masks for each house.

    Houses in which no episode can be run have none. If a house has too few different moments, some are repeated.

    Args:
      houses: houses on the robots' grid.
      per_house: number of masks of each house.
      seed: seed of starts, moments and the planners' errors.
    """
    rules = SETTINGS["paper"].rules()
    index = {house.name: number for number, house in enumerate(houses)}
    worlds = stack_worlds(houses)
    # Twice as many as needed, since moments with a reachable goal do not count.
    starts = sample_starts(houses, -(-2 * per_house // (_MOMENTS * LEADERS)), seed=seed)
    planners = leading_planners(rules, *houses[0].terrain.shape, seed=seed)
    episodes = episodes_from(starts, index)
    collect = partial(collect_masks, sensing=rules.sensing, per_episode=_MOMENTS, seed=seed)
    masks = concatenate_masks([collect(planner, worlds, episodes) for planner in planners])
    rng = np.random.default_rng(seed)
    chosen = []
    for number in np.unique(masks.world):
        own = np.flatnonzero(masks.world == number)
        chosen.append(rng.choice(own, per_house, replace=len(own) < per_house))
    order = np.concatenate(chosen)
    return Masks(boards=masks.boards[order], world=masks.world[order])


def image_set(dataset: HouseDataset, split: str, *, size: int, masks: MaskKind, per_house: int) -> ImageSet:
    """Pairs of a split (Algorithm 1).

    Args:
      dataset: houses with their whole images.
      split: split of the houses.
      size: rows and columns of the images.
      masks: kind of the observation masks.
      per_house: number of masks of each house.

    Raises:
      InputError: no house of the split can be used, or there are no masks.
    """
    if per_house < 1:
        raise InputError(f"{split}: {per_house} masks a house make no pairs; ask for at least 1")
    houses = houses_with_door(dataset, split)
    if masks == "paper":
        return all_pairs(houses, drawn_masks(per_house, size, seed=MASK_SEEDS[split]))
    grids = [House(house.name, split, sample_grid(house.terrain, GRID_CELLS)) for house in houses]
    if all(why_no_episode(house) for house in grids):
        raise InputError(f"{dataset.name}: no episode can be run in any {split} house; use --masks paper")
    collected = rollout_masks(grids, per_house, seed=MASK_SEEDS[split])
    terrain, cost = labeled_maps((house.terrain for house in houses), size)
    return ImageSet(
        terrain=jnp.asarray(terrain),
        cost_to_go=jnp.asarray(cost),
        masks=jnp.asarray(collected.boards),
        pair_house=jnp.asarray(collected.world, jnp.int32),
        pair_mask=jnp.arange(len(collected.world)),
    )
