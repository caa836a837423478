"""Library functions one would reach for in place of a single kernel of this package.

Each is imported when it is called; an `ImportError` says what is missing.
"""

import cv2
import numpy as np
import numpy.typing as npt

Cells = npt.NDArray[np.bool_]
CostGrid = npt.NDArray[np.float64]


def reachable_scipy(free: Cells, x: int, y: int) -> Cells:
    """Free cells 4-connected to (x, y), by labeling all components: the answer of `bitboard.flood`.

    Args:
      free: cells a robot may use, bool [h w].
      x: column of a free cell.
      y: its row.
    """
    from scipy import ndimage

    labels, _ = ndimage.label(free)
    return labels == labels[y, x]


def cost_to_go_skimage(traversable: Cells, goals: Cells) -> CostGrid:
    """Least travel cost to the nearest goal cell, 8-connected: the answer of `search.cost_to_go`.

    Args:
      traversable: cells a robot may drive on, bool [h w]; the goal cells are among them.
      goals: goal cells, bool [h w], one at least.

    Returns:
      Costs in cells, infinity where there is no path.
    """
    from skimage.graph import MCP_Geometric

    costs = np.where(traversable, 1.0, -1.0)  # negative: not passable
    return MCP_Geometric(costs).find_costs(np.argwhere(goals))[0]


def path_skimage(traversable: Cells, x: int, y: int, goals: Cells) -> int:
    """Cells of a shortest 4-connected way from (x, y) to the nearest goal cell, turns not counted; -1 without one.

    Less than `search.first_action` gives: headings, the cost of turning and the rule between equal plans are missing.

    Args:
      traversable: cells a robot may drive on, bool [h w].
      x: column of the robot.
      y: its row.
      goals: goal cells, bool [h w].
    """
    from skimage.graph import MCP

    search = MCP(np.where(traversable, 1.0, -1.0), fully_connected=False)
    costs, _ = search.find_costs([(y, x)], find_all_ends=True)
    costs = np.where(goals, costs, np.inf)
    nearest = np.unravel_index(np.argmin(costs), costs.shape)
    return len(search.traceback(nearest)) - 1 if np.isfinite(costs[nearest]) else -1


def distance_opencv(goals: Cells) -> npt.NDArray[np.float32]:
    """Straight-line distance to the nearest goal cell. It ignores obstacles: no cost-to-go, but a floor for one's time.

    Args:
      goals: goal cells, bool [h w].
    """
    return np.asarray(cv2.distanceTransform((~goals).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5), np.float32)
