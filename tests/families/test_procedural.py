"""The procedural houses: deterministic, usable, of the published dataset's make-up, and varied."""

import csv
from collections import Counter

import cv2
import numpy as np
import pytest

from dc2g_jax._src.grid.sampling import sample_grid
from dc2g_jax._src.grid.terrain import (
    CAR,
    CLASS_COLORS,
    DRIVEWAY,
    FRONT_DOOR,
    GRASS,
    HOUSE,
    PATH,
    ROAD,
    SIDEWALK,
    TRAVERSABLE,
)
from dc2g_jax._src.readers.houses import group_of, load_dataset, open_dataset
from dc2g_jax.families import procedural
from dc2g_jax.families.procedural import (
    PROCEDURAL_SPLIT,
    STYLES,
    draw_house,
    house_seed,
    is_usable,
    procedural_dataset,
    procedural_houses,
    procedural_training_houses,
    training_house_seed,
)
from dc2g_jax.families.procedural._filling import fill_polygons
from tests.support.houses import save_dataset
from tests.support.places import SHARED
from tests.support.refusals import refusal

DRAWN = {FRONT_DOOR, GRASS, ROAD, DRIVEWAY, CAR, PATH, HOUSE, SIDEWALK}


@pytest.fixture(scope="module")
def houses() -> list[tuple[str, str, np.ndarray]]:
    return procedural_houses(seed=0)


@pytest.fixture(scope="module")
def drawn(houses) -> dict[str, list[np.ndarray]]:
    """At least 25 houses of each style: those of the dataset and, where they are fewer, others."""
    by_style: dict[str, list[np.ndarray]] = {style: [] for style in STYLES}
    for (_, _, style), (_, _, classes) in zip(PROCEDURAL_SPLIT, houses, strict=True):
        by_style[style].append(classes)
    for style, some in by_style.items():
        some += [draw_house(1_000 + number, style) for number in range(25 - len(some))]
    return by_style


def road_cells_that_reach_a_door(classes: np.ndarray) -> int:
    """Flood from the doors, one step at a time, over traversable cells: independent of the generator."""
    grid = sample_grid(classes)
    reached = grid == FRONT_DOOR
    while True:
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown &= TRAVERSABLE[grid]
        if (grown == reached).all():
            return int((reached & (grid == ROAD)).sum())
        reached = grown


def test_the_same_seed_draws_the_same_house_whatever_was_drawn_before():
    for style in STYLES:
        first = draw_house(5, style)
        draw_house(6, style)
        np.random.default_rng().random()
        np.testing.assert_array_equal(draw_house(5, style), first)


def test_the_default_dataset_depends_on_its_seed_only(houses):
    for index in (0, 25, 40, 76):
        name, split, classes = houses[index]
        assert (name, split) == PROCEDURAL_SPLIT[index][:2]
        np.testing.assert_array_equal(classes, draw_house(house_seed(0, index), PROCEDURAL_SPLIT[index][2]))
        other = draw_house(house_seed(1, index), PROCEDURAL_SPLIT[index][2])
        assert other.shape != classes.shape or (other != classes).any()


def test_images_are_class_images_of_the_real_ones_sizes_and_classes(drawn):
    for house in (house for houses in drawn.values() for house in houses):
        assert house.dtype == np.uint8
        assert house.ndim == 2
        assert min(house.shape) >= 200
        assert max(house.shape) <= 930
        assert set(np.unique(house)) <= DRAWN


@pytest.mark.parametrize("style", STYLES)
def test_a_door_can_be_reached_from_the_road(drawn, style):
    for house in drawn[style]:
        grid = sample_grid(house)
        assert (grid == FRONT_DOOR).any()
        assert (grid == ROAD).any()
        assert road_cells_that_reach_a_door(house) >= 20
        assert is_usable(house)


def test_the_whole_default_dataset_is_usable(houses):
    assert all(road_cells_that_reach_a_door(classes) >= 20 for _, _, classes in houses)


def test_a_map_whose_door_is_cut_off_is_not_usable():
    cut_off = np.full((200, 300), GRASS, np.uint8)
    cut_off[:60] = ROAD
    cut_off[150:170, 100:120] = FRONT_DOOR
    assert not is_usable(cut_off)
    joined = cut_off.copy()
    joined[60:150, 105:115] = PATH
    assert is_usable(joined)


