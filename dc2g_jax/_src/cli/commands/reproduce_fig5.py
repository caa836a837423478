"""Train the paper's image-to-image translator; Fig. 5: three losses compared on validation pairs throughout training.

`python -m experiments.reproduce_fig5 --out outputs/fig5`. After an interruption, --resume continues it.
"""

import dataclasses
import itertools

from dc2g_jax._src.cli.common import check_seed, command_line, digests
from dc2g_jax._src.cli.options import DatasetOptions, TrainingOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.cli.translation import (
    Translation,
    TranslationOptions,
    require_steps,
    train_translators,
    translation_data,
)
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.figures.image_figures import plot_training
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.rollouts.devices import mesh_of, platform
from dc2g_jax._src.training.loop import Log
from dc2g_jax._src.training.sweeps import in_turns
from dc2g_jax._src.training.tracking import run_folder
from dc2g_jax._src.training.translator import TRANSLATOR_LOSSES


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, TrainingOptions):
    """Reproduce Fig. 5: train the image-to-image translator (Algorithm 1, section III-B) with each loss several times.

    The networks are in `runs/LOSS-seedSEED/network`. Validation metrics are plotted over training steps. A resumed run
    may be given more `--steps`.

    Attributes:
      losses: losses to compare: L1 loss, adversarial loss, and their sum weighted 100 to 1.
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
    runs = {loss: {f"{loss}-seed{seed}": seed for seed in options.seeds} for loss in options.losses}
    for run in itertools.chain(*runs.values()):
        require_steps(options.training.steps, run_folder(options.out, run))
    output_folder(options, "reproduce_fig5", free=("minutes_per_checkpoint", "steps"), inputs=digests(dataset))
    data = translation_data(dataset, options.training)
    print(
        f"Training on {len(data.train.pair_house)} pairs of {len(data.train.terrain)} houses of {dataset.name}, "
        f"validating on {len(data.validation.pair_house)}"
    )
    # Runs together are one program. Cores of a CPU are busy with one run.
    at_once = 1 if platform(mesh_of()) == "cpu" else len(options.seeds)
    for loss, seeds in runs.items():
        for turn in in_turns(seeds, at_once):
            train_translators(options.out, turn, dataset, data, configs[loss], options.training, track=options.track)
    logs = {loss: [Log(options.out).by_step(run) for run in seeds] for loss, seeds in runs.items()}
    training = options.training
    caption = (
        f"{len(data.train.pair_house)} training and {len(data.validation.pair_house)} validation pairs of "
        f"{dataset.name}; {training.base_filters} filters, {training.size} x {training.size} pixels; "
        f"mean and one standard deviation of {len(options.seeds)} runs, moving average of {options.window}. "
        "Precision and recall of the pixels of all validation pairs together; a run that predicts none near a goal has "
        "no precision, and no part in the mean."
    )
    plot_training(options.out / "fig5", logs, caption, window=options.window)
    facts = {
        "dataset": dataset.name,
        "training": dataclasses.asdict(training),
        "runs": {loss: [list(log.values()) for log in own] for loss, own in logs.items()},
    }
    write_json(options.out / "results.json", facts)
    print_files(options.out)


if __name__ == "__main__":
    command_line(Options, main)
