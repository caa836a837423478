"""Houses as class grids: the published dataset, folders in its format, folders of maps, and procedural houses."""

import collections
import hashlib
import os
import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dc2g_jax._src.files.class_images import PALETTE_FILE, read_class_image, read_palette
from dc2g_jax._src.files.tables import read_table
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers._download import ORIGIN, NetworkUnavailable, fetch_dataset, matches_published
from dc2g_jax._src.readers.maps import CELLS_FILE, MAP_ENDINGS, SPLITS, map_files, read_map_folder, sampled
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number, short
from dc2g_jax._src.runtime.own_parts import is_own_part, own_part
from dc2g_jax._src.runtime.plugins import plugins

SPLIT_FILES = dict(zip(SPLITS, ("training_houses.csv", "validation_houses.csv", "testing_houses.csv"), strict=True))
_IMAGE_FOLDER = "full_semantic"
_PUBLISHED_NAME = "driveways_bing_iros19"

#: The location that stands for the procedural houses.
PROCEDURAL = "procedural"

#: Words for datasets of plug-ins.
_BY_PLUGINS = plugins("datasets")

#: Locations that are words instead of folders.
NAMED = (PROCEDURAL, *(name for name in _BY_PLUGINS if name != PROCEDURAL))

_TEST_GROUPS = {"001": "same_neighborhood", "002": "new_neighborhood", "004": "urban"}


@dataclass(frozen=True, eq=False)
class House:
    """One house with its surroundings.

    Attributes:
        name: `nNNNmMMMhHHH` in the published dataset (neighborhood, map, house).
        split: 'train', 'val' or 'test'.
        terrain: class indices, read-only: uint8 [H W].
    """

    name: str
    split: str
    terrain: np.ndarray

    @property
    def neighborhood(self) -> str:
        """The first four characters of the name, such as `n001`."""
        return self.name[:4]


@dataclass(frozen=True, eq=False)
class HouseDataset:
    """Houses in the order of training, validation and test split, each split in the order of its list.

    Attributes:
        name: name of the dataset in results.
        source: 'published' (every file equals the authors'), 'procedural' or 'folder'.
        houses: all of them; names are unique.

    Raises:
        InputError: two houses have the same name.
    """

    name: str
    source: str
    houses: tuple[House, ...]

    def __post_init__(self) -> None:
        for name, count in collections.Counter(house.name for house in self.houses).items():
            if count > 1:
                raise InputError(f"{self.name}: {count} houses are called {name!r}; names must be unique")

    @property
    def sha256(self) -> str:
        """SHA-256 of the houses' names, splits and terrain."""
        digest = hashlib.sha256()
        for house in self.houses:
            digest.update(f"{house.name} {house.split} {house.terrain.shape} ".encode())
            digest.update(house.terrain.tobytes())
        return digest.hexdigest()

    def split(self, split: str) -> tuple[House, ...]:
        """Return the houses of 'train', 'val' or 'test'. Raises InputError for any other split."""
        check_name(f"split of {self.name}", split, SPLIT_FILES)
        return tuple(house for house in self.houses if house.split == split)

    def house(self, name: str) -> House:
        """Return the house of this name. Raises InputError, with the closest names, if there is none."""
        houses = {house.name: house for house in self.houses}
        check_name(f"house of {self.name}", name, houses, "(--dataset says which houses there are)")
        return houses[name]


def stack_worlds(houses: Iterable[House]) -> World:
    """The worlds of houses of equal grid size, stacked in their order along the last axis.

    Raises:
        InputError: the sizes of two houses differ.
    """
    houses = tuple(houses)
    for house in houses:
        if house.terrain.shape != houses[0].terrain.shape:
            sizes = [f"{one.name} has {one.terrain.shape[1]} x {one.terrain.shape[0]}" for one in (houses[0], house)]
            rows, columns = np.min([one.terrain.shape for one in houses], axis=0)
            raise InputError(
                f"{' cells, '.join(sizes)}: houses that are run together need one size; sample all to one, such as "
                f"{columns} x {rows}, by the lines 'columns,rows' and '{columns},{rows}' in {CELLS_FILE} of the dataset"
            )
    return World.from_terrain(np.stack([house.terrain for house in houses], axis=-1))


