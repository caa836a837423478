"""Estimators of the cost-to-go, networks and their files."""

from dc2g_jax._src.estimation.checkpoints import (
    CARD as CARD,
    Kind as Kind,
    TrainingCheckpoints as TrainingCheckpoints,
    read_network as read_network,
    write_network as write_network,
)
from dc2g_jax._src.estimation.compact_unet import (
    Architecture as Architecture,
    CompactUNet as CompactUNet,
    Down as Down,
    Residual as Residual,
    Up as Up,
    patches as patches,
    unpatched as unpatched,
)
from dc2g_jax._src.estimation.estimators import (
    Ensemble as Ensemble,
    Estimator as Estimator,
    ExactCostToGo as ExactCostToGo,
    NetworkCostToGo as NetworkCostToGo,
    answers_in_cells as answers_in_cells,
    world_cost_to_go as world_cost_to_go,
)
from dc2g_jax._src.estimation.hub import load_network as load_network, local_folder as local_folder, push as push
from dc2g_jax._src.estimation.weights import (
    fresh_weights as fresh_weights,
    read_safetensors as read_safetensors,
    read_weights as read_weights,
    shapes_of_weights as shapes_of_weights,
    with_weights as with_weights,
    write_safetensors as write_safetensors,
)
from dc2g_jax._src.files.resources import resource as resource
