"""Losses of the indoor network to compare with the paper's, and the comparison, `python -m
experiments.studies.indoor_losses`.

Networks come from `python -m experiments.objectnav_train --loss experiments.studies.indoor_losses:NAME`, all with the
same samples in `validation.safetensors`.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Array, Bool, Float

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.weights import read_safetensors
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.digests import tree_sha256
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.grid.squares import shifted
from dc2g_jax._src.rollouts.statistics import house_bootstrap
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax.indoor.learning import networks
from dc2g_jax.indoor.learning.networks import COST_UNIT, Prediction, load_costs
from dc2g_jax.indoor.maps.mapping import network_maps
from experiments.objectnav.data import LOCAL, NORMALIZATIONS, UPRIGHT, JourneySet, Samples, draw_samples
from experiments.objectnav.losses import (
    FIVE_ACTIONS,
    LOSS_WEIGHTS,
    NINE_ACTIONS,
    action_accuracy,
    confusion,
    cost_loss,
    direction_loss,
    gradient,
    occupancy_scores,
    total_loss,
)

#: Label of a cell that is not free floor where one map tells both, and the cost above which a cell counts as such: 30
#: and 20 m beyond the map's best cell.
BLOCKED, HIGHEST = 3.0, 2.0

#: Maps a batch, bootstrap samples.
_BATCH, _RESAMPLES = 16, 10_000


def _some(
    names: tuple[str, ...], prediction: Prediction, occupied: Bool[Array, "h w"], cost: Float[Array, "h w"]
) -> tuple[Float[Array, ""], dict[str, Any]]:
    """Some of the paper's losses with their weights. The network learns nothing of the others."""
    _, parts = total_loss(prediction, occupied, cost)
    return sum((LOSS_WEIGHTS[name] * parts[name] for name in names), jnp.float32(0)), parts


#: The paper's losses without that of directions; without that of occupancy.
no_direction = functools.partial(_some, ("occupancy", "cost"))
cost_alone = functools.partial(_some, ("cost", "direction"))


def one_cost(prediction: Prediction) -> Float[Array, "*b h w"]:
    """The one map of `one_map`: both decoders' outputs together."""
    return prediction.cost + prediction.occupancy_logits


def one_map(
    prediction: Prediction, occupied: Bool[Array, "h w"], cost: Float[Array, "h w"]
) -> tuple[Float[Array, ""], dict[str, Any]]:
    """One task: a single map, the sum of both decoders' outputs, is the cost, and `BLOCKED` where no robot fits."""
    navigable = ~occupied & jnp.isfinite(cost)
    ours, label = one_cost(prediction), jnp.where(occupied, BLOCKED, cost)
    losses = {"cost": cost_loss(ours, label, navigable | occupied), "direction": direction_loss(ours, cost, navigable)}
    return sum((LOSS_WEIGHTS[name] * loss for name, loss in losses.items()), jnp.float32(0)), losses