def group_of(house: House) -> str:
    """Return the paper's category of a house (section IV).

    Test houses are 'same_neighborhood' in neighborhood ?001, parts of which are in the training split,
    'new_neighborhood' in ?002, 'urban' in ?004, and 'test' elsewhere. The category of others is their split.
    """
    return _TEST_GROUPS.get(house.neighborhood[1:], "test") if house.split == "test" else house.split


def load_dataset(folder: str | os.PathLike[str], *, cells: int | None = 50) -> HouseDataset:
    """Read a folder in the published layout.

    The layout: `labels_colors.csv`; the house lists `training_houses.csv`, `validation_houses.csv` and
    `testing_houses.csv` with the column `house_id`, of which up to two may be absent; and one image per house,
    `full_semantic/{train,val,test}/world<house_id>.png`. Images that no list names are ignored.

    Args:
        folder: the dataset.
        cells: side of the square grid to which every image is sampled; `None` for no sampling.

    Raises:
        InputError: anything in the folder is missing, damaged or contradictory; the message names the file, the
            value and the remedy.
    """
    folder = Path(folder)
    try:
        _check_folder(folder)
        listed = _read_house_lists(folder)
        palette = read_palette(folder / PALETTE_FILE)
        houses = []
        for name, (split, listing) in listed.items():
            path = folder / _IMAGE_FOLDER / split / f"world{name}.png"
            if not path.exists():
                raise InputError(
                    f"{path}: no such file, but {listing} lists house {name!r}; add the image or delete the line"
                )
            houses.append(House(name, split, sampled(str(path), read_class_image(path, palette), cells)))
        if matches_published(folder):
            return HouseDataset(_PUBLISHED_NAME, "published", tuple(houses))
        return HouseDataset(folder.resolve().name, "folder", tuple(houses))
    except OSError as error:
        where = error.filename or folder
        raise InputError(f"{where}: cannot be read ({error.strerror}); allow reading or copy it") from None


def map_dataset(folder: str | os.PathLike[str]) -> HouseDataset:
    """Read a folder of maps of any size, see `readers.maps.read_map_folder`."""
    folder = Path(folder)
    try:
        houses = tuple(House(name, split, terrain) for name, split, terrain in read_map_folder(folder))
    except OSError as error:
        raise InputError(f"{error.filename or folder}: cannot be read ({error.strerror})") from None
    for house in houses:
        _check_name(folder, house.name)
    return HouseDataset(folder.resolve().name, "folder", houses)


def tell_on_stderr(line: str) -> None:
    """Print one line to the error stream, apart from results."""
    print(line, file=sys.stderr, flush=True)


def open_dataset(
    location: str | os.PathLike[str] | None = None,
    *,
    cells: int | None = 50,
    split: str | None = None,
    log: Callable[[str], None] = tell_on_stderr,
) -> HouseDataset:
    """Open a dataset, by default the published one.

    The first of these that is given or available: `location`; the environment variable `DC2G_DATA`; an earlier
    download; a download from the authors' repository; and, only if the repository does not answer, the procedural
    houses, with one line through `log`.

    Args:
        location: a folder in the published layout, of maps, or of OpenStreetMap extracts; one of the words
            'procedural', 'towns', 'mazes', 'halls', 'offices' and 'floor_plans'; or `package.module:Name` for a
            `HouseDataset` of your own, or a function that returns one.
        cells: side of the square grids of published and procedural houses; `None` for no sampling.
        split: the only split that is needed, if there is one; drawing the others may take seconds.
        log: receives the line about the fallback.

    Raises:
        InputError: the given location is not a valid dataset, a downloaded file is not the published one, or the
            download is refused or interrupted. These cases never fall back to other houses.
    """
    if cells is not None:
        check_number("cells", cells, whole=True, least=1)
    if location is not None:
        return _open_location(os.fspath(location), "the dataset location", cells, split)
    if os.environ.get("DC2G_DATA"):
        return _open_location(os.environ["DC2G_DATA"], "DC2G_DATA", cells, split)
    try:
        folder = fetch_dataset()
    except NetworkUnavailable as reason:
        log(
            f"The published dataset is not here and cannot be downloaded ({reason}): using the "
            "procedural houses instead. To use the published houses, pass --dataset FOLDER or set DC2G_DATA: a copy of "
            f"{ORIGIN}."
        )
        return _BY_PLUGINS[PROCEDURAL].load()(cells=cells, split=split)
    return load_dataset(folder, cells=cells)


