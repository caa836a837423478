"""Procedural houses: a seeded dataset of semantic maps structured like the published one, and further training houses.

Nothing is downloaded. A map is generated from streets, lots, driveways and walkways, again and again until a
robot that starts on the road can reach a front door in the map's 50x50 grid.
"""

import functools

import numpy as np

from dc2g_jax.datasets import PROCEDURAL, House, HouseDataset, sampled
from dc2g_jax.families.procedural._city import draw_city
from dc2g_jax.families.procedural.drawing import first_usable
from dc2g_jax.families.procedural.suburbs import SUBURBS, draw_suburb
from dc2g_jax.grid import ROAD, ClassImage, connected_to_goal, sample_grid
from dc2g_jax.runtime import check_name, check_number

#: Styles of the four neighborhoods. No training house of the default dataset is "urban".
STYLES: tuple[str, ...] = (*SUBURBS, "urban")

#: Least number of road cells of the 50x50 grid from which a front door can be reached.
MIN_ROAD_CELLS = 20

# Splits of the houses of each neighborhood, one neighborhood a style; as many as in the published dataset.
_SPLITS = {
    "p000": ("train",) * 21,
    "p001": ("train",) * 10 + ("val",) * 4 + ("test",) * 6,
    "p002": ("test",) * 31,
    "p004": ("test",) * 5,
}

#: (name, split, style) of the 77 houses of the default dataset: 31 train, 4 val, 42 test.
PROCEDURAL_SPLIT: tuple[tuple[str, str, str], ...] = tuple(
    (f"{neighborhood}m{number // 10:03d}h{number % 10:03d}", split, style)
    for (neighborhood, splits), style in zip(_SPLITS.items(), STYLES, strict=True)
    for number, split in enumerate(splits)
)


def house_seed(seed: int, index: int) -> int:
    """The seed of house `index` of `procedural_houses(seed)`: an even number, its own. Both are below 2^32."""
    for name, number in (("seed", seed), ("index", index)):
        check_number(name, number, whole=True, least=0, most=2**32 - 1)
    return 2 * ((seed << 32) | index)


def training_house_seed(seed: int, index: int) -> int:
    """The seed of house `index` of `procedural_training_houses`: an odd number, its own."""
    return house_seed(seed, index) + 1


def is_usable(classes: ClassImage, cells: int = 50) -> bool:
    """Whether a front door can be reached from at least `MIN_ROAD_CELLS` road cells of the map's grid."""
    grid = sample_grid(classes, cells)
    return int(np.sum(connected_to_goal(grid) & (grid == ROAD))) >= MIN_ROAD_CELLS


def draw_house(seed: int, style: str) -> ClassImage:
    """Generate the semantic map of one house. It depends only on the arguments.

    Args:
        seed: a non-negative integer; seeds below 2^128 give different streams of random numbers.
        style: one of `STYLES`.

    Returns:
        Class indices, uint8 [H W], each side 200 to 930 pixels; `is_usable` holds for it.
    """
    check_name("style", style, STYLES)

    def draw(rng: np.random.Generator) -> ClassImage | None:
        classes = draw_city(rng) if style == "urban" else draw_suburb(rng, SUBURBS[style])
        return classes if classes is not None and is_usable(classes) else None

    return first_usable(draw, seed, (STYLES.index(style),), f"{style} house")


def procedural_houses(seed: int = 0, split: str | None = None) -> list[tuple[str, str, ClassImage]]:
    """The default dataset: (name, split, class indices uint8 [H W]) of 77 houses, as in `PROCEDURAL_SPLIT`.

    With a `split`, the others are not drawn: a house does not depend on the others.

    Raises:
        InputError: the seed is not a whole number from 0 to 2^32 - 1.
    """
    return [
        (name, of, draw_house(house_seed(seed, index), style))
        for index, (name, of, style) in enumerate(PROCEDURAL_SPLIT)
        if split in (None, of)
    ]


@functools.lru_cache(maxsize=4)
def procedural_dataset(seed: int = 0, *, cells: int | None = 50, split: str | None = None) -> HouseDataset:
    """Return the procedural houses, sampled to `cells` x `cells` like images from a folder (`None`: no sampling).

    With a `split`, the others are not drawn: drawing all takes seconds.

    Raises:
      InputError: the seed is invalid, or `cells` is less than 1 or more than the maps have pixels.
    """
    name = PROCEDURAL if seed == 0 else f"{PROCEDURAL}-{seed}"
    houses = (
        House(house, of, sampled(f"procedural house {house}", classes, cells))
        for house, of, classes in procedural_houses(seed, split)
    )
    return HouseDataset(name, PROCEDURAL, tuple(houses))


def procedural_training_houses(count: int, seed: int) -> list[ClassImage]:
    """Further houses for training, in all four styles in turn. None shares its seed with a house of the dataset.

    Args:
        count: number of houses.
        seed: seed in [0, 2^32).

    Returns:
        Class indices of each, uint8 [H W].

    Raises:
        InputError: if the seed is not in [0, 2^32).
    """
    check_number("count", count, whole=True, least=0)
    return [draw_house(training_house_seed(seed, index), STYLES[index % len(STYLES)]) for index in range(count)]
