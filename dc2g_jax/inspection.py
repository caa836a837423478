"""Figures and recordings of episodes and trainings (extra `all`)."""

from dc2g_jax._src.figures.costs import (
    COST_COLORS as COST_COLORS,
    cost_image as cost_image,
    score_colors as score_colors,
)
from dc2g_jax._src.figures.episode_figures import (
    MARK_COLOR as MARK_COLOR,
    ROBOT_COLOR as ROBOT_COLOR,
    SUBGOAL_COLOR as SUBGOAL_COLOR,
    goal_marks as goal_marks,
    plot_episode as plot_episode,
    plot_trajectories as plot_trajectories,
)
from dc2g_jax._src.figures.map_figures import plot_map as plot_map
from dc2g_jax._src.figures.replay import (
    actions_from_letters as actions_from_letters,
    replay as replay,
    replay_result as replay_result,
)
from dc2g_jax._src.figures.results_figures import (
    map_image as map_image,
    planner_style as planner_style,
    plot_results as plot_results,
)
from dc2g_jax._src.figures.training_figures import save_learning_curve as save_learning_curve
from dc2g_jax._src.viewer.columns import (
    SO_FAR as SO_FAR,
    first_view as first_view,
    image_style as image_style,
    open_recording as open_recording,
    send as send,
    send_images as send_images,
    send_track as send_track,
)
from dc2g_jax._src.viewer.legend import terrain_context as terrain_context
from dc2g_jax._src.viewer.recording import record_episode as record_episode
