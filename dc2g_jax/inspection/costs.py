"""Costs-to-go in the figure and the animation of an episode: what is exact, where the colors end, and the colors."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from dc2g_jax.datasets.houses import House
from dc2g_jax.estimation.estimators import world_cost_to_go
from dc2g_jax.grid.terrain import TRAVERSABLE
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.inspection.replay import Frames
from dc2g_jax.programs import jit

#: Colors of the cost-to-go, from the goal on; the ends differ in gray.
COST_COLORS = "viridis_r"

#: Where there is no cost-to-go to show: not observed, and observed but not traversable.
UNSEEN_COLOR, BLOCKED_COLOR = "#ffffff", "#ececf1"

_solve = jit(world_cost_to_go)


def exact_cost_to_go(house: House) -> Float[np.ndarray, "h w"]:
    """Exact cost-to-go of a house in cells; infinity where a robot cannot drive or cannot reach a goal."""
    return np.asarray(_solve(world_from_terrain(house.terrain)))


def highest_cost(house: House, frames_by_planner: Mapping[str, Frames], exact: Float[np.ndarray, "h w"]) -> float:
    """The cost in cells at the end of the colors: nearly all that is shown of what robots had observed lies below.

    Args:
      house: the house.
      frames_by_planner: planner name -> its replayed episode.
      exact: the house's exact cost-to-go.
    """
    shown = []
    for frames in frames_by_planner.values():
        if frames.cost_to_go is not None and frames.in_cells:
            ground = frames.seen[-1] & TRAVERSABLE[house.terrain] & np.isfinite(exact)
            shown += [exact[ground], frames.cost_to_go[-1][ground], frames.cost_to_go[0][ground & frames.seen[0]]]
    costs = np.concatenate(shown) if shown else np.zeros(0)
    return max(float(np.percentile(costs, 99)), 1.0) if costs.size else 1.0


def cost_shares(frames: Frames, high: float) -> Float[np.ndarray, "t h w"]:
    """Predicted costs in parts of the one at the end of the colors; those that are not in cells are such parts."""
    assert frames.cost_to_go is not None
    return frames.cost_to_go / (high if frames.in_cells else 1.0)


def cost_image(
    share: Float[np.ndarray, "h w"], shown: Bool[np.ndarray, "h w"], blocked: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """Colors of costs, RGB from 0 to 1.

    Args:
      share: costs in parts of the one at the end of the colors.
      shown: where a cost is shown.
      blocked: what is known not to be traversable; the rest has not been observed.
    """
    colors = colormaps[COST_COLORS](np.clip(np.where(shown, share, 0), 0, 1))[..., :3]
    image = np.where(shown[..., None], colors, np.array(to_rgb(UNSEEN_COLOR)))
    return np.where(blocked[..., None], np.array(to_rgb(BLOCKED_COLOR)), image)
