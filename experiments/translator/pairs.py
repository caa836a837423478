"""Image pairs for the image-to-image translator: partial maps and their cost-to-go (Algorithm 1)."""

from collections.abc import Sequence
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from dc2g_jax._src.grid import bitboard, search
from dc2g_jax._src.grid.sampling import ClassImage, resize_nearest, sample_grid
from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE, UNKNOWN
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House, HouseDataset, stack_worlds
from dc2g_jax._src.readers.starts import sample_starts, usable_houses
from dc2g_jax._src.rollouts.evaluation import episodes_from
from dc2g_jax._src.runtime.errors import InputError, check_number
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax._src.training.masks import LEADERS, Masks, View, by_house, collect_masks, leading_planners
from dc2g_jax._src.training.pairs import SYMMETRY_COUNT, turned
from experiments.translator.drawn_masks import drawn_masks
from experiments.translator.images import cost_to_go_image, largest_cost, semantic_image

#: Factor by which images are enlarged before a random crop, as in pix2pix.
_ENLARGED = 286 / 256

#: Side length of the gridworld, in cells (section IV-B).
GRID_CELLS = 50

#: `paper` draws strokes, blobs and strips; `rollout` takes the observed cells of exploring robots.
MaskKind = Literal["paper", "rollout"]

#: Seeds of the masks by split. They are the same in every run.
MASK_SEEDS = {"train": 0, "val": 1, "test": 2}

#: Number of moments of a rollout that become masks.
_MOMENTS = 8


@struct.dataclass
class ImageSet:
    """Whole maps, labels and observation masks. Images are made from them on the device, batch by batch.

    Attributes:
      terrain: class indices of every house.
      cost_to_go: exact cost-to-go of every house, 8-connected; infinity where there is none.
      masks: boards of observed cells, at any resolution.
      pair_house: index of the house of each pair.
      pair_mask: index of the mask of each pair.
    """

    terrain: UInt8[Array, "houses s s"]
    cost_to_go: Float[Array, "houses s s"]
    masks: UInt32[Array, "masks n_words m"]
    pair_house: Int[Array, "pairs"]
    pair_mask: Int[Array, "pairs"]


@struct.dataclass
class ImagePair:
    """The image of a partial map and the image of its cost-to-go, RGB from 0 to 1."""

    image: Float[Array, "*batch s s 3"]
    target: Float[Array, "*batch s s 3"]


def houses_with_door(dataset: HouseDataset, split: str) -> list[House]:
    """Houses of a split that have a front door, so that a cost-to-go exists: 31, 4 and 41 in the published dataset.

    Raises:
      InputError: there are none.
    """
    houses = [house for house in dataset.split(split) if np.any(house.terrain == FRONT_DOOR)]
    if not houses:
        raise InputError(f"{dataset.name}: no {split} house has a front door; pictures of a cost-to-go need one")
    return houses


_solve = jit(search.cost_to_go)


