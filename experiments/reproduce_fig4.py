"""The paper's Fig. 4: what a network predicts on maps it has not seen, whole and partial.

`python -m experiments.reproduce_fig4 --network checkpoints/translator/network`
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from dc2g_jax.cli.common import DatasetOption, NetworkOption, OutOption, command_line
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.datasets.drawn_masks import VARIANTS, drawn_masks
from dc2g_jax.datasets.houses import House, open_dataset
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import load_network
from dc2g_jax.estimation.estimators import Estimator
from dc2g_jax.inspection.image_figures import Example, plot_translations
from dc2g_jax.training.image_data import MASK_SEEDS
from dc2g_jax.training.image_evaluation import compare, map_for
from dc2g_jax.training.image_pairs import houses_with_door


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Reproduce Fig. 4: input, prediction and truth on whole and partial maps of test houses.

    Attributes:
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      network: folder of a trained network, of either kind; the shipped one where not given.
      rows: houses shown, spread evenly over the test houses.
      seed: of the observation masks.
      out: folder to write to; a new one below outputs/ where not given.
    """

    dataset: DatasetOption = None
    network: NetworkOption = None
    rows: int = 5
    seed: int = MASK_SEEDS["test"]
    out: OutOption = None


def example(network: Estimator, house: House, seen: np.ndarray) -> Example:
    """What a network makes of a house of which this much is observed."""
    terrain, cost = map_for(network, house.terrain)
    _, *pictures = compare(network, jnp.asarray(terrain), jnp.asarray(cost), jnp.asarray(seen))
    return Example(house.name, *(np.asarray(picture) for picture in pictures))


def main(options: Options) -> None:
    """Choose houses and masks, ask the network, draw."""
    if options.rows < 1:
        raise InputError(f"rows: {options.rows} houses make no figure; ask for at least 1")
    dataset = open_dataset(options.dataset, cells=None)
    houses = houses_with_door(dataset, "test")
    network = load_network(options.network)
    out = output_folder(options, "reproduce_fig4")
    chosen = [houses[place] for place in np.linspace(0, len(houses) - 1, 2 * options.rows).round().astype(int)]
    everything = np.ones((256, 256), bool)
    # One mask a row, each of another drawing and in another variant.
    masks = drawn_masks((VARIANTS + 1) * options.rows, 256, seed=options.seed)[:: VARIANTS + 1]
    full = [example(network, house, everything) for house in chosen[::2]]
    partial = [example(network, house, mask) for house, mask in zip(chosen[1::2], masks, strict=True)]
    name = "the network that comes with the package" if options.network is None else str(options.network)
    files = plot_translations(out / "fig4", full, partial, f"Network: {name}. Test houses of {dataset.name}.")
    print(f"Written to {out}: {', '.join(path.name for path in files)}")


if __name__ == "__main__":
    command_line(Options, main)
