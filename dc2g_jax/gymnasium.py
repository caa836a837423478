"""Wrappers of the Gymnasium environment (extra `gym`)."""

from dc2g_jax._src.environments.gymnasium_wrappers import (
    EgocentricObservation as EgocentricObservation,
    EgocentricVectorObservation as EgocentricVectorObservation,
)