def labeled_map(image: ClassImage, size: int) -> tuple[UInt8[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """A house's map and its exact cost-to-go, resampled to a square (Algorithm 1, lines 4 and 5).

    Distances are those of the map in its own aspect ratio, with `size` pixels along its longer side.

    Args:
      image: class indices of the whole house, of any size and aspect ratio.
      size: rows and columns of the result.

    Returns:
      Class indices, and 8-connected costs in pixels of the map in its own aspect ratio; infinity without cost-to-go.
    """
    height, width = (max(1, round(size * side / max(image.shape))) for side in image.shape)
    reduced = np.full((size, size), UNKNOWN, np.uint8)
    reduced[:height, :width] = resize_nearest(image, height, width)
    cost = np.asarray(_solve(TRAVERSABLE[reduced], reduced == FRONT_DOOR))
    return resize_nearest(reduced[:height, :width], size, size), resize_nearest(cost[:height, :width], size, size)


def labeled_grid(image: ClassImage, cells: int) -> tuple[UInt8[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """A house's map and its exact cost-to-go on the grid that robots move on.

    Args:
      image: class indices of the whole house, of any size and aspect ratio.
      cells: rows and columns of the grid.

    Returns:
      Class indices, and 8-connected costs in cells; infinity without cost-to-go.
    """
    terrain = sample_grid(image, cells)
    return terrain, np.asarray(_solve(TRAVERSABLE[terrain], terrain == FRONT_DOOR))


def _pairs(
    houses: Sequence[House],
    size: int,
    masks: UInt32[Array | np.ndarray, "masks n_words m"],
    pair_house: Int[np.ndarray, "pairs"],
    pair_mask: Int[np.ndarray, "pairs"],
) -> ImageSet:
    """Pairs of a house, see `labeled_map`, and a mask, both by index."""
    terrain, cost = zip(*(labeled_map(house.terrain, size) for house in houses), strict=True)
    return ImageSet(
        terrain=jnp.asarray(np.stack(terrain)),
        cost_to_go=jnp.asarray(np.stack(cost)),
        masks=jnp.asarray(masks),
        pair_house=jnp.asarray(pair_house, jnp.int32),
        pair_mask=jnp.asarray(pair_mask, jnp.int32),
    )


def all_pairs(houses: Sequence[House], masks: Bool[np.ndarray, "masks s s"]) -> ImageSet:
    """All combinations of houses and masks, as in Algorithm 1.

    Args:
      houses: houses with their whole images.
      masks: true where a pixel is observed, in the size of the images to make.
    """
    boards = jit(jax.vmap(bitboard.pack))(jnp.asarray(masks))
    pair_house = np.repeat(np.arange(len(houses)), len(masks))
    pair_mask = np.tile(np.arange(len(masks)), len(houses))
    return _pairs(houses, masks.shape[-1], boards, pair_house, pair_mask)


def _rollout_masks(houses: Sequence[House], per_house: int, *, seed: int) -> Masks:
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
    view = View(jnp.int32(0), (rules.sensing.radius,))
    planners = leading_planners(view, *houses[0].terrain.shape, seed=seed)
    episodes = episodes_from(starts, index)
    collect = partial(collect_masks, sensing=rules.sensing, per_episode=_MOMENTS, seed=seed)
    masks = by_house([collect(planner, worlds, *episodes) for planner in planners])
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
    check_number("masks per house", per_house, whole=True, least=1)
    houses = houses_with_door(dataset, split)
    if masks == "paper":
        return all_pairs(houses, drawn_masks(per_house, size, seed=MASK_SEEDS[split]))
    grids = [House(house.name, split, sample_grid(house.terrain, GRID_CELLS)) for house in houses]
    usable_houses(HouseDataset(dataset.name, dataset.source, tuple(grids)), split, instead="use --masks paper")
    collected = _rollout_masks(grids, per_house, seed=MASK_SEEDS[split])
    return _pairs(houses, size, collected.boards, collected.world, np.arange(len(collected.world)))


class MaskedMap(NamedTuple):
    """A house with its cost-to-go and an observation mask.

    Attributes:
      terrain: class indices of the whole house.
      cost_to_go: exact cost-to-go, infinity where there is none.
      seen: true where a pixel is observed.
      largest: the largest finite cost of the whole house.
    """

    terrain: UInt8[Array, "s s"]
    cost_to_go: Float[Array, "s s"]
    seen: Bool[Array, "s s"]
    largest: Float[Array, ""]

    def pictures(self) -> ImagePair:
        """The images of the house under the mask (Algorithm 1, lines 7 and 8)."""
        observed = jnp.where(self.seen, self.terrain, jnp.uint8(UNKNOWN))
        return ImagePair(semantic_image(observed), cost_to_go_image(self.cost_to_go, observed, self.largest))


def masked_map(data: ImageSet, index: Int[Array, ""]) -> MaskedMap:
    """The masked map of one pair of a set."""
    size, mask_size = data.terrain.shape[-1], data.masks.shape[-1]
    mask = bitboard.unpack(data.masks[data.pair_mask[index]], mask_size)
    cost = data.cost_to_go[data.pair_house[index]]
    return MaskedMap(data.terrain[data.pair_house[index]], cost, resize_nearest(mask, size, size), largest_cost(cost))


def _jittered(whole: MaskedMap, key: Array) -> MaskedMap:
    """Enlarged by 286 / 256, randomly cropped to the original size, and turned to a random symmetry of the square."""
    size = whole.terrain.shape[-1]
    enlarged = round(size * _ENLARGED)
    corner_key, turn_key = jax.random.split(key)
    corner = jax.random.randint(corner_key, (2,), 0, enlarged - size + 1)
    symmetry = jax.random.randint(turn_key, (), 0, SYMMETRY_COUNT)

    def piece(part: Array) -> Array:
        cut = jax.lax.dynamic_slice(resize_nearest(part, enlarged, enlarged), corner, (size, size))
        return turned(cut, symmetry)

    return MaskedMap(piece(whole.terrain), piece(whole.cost_to_go), piece(whole.seen), whole.largest)


def draw_image_pairs(
    key: Array, step: Int[Array, ""], data: ImageSet, *, batch_size: int, whole_share: float, augment: bool
) -> ImagePair:
    """The batch of a step. Steps visit all pairs in random order, then all pairs in another random order, and so on.

    Args:
      key: random key of the whole run.
      step: number of the step.
      data: the pairs.
      batch_size: pairs per step.
      whole_share: share of pairs in which the whole map is observed instead of the part that the mask shows.
      augment: whether to enlarge and crop maps at random, as pix2pix does, and to turn them (pix2pix: mirror them).
    """
    n_pairs = len(data.pair_house)
    order_key, own_key = jax.random.split(key)

    def pair(place: Int[Array, ""]) -> ImagePair:
        epoch, rank = place // n_pairs, place % n_pairs
        order = jax.random.permutation(jax.random.fold_in(order_key, epoch), n_pairs)
        whole_key, jitter_key = jax.random.split(jax.random.fold_in(own_key, place))
        drawn = masked_map(data, order[rank])
        drawn = drawn._replace(seen=drawn.seen | jax.random.bernoulli(whole_key, whole_share))
        return (_jittered(drawn, jitter_key) if augment else drawn).pictures()

    return jax.vmap(pair)(step * batch_size + jnp.arange(batch_size))