def bends(costs: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Sum of the absolute second differences in rows and columns, and their number: three navigable cells in a row."""
    values, total, count = jnp.where(navigable, costs, 0), jnp.float32(0), jnp.float32(0)
    for dx, dy in ((0, 1), (1, 0)):
        there = navigable & shifted(navigable, dx, dy, False) & shifted(navigable, -dx, -dy, False)
        second = shifted(values, dx, dy, 0) + shifted(values, -dx, -dy, 0) - 2 * values
        total, count = total + jnp.sum(jnp.where(there, jnp.abs(second), 0)), count + jnp.sum(there)
    return total, count


def hollows(costs: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Navigable cells with a navigable neighbor among eight, all of which have a higher cost."""
    values = jnp.where(navigable, costs, jnp.inf)
    around = [shifted(values, right, down, jnp.inf) for down, right in NINE_ACTIONS[1:]]
    lowest = functools.reduce(jnp.minimum, around)
    return navigable & jnp.isfinite(lowest) & (values < lowest)


def _figures_of(prediction: Prediction, occupied: Array, true: Array, one: bool) -> dict[str, Array]:
    """Figures of one map; sums with their counts where a house's maps are to be taken together."""
    navigable = ~occupied & jnp.isfinite(true)
    cost = one_cost(prediction) if one else prediction.cost
    blocked = cost > HIGHEST if one else prediction.occupancy > 0.5
    final = jnp.where(blocked, jnp.inf, cost)
    ours, theirs = gradient(cost, navigable), gradient(true, navigable)
    slopes = jnp.sum(theirs**2, axis=0) > 0
    turn = jnp.arctan2(theirs[0] * ours[1] - theirs[1] * ours[0], jnp.sum(ours * theirs, axis=0))
    level = jnp.where(navigable, true, 0)
    bent, bendable = bends(COST_UNIT * cost, navigable)
    truly, _ = bends(COST_UNIT * level, navigable)
    astray, _ = bends(COST_UNIT * (cost - level), navigable)
    spurious = hollows(cost, navigable) & ~hollows(true, navigable)
    return {
        "confusion": confusion(blocked, occupied),
        "aAP5": action_accuracy(final, true, FIVE_ACTIONS),
        "aAP9": action_accuracy(final, true, NINE_ACTIONS),
        "aAP5 unmasked": action_accuracy(cost, true, FIVE_ACTIONS),
        "maps": jnp.float32(1),
        "navigable": jnp.sum(navigable).astype(jnp.float32),
        "error": COST_UNIT * jnp.sum(jnp.where(navigable, jnp.abs(cost - level), 0)),
        "slopes": jnp.sum(slopes).astype(jnp.float32),
        "angle": jnp.rad2deg(jnp.sum(jnp.where(slopes, jnp.abs(turn), 0))),
        "bendable": bendable,
        "bends": bent,
        "true bends": truly,
        "bends of the error": astray,
        "hollows": jnp.sum(spurious).astype(jnp.float32),
    }


@functools.partial(jit, static_argnames=("architecture", "one"))
def _sums(weights: Any, samples: Samples, architecture: networks.CostMapArchitecture, one: bool) -> dict[str, Array]:
    """`_figures_of`, summed over a batch."""
    maps = jax.vmap(functools.partial(network_maps, local=LOCAL))(samples.cells)
    prediction = networks.apply(architecture, weights, maps, samples.target, samples.heading, samples.features)
    of_maps = jax.vmap(functools.partial(_figures_of, one=one))(prediction, samples.occupied, samples.cost)
    return jax.tree.map(lambda leaf: jnp.sum(leaf, axis=0), of_maps)


def figures_of(sums: dict[str, np.ndarray]) -> dict[str, float]:
    """Figures of the maps of a house from their sums: shares in %, costs in meters, angles in degrees."""
    found = {name: 100 * float(score) for name, score in occupancy_scores(jnp.asarray(sums["confusion"])).items()}
    found = {name: found[name] for name in ("MPA", "mF1", "mIoU")}
    found |= {name: 100 * float(sums[name] / sums["maps"]) for name in ("aAP5", "aAP9", "aAP5 unmasked")}
    found["error m"] = float(sums["error"] / sums["navigable"])
    found["angle"] = float(sums["angle"] / sums["slopes"])
    found |= {
        f"{name} mm": 1000 * float(sums[name] / sums["bendable"])
        for name in ("bends", "true bends", "bends of the error")
    }
    found["hollows per 1000"] = 1000 * float(sums["hollows"] / sums["navigable"])
    return found


@dataclasses.dataclass(frozen=True)
class Options(OutOptions):
    """Compare networks that were trained with several losses, on the same partial maps of validation houses.

    Attributes:
      networks: output folders of `objectnav_train`. Those with the same loss count as seeds of one training; the
        differences are from those with the paper's loss.
      maps: partial maps of each house.
    """

    networks: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FOLDER ...")]
    maps: int = 64


def _maps_of(data: JourneySet, house: int, count: int) -> list[Samples]:
    """Partial maps of the journeys through one house, the same for every network."""
    there = np.flatnonzero(np.asarray(data.house) == house)
    own = {name: getattr(data, name)[there] for name in ("house", "first_seen", "places", "headings", "features")}
    draw = functools.partial(draw_samples, batch_size=_BATCH, symmetries=UPRIGHT, normalize=NORMALIZATIONS["relative"])
    keys = jax.random.split(jax.random.key(house), count // _BATCH)
    return [jit(draw)(key, dataclasses.replace(data, **own)) for key in keys]


def main(options: Options) -> None:
    """Predict; print and write the table."""
    if options.maps < _BATCH or options.maps % _BATCH:
        raise InputError(f"--maps {options.maps}: give a multiple of {_BATCH}")
    digests = {tree_sha256([(folder / "validation.safetensors").read_bytes()]) for folder in options.networks}
    if len(digests) > 1:
        raise InputError("--networks: their validation.safetensors differ; train all with the same data and encoder")
    losses = [read_object(folder / "network.json", "train it again")["loss"] for folder in options.networks]
    if "paper" not in losses:
        raise InputError("--networks: give one that was trained with the paper's loss, to compare with")
    out = output_folder(options, "indoor_losses")
    path = options.networks[0] / "validation.safetensors"
    arrays = read_safetensors(path, "train the network again", at_most=None)
    data = JourneySet(**{name: jnp.asarray(array) for name, array in arrays.items()})
    houses = range(len(data.cells))
    found: dict[str, list[list[dict[str, float]]]] = {}
    samples = [_maps_of(data, house, options.maps) for house in houses]
    for folder, loss in zip(options.networks, losses, strict=True):
        network = load_costs(folder)
        one = loss.endswith(":one_map")
        rows = []
        for batches in samples:
            sums = [_sums(network.weights, batch, network.architecture, one) for batch in batches]
            rows.append(figures_of(jax.tree.map(lambda *leaves: np.sum(leaves, axis=0), *sums)))
        found.setdefault(loss.partition(":")[2] or loss, []).append(rows)
    facts: dict[str, Any] = {"houses": len(houses), "maps": options.maps, "losses": {}}
    columns = list(found["paper"][0][0])
    print(f"{options.maps} maps of each of {len(houses)} houses; means over houses (seed by seed), and differences")
    for loss, runs in found.items():
        values = np.array([[[row[name] for name in columns] for row in rows] for rows in runs])
        paper = np.mean([[[row[name] for name in columns] for row in rows] for rows in found["paper"]], axis=0)
        facts["losses"][loss] = {}
        for place, name in enumerate(columns):
            column = values[:, :, place]
            gain = house_bootstrap(
                column.mean(axis=0) - paper[:, place], list(map(str, houses)), resamples=_RESAMPLES, seed=0
            )
            seeds = column.mean(axis=1).tolist()
            facts["losses"][loss][name] = {"seeds": seeds, "less_paper": gain._asdict()}
            each = " ".join(f"{value:8.2f}" for value in seeds)
            print(f"{loss:16} {name:24} {each}   {gain.mean:+.2f} ({gain.low:+.2f} to {gain.high:+.2f})", flush=True)
    write_json(out / "results.json", facts)
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
