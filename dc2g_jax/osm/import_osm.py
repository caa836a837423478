"""Maps of the buildings of an OpenStreetMap extract: `dc2g map osm town.osm.pbf --out maps`."""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from tqdm import tqdm

from dc2g_jax.commands import CommandOptions, output_folder
from dc2g_jax.datasets import CELLS_FILE
from dc2g_jax.files import write_class_image, write_palette, write_table
from dc2g_jax.grid import DRIVEWAY, FRONT_DOOR, PATH, SIDEWALK, sample_grid
from dc2g_jax.osm.extract import ATTRIBUTION, read_extract
from dc2g_jax.osm.neighborhood import Neighborhood
from dc2g_jax.runtime import InputError, check_number

#: Files beside the maps.
_MAPS_FILE, _LEFT_OUT_FILE, _ATTRIBUTION_FILE, _ADDED_FOLDER = "maps.csv", "left_out.csv", "ATTRIBUTION.txt", "added"

#: Classes that may be added, whose cells the table of maps counts, and their indices.
_ADDED = {"front_door": FRONT_DOOR, "driveway": DRIVEWAY, "path": PATH, "sidewalk": SIDEWALK}

#: Buildings that a line about a reason names.
_NAMED = 5


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Make a folder of maps from an OpenStreetMap extract: one for each building with a street in reach.

    Attributes:
      extract: the extract: .osm, .osm.gz or .osm.pbf.
      out: folder to write to; every command takes it as --dataset.
      around: latitude and longitude in degrees: only buildings on whose maps this place is.
      meters: side of a map.
      cells: columns and rows of the grid that the maps are sampled to.
      seed: seed of the doors, driveways, walkways and sidewalks that are not mapped but added.
      only_mapped: add nothing. Buildings without a mapped front door are left out.
    """

    extract: tyro.conf.Positional[Path]
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    around: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="LAT LON", help_behavior_hint="")] = None
    meters: float = 60.0
    cells: int = 50
    seed: int = 0
    only_mapped: bool = False


def main(options: Options) -> None:
    """Read the extract, write a map of each building, and say which were left out."""
    check_number("--meters", options.meters, least=20, most=1000, hint="meters")
    check_number("--cells", options.cells, whole=True, least=10, most=2000)
    extract = read_extract(options.extract, options.around, 2 * options.meters)
    neighborhood = Neighborhood(
        extract,
        meters=options.meters,
        cells=options.cells,
        seed=options.seed,
        only_mapped=options.only_mapped,
        around=options.around is not None,
    )
    if not neighborhood.buildings:
        place = "" if options.around is None else " on whose map that place would be"
        raise InputError(
            f"{options.extract}: no building{place} is one that people live or work in; give another extract, other "
            "--around or larger --meters"
        )
    out = output_folder(options, "import_osm")
    (out / _ADDED_FOLDER).mkdir()
    write_palette(out)
    write_table(out / CELLS_FILE, ("columns", "rows"), [(options.cells, options.cells)])
    (out / _ATTRIBUTION_FILE).write_text(f"Map data {ATTRIBUTION}\n", encoding="utf-8")
    rows: list[list[object]] = []
    left_out: list[tuple[str, str]] = []
    for building in tqdm(neighborhood.buildings, desc="drawing", unit="map", file=sys.stderr):
        drawn = neighborhood.map_of(building)
        if isinstance(drawn, str):
            left_out.append((building.name, drawn))
            continue
        write_class_image(out / f"{building.name}.png", drawn.classes)
        write_class_image(out / _ADDED_FOLDER / f"{building.name}.png", drawn.added)
        tags = building.tags
        address = " ".join(tags[key] for key in ("addr:street", "addr:housenumber") if key in tags)
        rows.append([building.name, address, f"{drawn.latitude:.6f}", f"{drawn.longitude:.6f}"])
        rows[-1] += [int(np.sum(sample_grid(drawn.added, options.cells) == index)) for index in _ADDED.values()]
    write_table(out / _MAPS_FILE, ("map", "address", "latitude", "longitude", *_ADDED), rows)
    write_table(out / _LEFT_OUT_FILE, ("building", "reason"), left_out)
    _report(options, out, rows, left_out)


def _report(options: Options, out: Path, rows: list[list[object]], left_out: list[tuple[str, str]]) -> None:
    """Print what was drawn, added and left out. Raises InputError if all was left out."""
    by_reason: dict[str, list[str]] = {}
    for name, reason in left_out:
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        more = f" and {len(names) - _NAMED} more in {_LEFT_OUT_FILE}" if len(names) > _NAMED else ""
        print(f"left out, {reason}: {', '.join(names[:_NAMED])}{more}")
    if not rows:
        raise InputError(f"{options.extract}: all {len(left_out)} buildings were left out, see above")
    added = np.array([row[-len(_ADDED) :] for row in rows])
    counts = zip(_ADDED, np.sum(added > 0, axis=0), strict=True)
    maps = "1 map" if len(rows) == 1 else f"{len(rows)} maps"
    print(f"{out}: {maps} of {options.meters:g} m a side on {options.cells} x {options.cells} cells")
    if shown := ", ".join(f"{name} to {count}" for name, count in counts if count):
        print(f"Not mapped, but added: {shown}; see {_MAPS_FILE} and {_ADDED_FOLDER}/")
    print(f"Map data {ATTRIBUTION}")
