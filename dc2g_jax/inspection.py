"""Figures and recordings of episodes and trainings (extra `all`)."""

from dc2g_jax._src.figures._sheets import DPI as DPI, FONT as FONT, cell_rim as cell_rim, spread as spread
from dc2g_jax._src.figures._video import Picture as Picture
from dc2g_jax._src.figures.animation import write_animation as write_animation
from dc2g_jax._src.figures.costs import (
    BLOCKED_COLOR as BLOCKED_COLOR,
    COST_COLORS as COST_COLORS,
    UNSEEN_COLOR as UNSEEN_COLOR,
    cost_image as cost_image,
    end_of_colors as end_of_colors,
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
    first_carry as first_carry,
    replay as replay,
)
from dc2g_jax._src.figures.results_figures import (
    PAGE_WIDTH as PAGE_WIDTH,
    class_patch as class_patch,
    legend_patch as legend_patch,
    map_image as map_image,
    plain_axes as plain_axes,
    planner_style as planner_style,
    plot_results as plot_results,
    present_classes as present_classes,
    save_figure as save_figure,
)
from dc2g_jax._src.figures.training_figures import save_learning_curve as save_learning_curve
from dc2g_jax._src.viewer import legend as legend
from dc2g_jax._src.viewer.columns import (
    SO_FAR as SO_FAR,
    first_view as first_view,
    image_style as image_style,
    open_recording as open_recording,
    send as send,
    send_curve as send_curve,
    send_images as send_images,
    send_track as send_track,
)
from dc2g_jax._src.viewer.recording import record_episode as record_episode
