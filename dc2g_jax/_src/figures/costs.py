"""Costs-to-go in figures and animations of episodes: exact costs, range of the color scale, and colors."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.figures.replay import Frames
from dc2g_jax._src.grid.terrain import TRAVERSABLE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.runtime.programs import jit

#: Color map of the cost-to-go, starting at the goal; its ends differ in grayscale.
COST_COLORS = "viridis_r"

#: Colors of cells without cost-to-go: not observed, and observed but not traversable.
UNSEEN_COLOR, BLOCKED_COLOR = "#ffffff", "#ececf1"

_solve = jit(world_cost_to_go)


def exact_cost_to_go(house: House) -> Float[np.ndarray, "h w"]:
    """Exact cost-to-go of a house in cells; infinity where a robot cannot drive or cannot reach a goal."""
    return np.asarray(_solve(World.from_terrain(house.terrain)))


def end_of_colors(costs: Sequence[Float[np.ndarray, "..."]]) -> float:
    """The cost at the end of the colors, at least 1: 99 % of all these costs that are finite are lower."""
    together = np.concatenate(costs) if costs else np.zeros(0)
    together = together[np.isfinite(together)]
    return max(float(np.percentile(together, 99)), 1.0) if together.size else 1.0


def highest_cost(house: House, frames_by_planner: Mapping[str, Frames], exact: Float[np.ndarray, "h w"]) -> float:
    """The cost at the end of the colors, in cells: nearly all costs of observed cells are lower."""
    shown = []
    for frames in frames_by_planner.values():
        if frames.cost_to_go is not None and frames.in_cells:
            ground = frames.seen[-1] & TRAVERSABLE[house.terrain]
            if frames.to_goal[0] >= 0:
                ground &= np.isfinite(exact)
            shown += [exact[ground], frames.cost_to_go[-1][ground], frames.cost_to_go[0][ground & frames.seen[0]]]
    return end_of_colors(shown)


def cost_shares(frames: Frames, high: float) -> Float[np.ndarray, "t h w"]:
    """Predicted costs relative to the cost at the end of the colors; costs that are not in cells are so already."""
    assert frames.cost_to_go is not None
    return frames.cost_to_go / (high if frames.in_cells else 1.0)


def predicts(costs: Float[np.ndarray, "*t h w"]) -> Bool[np.ndarray, "*t"]:
    """Whether costs predict anything. Costs of 0 everywhere, as a network's on a map without classes, do not."""
    return np.asarray(np.any(costs, axis=(-2, -1)))


def cost_image(
    share: Float[np.ndarray, "h w"], shown: Bool[np.ndarray, "h w"], blocked: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """Colors of costs, RGB from 0 to 1. Costs without a prediction are not shown, see `predicts`.

    Args:
      share: costs relative to the cost at the end of the colors.
      shown: cells whose cost is shown.
      blocked: cells known not to be traversable; the remaining cells have not been observed.
    """
    shown = shown & predicts(share)
    colors = colormaps[COST_COLORS](np.clip(np.where(shown, share, 0), 0, 1))[..., :3]
    image = np.where(shown[..., None], colors, np.array(to_rgb(UNSEEN_COLOR)))
    return np.where(blocked[..., None], np.array(to_rgb(BLOCKED_COLOR)), image)


def score_colors(rank: Float[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Colors of candidates: white for the lowest score of a step (0), over red, to black for the highest (1)."""
    return map_colors("hot_r", rank)


def map_colors(colormap: str, values: Float[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """RGB colors of values from 0 to 1."""
    return (255 * colormaps[colormap](np.clip(values, 0, 1))[:, :3]).astype(np.uint8)
