"""The Gymnasium environment `dc2g_jax/FrontDoor-v0`, which this import registers, and its wrappers (extra `gym`)."""

from dc2g_jax._src.environments.gymnasium_wrappers import (
    EgocentricObservation as EgocentricObservation,
    EgocentricVectorObservation as EgocentricVectorObservation,
)
from dc2g_jax._src.environments.registration import register as _register

_register()