def _open_location(location: str, setting: str, cells: int | None, split: str | None) -> HouseDataset:
    if location in _BY_PLUGINS:
        return _BY_PLUGINS[location].load()(cells=cells, split=split)
    if is_own_part(location):
        return _own_dataset(location)
    try:
        folder = Path(location).expanduser()
        found = bool(location) and folder.is_dir()
    except (OSError, RuntimeError):
        found = False
    if not found:
        names = ", ".join(NAMED)
        raise InputError(f"{location!r}: {setting} is not a folder; give the folder of a dataset, or one of {names}")
    for plugin in plugins("dataset_folders").values():
        dataset = plugin.load()(folder)
        if dataset is not None:
            return dataset
    return map_dataset(folder) if _is_map_folder(folder) else load_dataset(folder, cells=cells)


def _own_dataset(name: str) -> HouseDataset:
    found = own_part("dataset", name, NAMED)
    made = found() if callable(found) else found
    if not isinstance(made, HouseDataset):
        is_or_returns = "returns" if callable(found) else "is"
        raise InputError(
            f"dataset {name!r}: {is_or_returns} {short(made)}; give a HouseDataset, or a function that returns one"
        )
    if not made.houses:
        raise InputError(f"dataset {name!r}: has no houses; give at least one")
    return made


def _is_map_folder(folder: Path) -> bool:
    """Whether a folder contains maps and nothing of the published layout. False for folders that cannot be listed."""
    published = [folder / name for name in (_IMAGE_FOLDER, *SPLIT_FILES.values())]
    try:
        return not any(path.exists() for path in published) and bool(map_files(folder))
    except OSError:
        return False


def _check_folder(folder: Path) -> None:
    needed = f"{PALETTE_FILE}, {_IMAGE_FOLDER}/ and house lists such as {SPLIT_FILES['test']}"
    if not folder.is_dir() or not any(folder.iterdir()):
        raise InputError(f"{folder}: is not a folder, or is empty; give a folder with {needed}")
    if not any((folder / name).exists() for name in SPLIT_FILES.values()):
        lists = ", ".join(SPLIT_FILES.values())
        raise InputError(
            f"{folder}: has no house list; add at least one of {lists} with the column house_id, or maps that end in "
            f"{', '.join(MAP_ENDINGS)}"
        )


def _read_house_lists(folder: Path) -> dict[str, tuple[str, str]]:
    """Return house -> its split, and where it is listed."""
    listed: dict[str, tuple[str, str]] = {}
    for split, file_name in SPLIT_FILES.items():
        path = folder / file_name
        if not path.exists() and not any((folder / _IMAGE_FOLDER / split).glob("world*.png")):
            continue
        remedy = f"list the houses of {_IMAGE_FOLDER}/{split} there, one a line below the header house_id"
        for line, row in read_table(path, ["house_id"], remedy=remedy):
            name = row["house_id"]
            _check_name(f"{path}: line {line}", name)
            if name in listed:
                raise InputError(
                    f"{path}: line {line} lists house {name!r}, which {listed[name][1]} lists already; a house belongs "
                    "to one split, delete one of the two"
                )
            listed[name] = split, f"line {line} of {file_name}"
    return listed


def _check_name(where: object, name: str) -> None:
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise InputError(f"{where}: {name!r} cannot be a house name; use letters, digits, '_', '-' and '.'")
