"""Figures and recordings of episodes and trainings (extra `all`)."""

from dc2g_jax._src.inspection.episode_figures import (
    plot_episode as plot_episode,
    plot_trajectories as plot_trajectories,
)
from dc2g_jax._src.inspection.figures import plot_extra_steps as plot_extra_steps, plot_results as plot_results
from dc2g_jax._src.inspection.recording import record_episode as record_episode
from dc2g_jax._src.inspection.replay import actions_from_letters as actions_from_letters, replay as replay
from dc2g_jax._src.inspection.training_figures import save_learning_curve as save_learning_curve
