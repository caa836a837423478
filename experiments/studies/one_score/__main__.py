"""Learn the weights of one score for all maps: `python -m experiments.studies.one_score --out outputs/one_score`."""

import dataclasses
import zipfile
from collections.abc import Iterable
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.reading import check_file
from dc2g_jax._src.planning.planners import Frontier
from dc2g_jax._src.planning.rules import named_settings
from dc2g_jax._src.rollouts.statistics import house_bootstrap
from dc2g_jax._src.runtime.errors import InputError, check_number

from .learn import Maps, drawn, fitted, maps_of, try_candidates, values
from .maps import LEAST_SIDE
from .planner import TERMS, Scored

#: Weights to begin with: the next best view, log gain less a tenth of the actions; and a little for the last choice.
START = {"actions": 0.01, "log_gain": -0.1, "kept": -0.02}

#: What to do about a file without maps.
_FOREIGN = "give --foreign an .npz file with the arrays names and free"

#: Bootstrap samples, and what is added to the seed of a round's maps for those that decide whether it is accepted.
_RESAMPLES, _APART = 10_000, 1_000_000


@dataclasses.dataclass(frozen=True)
class Options(OutOptions):
    """Learn the weights of the score by policy iteration, and compare it with frontier exploration.

    Attributes:
      rounds: number of rounds; each is kept only if it is better on fresh maps.
      maps: maps of each kind and size in a round; one decision in each.
      judged: maps of each kind and size that decide whether a round is kept.
      sides: cells a side of the maps.
      foreign: file of further maps to report on: arrays `names` (collection/map) and `free`, packed bits.
      seed: of everything random.
    """

    rounds: int = 3
    maps: int = 200
    judged: int = 20
    sides: tuple[int, ...] = (50, 100)
    foreign: Path | None = None
    seed: int = 0


def foreign_maps(path: Path, seed: int) -> Maps:
    """Maps that others drew, of 100 cells a side.

    Raises:
      InputError: the file cannot be read or holds no such maps.
    """
    check_file(path, _FOREIGN)
    try:
        with np.load(path) as file:
            names, free = file["names"], np.unpackbits(file["free"], axis=-1)[:, :, :100].astype(bool)
    except (ValueError, LookupError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: holds no maps ({error}); {_FOREIGN}") from None
    return maps_of(list(free), [str(name).partition("/")[0] for name in names], seed)


def table(scored: Scored, maps: Iterable[Maps]) -> list[str]:
    """Lines of a table: actions of the planner relative to frontier exploration, by kind of map and together."""
    lines = ["| maps | ratio | 95 % interval |", "|---|---|---|"]
    for own in maps:
        ratio = values(scored, own) - values(Frontier(scored.rules), own)
        kinds = np.array(own.kinds)
        for name in [*dict.fromkeys(own.kinds), "all"]:
            chosen = ratio[(kinds == name) | (name == "all")]
            mean = house_bootstrap(chosen, [str(number) for number in range(len(chosen))], resamples=_RESAMPLES, seed=0)
            lines.append(f"| {name}, {own.worlds.width} cells | {np.exp(mean.mean):.3f} | "
                         f"{np.exp(mean.low):.3f} to {np.exp(mean.high):.3f} |")  # fmt: skip
    return lines


def main(options: Options) -> None:
    """Learn, and report."""
    require_positive(options, "rounds", "maps", "judged")
    for side in options.sides:
        check_number("--sides", side, whole=True, least=LEAST_SIDE)
    foreign = [] if options.foreign is None else [foreign_maps(options.foreign, options.seed)]
    out = output_folder(options, "one_score")
    scored = Scored(named_settings("paper").rules(), jnp.asarray([START.get(term, 0.0) for term in TERMS], jnp.float32))
    for number in range(options.rounds):
        seed = options.seed + number
        parts = [try_candidates(scored, drawn(options.maps, seed, side)) for side in options.sides]
        better = dataclasses.replace(scored, weights=jnp.asarray(fitted(parts, np.asarray(scored.weights))))
        judges = [drawn(options.judged, seed + _APART, side) for side in options.sides]
        change = np.mean([np.mean(values(better, maps) - values(scored, maps)) for maps in judges])
        kept = "kept" if change < 0 else "not kept"
        print(f"Round {number + 1}: {sum(map(len, (part.value for part in parts)))} decisions, "
              f"{100 * change:+.2f} % actions, {kept}", flush=True)  # fmt: skip
        if change < 0:
            scored = better
        weights = dict(zip(TERMS, np.asarray(scored.weights).tolist(), strict=True))
        write_json(out / "weights.json", weights)
    last = [drawn(options.judged, options.seed + 2 * _APART, side) for side in options.sides]
    lines = table(scored, last + foreign)
    (out / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
