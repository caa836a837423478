"""Time the integration of depth images into semantic maps: `python -m experiments.mapping_speed`."""

import dataclasses

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.files.atomic import write_json

from .benchmarks.machine import describe
from .benchmarks.mapping import Case, mapping_row

CASES = (Case(1, (480, 640), 50), Case(1, (480, 640), 200), Case(1, (120, 160), 50), Case(256, (48, 64), 50))


@dataclasses.dataclass(frozen=True)
class Options(OutOptions):
    """Time the integration of depth and class images into voxel maps, and the projection to 2D maps.

    Attributes:
      repeats: measurements of each case.
    """

    repeats: int = 15


def main(options: Options) -> None:
    """Measure all cases, print a table and write `mapping_speed.json`."""
    require_positive(options, "repeats")
    out = output_folder(options, "mapping_speed")
    machine = describe()
    print(f"{machine['cpu']}, {machine['cores']} cores, {machine['platform']}, load {machine['load']}; times in ms")
    print("  robots      image   cells  integrate    worst   frames/s  terrain map    GiB")
    rows = []
    for case in CASES:
        row = mapping_row(case, options.repeats)
        rows.append(row._asdict())
        print(
            f"{row.robots:8d}{row.image[1]:7d}x{row.image[0]:3d}{row.cells:8d}{row.integrate:11.2f}{row.worst:9.2f}"
            f"{row.frames_a_second:11.1f}{row.terrain:13.2f}{row.gib:7.2f}",
            flush=True,
        )
    write_json(out / "mapping_speed.json", {"machine": machine, "rows": rows})
    print(f"Written: {out / 'mapping_speed.json'}")


if __name__ == "__main__":
    command_line(Options, main)