def test_the_split_has_the_published_make_up():
    assert Counter(split for _, split, _ in PROCEDURAL_SPLIT) == {"train": 31, "val": 4, "test": 42}
    make_up = Counter((name[:4], split) for name, split, _ in PROCEDURAL_SPLIT)
    assert make_up == {
        ("p000", "train"): 21,
        ("p001", "train"): 10,
        ("p001", "val"): 4,
        ("p001", "test"): 6,
        ("p002", "test"): 31,
        ("p004", "test"): 5,
    }
    assert len({name for name, _, _ in PROCEDURAL_SPLIT}) == 77
    styles = {name[:4]: style for name, _, style in PROCEDURAL_SPLIT}
    assert tuple(styles.values()) == STYLES


@pytest.mark.skipif(not SHARED.exists(), reason="../shared is absent")
def test_the_split_counts_are_those_of_the_published_files():
    published: Counter[tuple[str, str]] = Counter()
    folder = SHARED / "datasets" / "driveways_bing_iros19"
    for split, file in (("train", "training"), ("val", "validation"), ("test", "testing")):
        with (folder / f"{file}_houses.csv").open() as lines:
            published.update(("p" + row["house_id"][1:4], split) for row in csv.DictReader(lines))
    assert published == Counter((name[:4], split) for name, split, _ in PROCEDURAL_SPLIT)


def test_the_dataset_has_the_published_split_and_all_groups(houses, monkeypatch):
    monkeypatch.setattr(procedural, "procedural_houses", lambda seed, split: houses)  # drawn once
    dataset = open_dataset("procedural")
    assert [len(dataset.split(split)) for split in ("train", "val", "test")] == [31, 4, 42]
    assert len({house.name for house in dataset.houses}) == 77
    assert all(house.terrain.shape == (50, 50) for house in dataset.houses)
    groups = {group_of(house) for house in dataset.houses}
    assert groups == {"train", "val", "same_neighborhood", "new_neighborhood", "urban"}


def test_extra_houses_share_no_seed_with_the_dataset():
    dataset = {house_seed(seed, index) for seed in (0, 1, 2**32 - 1) for index in range(200)}
    extra = {training_house_seed(seed, index) for seed in (0, 1, 2**32 - 1) for index in range(200)}
    assert len(dataset) == len(extra) == 600  # no two alike
    assert not dataset & extra
    assert all(seed % 2 == 0 for seed in dataset)
    assert all(seed % 2 == 1 for seed in extra)


def test_extra_houses_go_through_all_styles_and_are_new(houses):
    extra = procedural_training_houses(8, seed=0)
    for index, classes in enumerate(extra):
        np.testing.assert_array_equal(classes, draw_house(training_house_seed(0, index), STYLES[index % 4]))
    known = {(classes.shape, classes.tobytes()) for _, _, classes in houses}
    assert not known & {(classes.shape, classes.tobytes()) for classes in extra}


def test_houses_vary(drawn):
    for style, houses in drawn.items():
        grids = np.array([sample_grid(house) for house in houses])
        pairs = (grids[:, None] != grids[None]).mean(axis=(2, 3))[np.triu_indices(len(grids), k=1)]
        assert pairs.min() > 0.08, style  # no two maps alike
        assert len({house.shape for house in houses}) > 20
        ratios = [house.shape[1] / house.shape[0] for house in houses]
        assert min(ratios) < 0.9
        assert max(ratios) > 1.1
        # Roads and houses lie anywhere in the picture, over the whole set.
        for terrain in (ROAD, HOUSE):
            assert (grids == terrain).any(axis=0).mean() > 0.5, style


def test_styles_differ_as_the_neighborhoods_do(drawn):
    def share(style: str, terrain: int) -> float:
        return float(np.mean([(sample_grid(house) == terrain).mean() for house in drawn[style]]))

    assert share("large_lots", SIDEWALK) == 0
    assert share("urban", SIDEWALK) > share("suburb_sidewalks", SIDEWALK) > 0
    assert share("large_lots", GRASS) > share("suburb_sidewalks", GRASS) > share("urban", GRASS)
    assert share("urban", HOUSE) > share("suburb_sidewalks", HOUSE) > share("large_lots", HOUSE)
    assert share("compact_suburb", CAR) > share("large_lots", CAR)


def test_bad_requests_are_refused(monkeypatch):
    with pytest.raises(ValueError, match="no style is called"):
        draw_house(0, "castle")
    with pytest.raises(ValueError, match="seed"):
        procedural_houses(seed=-1)
    with pytest.raises(ValueError, match="seed"):
        procedural_training_houses(1, seed=2**32)
    monkeypatch.setattr(procedural, "is_usable", lambda classes: False)
    monkeypatch.setattr(procedural, "draw_suburb", lambda rng, suburb: None)
    with pytest.raises(RuntimeError, match="100 drawings"):
        draw_house(0, STYLES[0])


