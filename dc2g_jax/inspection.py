"""Figures and recordings of episodes and trainings (extra `all`)."""

from dc2g_jax._src.figures.episode_figures import (
    plot_episode as plot_episode,
    plot_trajectories as plot_trajectories,
)
from dc2g_jax._src.figures.replay import actions_from_letters as actions_from_letters, replay as replay
from dc2g_jax._src.figures.results_figures import plot_extra_steps as plot_extra_steps, plot_results as plot_results
from dc2g_jax._src.figures.training_figures import save_learning_curve as save_learning_curve
from dc2g_jax._src.viewer.recording import record_episode as record_episode
