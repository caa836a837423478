"""Small houses for environments to be in."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from dc2g_jax._src.files.class_images import write_class_image, write_palette
from dc2g_jax._src.grid.terrain import ROAD
from dc2g_jax._src.readers.houses import SPLIT_FILES, House, HouseDataset
from tests.support.maps import drawn

#: Two doors, and ground to bump into.
STREET = drawn("""
    ##D#..t...
    ..P..##D#.
    ..P..##d#.
    SSPSSSSdSS
    RRRRRRRRRR
    RRRRRRRRRR
    SSSSSSSSSS
    .t...#....
""")

#: One door, close to few road cells; as large as the street.
YARD = drawn("""
    ..........
    .##D#.....
    .##P......
    ...PPP....
    .....R....
    .....R....
    ..........
    ..........
""")

#: As large, and no episode can be run in it.
WALLED = drawn("""
    ..........
    .###......
    .#D#......
    .###......
    ..........
    RRRRRRRRRR
    RRRRRRRRRR
    ..........
""")


def house(name: str, terrain: np.ndarray, split: str = "train") -> House:
    return House(name, split, terrain)


DATASET = HouseDataset(
    "small",
    "folder",
    (
        house("street", STREET),
        house("walled", WALLED),
        house("yard", YARD),
        house("lane", STREET[:, ::-1].copy(), "val"),
    ),
)


def start_poses(terrain: np.ndarray) -> set[tuple[int, int, int]]:
    """Every pose (x, y, heading) that a random episode may begin with: in these maps, all road."""
    return {(int(x), int(y), heading) for y, x in np.argwhere(terrain == ROAD) for heading in range(4)}


def save_dataset(images: Iterable[tuple[str, str, np.ndarray]], folder: Path) -> Path:
    """Write houses, `(name, split, classes)`, to a new folder in the published layout."""
    folder.mkdir()
    for name, split, classes in images:
        path = folder / "full_semantic" / split / f"world{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_class_image(path, classes)
        listed = folder / SPLIT_FILES[split]
        listed.write_text((listed.read_text() if listed.exists() else "house_id\n") + f"{name}\n")
    write_palette(folder)
    return folder
