"""The paper's Fig. 4: predictions of a network on unseen maps, whole and partial.

`python -m experiments.reproduce_fig4 --network outputs/fig5/runs/l1+gan-seed0/network`
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import DatasetOptions, NetworkOptions, OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.readers.houses import House, open_dataset
from experiments.translator.drawn_masks import VARIANTS, drawn_masks
from experiments.translator.evaluation import compare, map_for
from experiments.translator.figures import Example, plot_translations
from experiments.translator.pairs import MASK_SEEDS, houses_with_door


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions, OutOptions):
    """Reproduce Fig. 4: input, prediction and truth on whole and partial maps of test houses.

    The network may be of either kind.

    Attributes:
      rows: rows of the figure; its houses are spread evenly over the test houses.
      seed: seed of the observation masks.
    """

    rows: int = 5
    seed: int = MASK_SEEDS["test"]


def example(network: Estimator, house: House, seen: np.ndarray) -> Example:
    """Input, prediction and truth for a house with the observed cells `seen`."""
    terrain, cost = map_for(network, house.terrain)
    _, *pictures = compare(network, jnp.asarray(terrain), jnp.asarray(cost), jnp.asarray(seen))
    return Example(house.name, *(np.asarray(picture) for picture in pictures))


def main(options: Options) -> None:
    """Choose houses and masks, predict, draw."""
    require_positive(options, "rows")
    dataset = open_dataset(options.dataset, cells=None)
    houses = houses_with_door(dataset, "test")
    network = load_network(options.network)
    out = output_folder(options, "reproduce_fig4")
    chosen = [houses[place] for place in np.linspace(0, len(houses) - 1, 2 * options.rows).round().astype(int)]
    everything = np.ones((256, 256), bool)
    # One mask per row, each from another drawing and another variant.
    masks = drawn_masks((VARIANTS + 1) * options.rows, 256, seed=options.seed)[:: VARIANTS + 1]
    full = [example(network, house, everything) for house in chosen[::2]]
    partial = [example(network, house, mask) for house, mask in zip(chosen[1::2], masks, strict=True)]
    name = "the network that comes with the package" if options.network is None else str(options.network)
    plot_translations(out / "fig4", full, partial, f"Network: {name}. Test houses of {dataset.name}.")
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
