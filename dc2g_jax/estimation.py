"""Estimators of the cost-to-go, networks and their files."""

from dc2g_jax._src.estimation.compact_unet import Architecture as Architecture, CompactUNet as CompactUNet
from dc2g_jax._src.estimation.estimators import (
    Estimator as Estimator,
    ExactCostToGo as ExactCostToGo,
    NetworkCostToGo as NetworkCostToGo,
    world_cost_to_go as world_cost_to_go,
)
from dc2g_jax._src.estimation.hub import load_network as load_network, push as push
from dc2g_jax._src.estimation.weights import (
    fresh_weights as fresh_weights,
    read_safetensors as read_safetensors,
    with_weights as with_weights,
    write_safetensors as write_safetensors,
)
from dc2g_jax._src.files.resources import resource as resource