def test_sampling_reads_pixel_centers_and_rounds_ties_down():
    columns = np.broadcast_to(np.arange(100, dtype=np.uint8) % 2 * (HOUSE - GRASS) + GRASS, (100, 100))
    assert (sample_grid(columns, 50) == GRASS).all()  # 100 -> 50: the tie 2 i + 0.5 reads pixel 2 i
    identity = np.random.default_rng(0).choice(np.array([GRASS, ROAD, HOUSE], np.uint8), (50, 50))
    np.testing.assert_array_equal(sample_grid(identity), identity)


def test_sampling_widens_paths_but_not_over_doors():
    classes = np.full((9, 9), GRASS, np.uint8)
    classes[4, 4] = PATH
    classes[3, 4] = FRONT_DOOR
    classes[4, 5] = HOUSE
    sampled = sample_grid(classes, 9)
    assert sampled[3, 4] == FRONT_DOOR
    assert (sampled == PATH).sum() == 8
    assert sampled[4, 5] == PATH


def test_sampling_refuses_what_is_no_class_image():
    with pytest.raises(ValueError, match="non-empty"):
        sample_grid(np.zeros((0, 5), np.uint8))
    with pytest.raises(ValueError, match="columns 0: give a whole number of at least 1"):
        sample_grid(np.zeros((5, 5), np.uint8), 0)


@pytest.mark.skipif(not SHARED.exists(), reason="../shared is absent")
def test_sampling_reproduces_the_golden_grids():
    golden = np.load(SHARED / "golden" / "grids.npz")
    folder = SHARED / "golden" / "houses_50" / "full_semantic"
    for house, split, terrain in zip(golden["house"], golden["split"], golden["terrain"], strict=True):
        picture = cv2.imread(str(folder / str(split) / f"world{house}.png"))
        assert picture is not None
        classes = (picture[:, :, None, ::-1] == CLASS_COLORS).all(axis=-1).argmax(axis=-1).astype(np.uint8)
        np.testing.assert_array_equal(sample_grid(classes), terrain)


@pytest.mark.skipif(int(cv2.__version__.split(".")[0]) < 5, reason="earlier versions cut polygons off differently")
@pytest.mark.parametrize("reach", [(0, 40), (-20, 60), (-300, 300), (-30_000, 30_000)])
def test_polygons_are_filled_as_by_opencv(reach):
    rng = np.random.default_rng(0)
    for case in range(150):
        sizes = rng.integers(1, 9, rng.integers(1, 6))
        corners = rng.integers(*reach, (sizes.sum(), 2))
        if case % 3:  # small ones
            corners = np.repeat(rng.integers(*reach, (len(sizes), 2)), sizes, axis=0) + rng.integers(
                -12, 12, corners.shape
            )
        wanted = np.zeros(rng.integers(1, 60, 2), np.uint8)
        found = wanted.copy()
        for polygon in np.split(corners.astype(np.int32), np.cumsum(sizes)[:-1]):
            cv2.fillPoly(wanted, [polygon], 1)
        fill_polygons(found, corners, sizes)
        np.testing.assert_array_equal(found, wanted)


def test_procedural_houses_are_sampled_like_images_and_survive_saving(tmp_path, monkeypatch):
    def drawing(seed: int, height: int = 60, width: int = 70) -> np.ndarray:
        return np.random.default_rng(seed).integers(0, len(CLASS_COLORS), (height, width)).astype(np.uint8)

    images = [("p000m000h000", "train", drawing(1)), ("p004m000h000", "test", drawing(2, 90, 55))]
    seeds: list[int] = []
    monkeypatch.setattr(procedural, "procedural_houses", lambda seed, split: seeds.append(seed) or images)
    draw_dataset = procedural_dataset.__wrapped__  # past its cache
    dataset = draw_dataset()
    assert (dataset.name, dataset.source) == ("procedural", "procedural")
    assert draw_dataset(3).name == "procedural-3"
    assert seeds == [0, 3]
    loaded = load_dataset(save_dataset(images, tmp_path / "saved"))
    for one, other in zip(dataset.houses, loaded.houses, strict=True):
        assert (one.name, one.split) == (other.name, other.split)
        np.testing.assert_array_equal(one.terrain, other.terrain)
    refusal(lambda: draw_dataset(cells=56), "p004m000h000", "wrong grid size", "55 x 90")


def test_one_split_of_the_procedural_houses_is_that_of_all():
    some, every = procedural_dataset(split="val"), procedural_dataset().split("val")
    assert [house.name for house in some.houses] == [house.name for house in every]
    for house, other in zip(some.houses, every, strict=True):
        np.testing.assert_array_equal(house.terrain, other.terrain)
