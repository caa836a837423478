"""The paper's Fig. 5: three losses compared on validation pairs throughout training.

`python -m experiments.reproduce_fig5 --out outputs/fig5`. After an interruption, --resume continues it.
"""

import dataclasses
from typing import Any

from dc2g_jax._src.cli.common import check_seed, command_line, digests
from dc2g_jax._src.cli.options import DatasetOptions, TrainingOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.cli.translation import Translation, TranslationOptions, train_translators, translation_data
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.figures.image_figures import plot_training
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.rollouts.devices import mesh_of, platform
from dc2g_jax._src.training.loop import Log
from dc2g_jax._src.training.sweeps import in_turns
from dc2g_jax._src.training.translator import TRANSLATOR_LOSSES


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, TrainingOptions):
    """Reproduce Fig. 5: train with each loss several times and plot validation metrics over training steps.

    Attributes:
      losses: losses to compare.
      seeds: seeds to train each loss with.
      window: number of validations in the moving average of each run.
      training: training of each run.
    """

    losses: tuple[str, ...] = tuple(TRANSLATOR_LOSSES)
    seeds: tuple[int, ...] = (0, 1, 2)
    window: int = 5
    training: Translation = dataclasses.field(default_factory=TranslationOptions)


def main(options: Options) -> None:
    """Train all runs, the seeds of a loss together on an accelerator, then plot them."""
    if not options.losses or not options.seeds or options.window < 1 or options.training.validate_every < 1:
        raise InputError("losses, seeds, window and validate-every: Fig. 5 needs at least one of each")
    for seed in options.seeds:
        check_seed(seed, "seeds")
    if len(set(options.seeds)) < len(options.seeds) or len(set(options.losses)) < len(options.losses):
        raise InputError("losses and seeds: give each once; a run counted twice would look like less spread")
    configs = {loss: options.training.config(loss) for loss in options.losses}
    dataset = open_dataset(options.dataset, cells=None)
    output_folder(options, "reproduce_fig5", free=("minutes_per_checkpoint",), inputs=digests(dataset))
    data = translation_data(dataset, options.training)
    # Runs together are one program. Cores of a CPU are busy with one run.
    at_once = 1 if platform(mesh_of()) == "cpu" else len(options.seeds)
    runs: dict[str, list[dict[int, dict[str, Any]]]] = {}
    for loss, config in configs.items():
        seeds = {f"{loss}-seed{seed}": seed for seed in options.seeds}
        for turn in in_turns(seeds, at_once):
            train_translators(options.out, turn, dataset, data, config, options.training, track=options.track)
        runs[loss] = [Log(options.out).by_step(run) for run in seeds]
    training = options.training
    caption = (
        f"{len(data.train.pair_house)} training and {len(data.validation.pair_house)} validation pairs of "
        f"{dataset.name}; {training.base_filters} filters, {training.size} x {training.size} pixels; "
        f"mean and one standard deviation of {len(options.seeds)} runs, moving average of {options.window}. "
        "Precision and recall of the pixels of all validation pairs together; a run that predicts none near a goal has "
        "no precision, and no part in the mean."
    )
    plot_training(options.out / "fig5", runs, caption, window=options.window)
    facts = {
        "dataset": dataset.name,
        "training": dataclasses.asdict(training),
        "runs": {loss: [list(log.values()) for log in logs] for loss, logs in runs.items()},
    }
    write_json(options.out / "results.json", facts)
    print_files(options.out)


if __name__ == "__main__":
    command_line(Options, main)
