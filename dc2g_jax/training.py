"""Training of networks that predict the cost-to-go, and of the score by which the planner chooses."""

from dc2g_jax._src.training.cost_to_go import TrainingConfig as TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig as DataConfig, kept_arrays as kept_arrays
from dc2g_jax._src.training.loop import Log as Log, Pauses as Pauses, Recording as Recording, Task as Task, fit as fit
from dc2g_jax._src.training.losses import LOSSES as LOSSES, Loss as Loss, map_loss as map_loss, named_loss as named_loss
from dc2g_jax._src.training.masks import moments_along as moments_along
from dc2g_jax._src.training.pairs import TrainingSet as TrainingSet, make_pair as make_pair, turned as turned
from dc2g_jax._src.training.score import ScoreConfig as ScoreConfig
from dc2g_jax._src.training.step import (
    Supervised as Supervised,
    TrainingState as TrainingState,
    state_of as state_of,
    supervised_step as supervised_step,
)
from dc2g_jax._src.training.sweeps import Sweep as Sweep, sweep as sweep
from dc2g_jax._src.training.train import train as train
