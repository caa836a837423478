"""Run one search for an object and choose the moments that its figure shows."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from tqdm import tqdm

from dc2g_jax._src.figures._sheets import spread
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax.indoor.maps.mapping import square, window
from dc2g_jax.indoor.search.agent import Agent, cost_of_pose, weighed
from dc2g_jax.indoor.search.guides import predicted_costs, true_costs
from dc2g_jax.indoor.search.searches import IndoorRobot, IndoorSite, act_on, is_active, look_and_decide, picture
from experiments.support.search_figures import PredictedMap, SearchMoment


def run_search(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> tuple[list[IndoorRobot], IndoorRobot]:
    """Run a search to the end.

    Returns:
      The robot at the beginning of each leg, after it decided and before it acts; and the robot at the end.
    """
    first_part, second_part, begun = jit(look_and_decide), jit(act_on), []
    with tqdm(total=len(robot.track) - 1, desc="searching", unit="step", file=sys.stderr) as progress:
        while is_active(robot):
            begun.append(first_part(robot, site, agent))
            robot = second_part(begun[-1], site, agent)
            progress.update(int(robot.periods) - int(begun[-1].periods))
    return begun, robot


def choose_legs(to_goal: Bool[np.ndarray, " leg"], count: int) -> list[int]:
    """Legs to show in the figure: spread evenly over the search, including the last.

    If the goal reacher takes over after the second to last of these, the leg in which it takes over is shown instead.

    Args:
      to_goal: whether the goal reacher leads, for each leg.
      count: number of legs to show; fewer if the search has fewer legs.
    """
    last = len(to_goal) - 1
    exploring = np.flatnonzero(~to_goal)
    taken_over = int(exploring[-1]) + 1 if exploring.size else 0
    late = last * (count - 2) / (count - 1) < taken_over < last
    return spread(last, count, taken_over if late else None)


@jit
def _sampled_plans(robot: IndoorRobot, agent: Agent) -> tuple[Float[Array, "k h 2"], Bool[Array, ""]]:
    """Paths of the plans that the controller samples for the robot's next period, and whether it follows them."""
    _, key = jax.random.split(robot.key)
    costs = cost_of_pose(robot, agent)
    plan, samples = weighed(key, robot, costs, agent)
    return samples.path.position, jnp.allclose(plan, agent.steering(key, robot, costs, agent), atol=1e-3)


def moment_of(robot: IndoorRobot, agent: Agent, name: str) -> SearchMoment:
    """The moment of a search before a robot acts. `name` is the agent's."""
    paths, used = _sampled_plans(robot, agent)
    plans = np.asarray(paths) if used else np.zeros((0, *paths.shape[1:]), np.float32)
    exploring = "exploring" if used or name == "random" else "looking around"
    leading = "true cost map" if name == "true_cost" else "goal reacher"
    return SearchMoment(
        step=int(robot.periods),
        doing=leading if robot.guidance.to_goal else exploring,
        cells=np.asarray(robot.map.cells),
        origin=np.asarray(robot.map.origin),
        costs=np.asarray(robot.guidance.distance),
        corner=np.asarray(robot.local_middle) - agent.mapping.local // 2,
        plans=plans,
    )


@jit
def prediction_at(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> PredictedMap:
    """What an agent's network predicts for its local map, and the truth there by the agent's true distances."""
    side = agent.mapping.local
    free = square(site.free, robot.local_middle - side // 2, side, False)
    true = true_costs(robot, None, agent).distance
    predicted = predicted_costs(robot, picture(robot, site), agent)
    return PredictedMap(
        cells=window(robot.map, robot.local_middle, side),
        occupied=jnp.isinf(predicted),
        truly_occupied=~free,
        cost=predicted,
        true_cost=true - jnp.min(true),
    )
