"""Pairs of pictures for the image-to-image translator: partial maps and their cost-to-go (Algorithm 1)."""

from collections.abc import Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from dc2g_jax.datasets.houses import House, HouseDataset
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.images import cost_to_go_image, semantic_image
from dc2g_jax.grid import bitboard, search
from dc2g_jax.grid.sampling import ClassImage, resize_nearest, sample_grid
from dc2g_jax.grid.terrain import FRONT_DOOR, TRAVERSABLE, UNKNOWN


@struct.dataclass
class ImageSet:
    """Whole maps, labels and observation masks; pictures are made from them on the device, a batch at a time.

    Attributes:
      terrain: class indices of every house.
      cost_to_go: exact cost-to-go of every house, 8-connected; infinity where there is none.
      masks: boards of what is observed, at any resolution.
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
    """A picture of a partial map and the picture of its cost-to-go, RGB from 0 to 1."""

    image: Float[Array, "*batch s s 3"]
    target: Float[Array, "*batch s s 3"]


def houses_with_door(dataset: HouseDataset, split: str) -> list[House]:
    """Houses of a split that have a cost-to-go at all: the paper's 31, 4 and 41.

    Raises:
      InputError: if there is none.
    """
    houses = [house for house in dataset.split(split) if np.any(house.terrain == FRONT_DOOR)]
    if not houses:
        raise InputError(f"{dataset.name}: no {split} house has a front door; pictures of a cost-to-go need one")
    return houses


_solve = jax.jit(search.cost_to_go)


def labelled_map(image: ClassImage, size: int) -> tuple[UInt8[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """A house's map and its exact cost-to-go, squeezed to a square (Algorithm 1, lines 4 and 5).

    Distances are those of the map in its own proportions, with `size` pixels along its longer side.

    Args:
      image: class indices of the whole house, of any size and proportions.
      size: rows and columns of the result.

    Returns:
      Class indices, and 8-connected costs in pixels of the unsqueezed map; infinity where there is none.
    """
    height, width = (max(1, round(size * side / max(image.shape))) for side in image.shape)
    reduced = np.full((size, size), UNKNOWN, np.uint8)
    reduced[:height, :width] = resize_nearest(image, height, width)
    cost = np.asarray(_solve(TRAVERSABLE[reduced], reduced == FRONT_DOOR))
    return resize_nearest(reduced[:height, :width], size, size), resize_nearest(cost[:height, :width], size, size)


def labelled_grid(image: ClassImage, cells: int) -> tuple[UInt8[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """A house's map and its exact cost-to-go on the grid that robots move on.

    Args:
      image: class indices of the whole house, of any size and proportions.
      cells: rows and columns of the grid.

    Returns:
      Class indices, and 8-connected costs in cells; infinity where there is none.
    """
    terrain = sample_grid(image, cells)
    return terrain, np.asarray(_solve(TRAVERSABLE[terrain], terrain == FRONT_DOOR))


def labelled_maps(
    images: Iterable[ClassImage], size: int
) -> tuple[UInt8[np.ndarray, "houses s s"], Float[np.ndarray, "houses s s"]]:
    """`labelled_map` of several houses, stacked."""
    terrain, cost = zip(*(labelled_map(image, size) for image in images), strict=True)
    return np.stack(terrain), np.stack(cost)


def all_pairs(houses: Sequence[House], masks: Bool[np.ndarray, "masks s s"]) -> ImageSet:
    """Every house under every mask, as in Algorithm 1.

    Args:
      houses: houses with their whole images.
      masks: what is observed; their size is that of the pictures.
    """
    terrain, cost = labelled_maps((house.terrain for house in houses), masks.shape[-1])
    return ImageSet(
        terrain=jnp.asarray(terrain),
        cost_to_go=jnp.asarray(cost),
        masks=jax.jit(jax.vmap(bitboard.pack))(jnp.asarray(masks)),
        pair_house=jnp.repeat(jnp.arange(len(houses)), len(masks)),
        pair_mask=jnp.tile(jnp.arange(len(masks)), len(houses)),
    )


def masked_pair(terrain: UInt8[Array, "s s"], cost_to_go: Float[Array, "s s"], seen: Bool[Array, "s s"]) -> ImagePair:
    """The pictures of a house under a mask (Algorithm 1, lines 7 and 8)."""
    observed = jnp.where(seen, terrain, jnp.uint8(UNKNOWN))
    return ImagePair(image=semantic_image(observed), target=cost_to_go_image(cost_to_go, observed))


def make_image_pair(data: ImageSet, index: Int[Array, ""]) -> ImagePair:
    """One of the pairs of a set."""
    size, mask_size = data.terrain.shape[-1], data.masks.shape[-1]
    mask = bitboard.unpack(data.masks[data.pair_mask[index]], mask_size)
    house = data.pair_house[index]
    return masked_pair(data.terrain[house], data.cost_to_go[house], resize_nearest(mask, size, size))


def draw_image_pairs(key: Array, step: Int[Array, ""], data: ImageSet, *, batch_size: int) -> ImagePair:
    """The batch of a step: all pairs in random order, then all of them in another order, and so on.

    Args:
      key: of the whole run.
      step: number of the step.
      data: the pairs.
      batch_size: pairs a step.
    """
    n_pairs = len(data.pair_house)

    def pair(place: Int[Array, ""]) -> ImagePair:
        epoch, rank = place // n_pairs, place % n_pairs
        order = jax.random.permutation(jax.random.fold_in(key, epoch), n_pairs)
        return make_image_pair(data, order[rank])

    return jax.vmap(pair)(step * batch_size + jnp.arange(batch_size))
