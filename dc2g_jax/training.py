"""Training of networks that predict the cost-to-go."""

from dc2g_jax._src.training.cost_to_go import TrainingConfig as TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig as DataConfig
from dc2g_jax._src.training.loop import Pauses as Pauses
from dc2g_jax._src.training.losses import map_loss as map_loss, named_loss as named_loss
from dc2g_jax._src.training.masks import moments_along as moments_along
from dc2g_jax._src.training.pairs import TrainingSet as TrainingSet, make_pair as make_pair
from dc2g_jax._src.training.train import train as train
