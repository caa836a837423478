"""Rollouts: many episodes at once, and what they give."""

from dc2g_jax._src.rollouts.checks import check_estimator as check_estimator, check_planner as check_planner
from dc2g_jax._src.rollouts.evaluation import Runner as Runner, episodes_from as episodes_from, evaluate as evaluate
from dc2g_jax._src.rollouts.results import (
    EpisodeResult as EpisodeResult,
    Results as Results,
    action_letters as action_letters,
)
from dc2g_jax._src.rollouts.rollout import rollout as rollout
from dc2g_jax._src.rollouts.statistics import Mean as Mean, house_bootstrap as house_bootstrap
from dc2g_jax._src.runtime.devices import use_cores as use_cores
