"""Sampling-based model predictive control: IT-MPC (information-theoretic MPPI, Williams et al. 2018).

A plan is a sequence of commands over a horizon. Each call simulates many noisy copies of the plan with the model of the
vehicle that also drives the robot, evaluates them with a cost function of the pose, and moves the plan to their mean
weighted by cost (equations 5 and 6 of the paper on dense cost maps for object goals). All functions take one robot; use
`jax.vmap` for batches.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Key

from dc2g_jax.robot.driving.vehicle import VehicleLimits, VehicleState, drive

#: The cost of a pose: position (x and y, meters) and yaw (radians) -> a finite number.
CostOfPose = Callable[[Float[Array, "2"], Float[Array, ""]], Float[Array, ""]]


@struct.dataclass
class MPPISettings:
    """Settings of the controller. Static under `jit`.

    Attributes:
      limits: limits of the vehicle.
      horizon: number of commands in a plan, H.
      samples: number of noisy copies of the plan per call, K.
      noise: standard deviation of the noise on speed (meters per second) and turn rate (radians per second), sigma.
      correlation: correlation of the noise of successive commands, at least 0 and below 1. The paper's noise is
        independent (0). Sampled headings then hardly deviate from the plan, as turns to the left and right cancel.
      temperature: difference in summed cost that makes a copy e times less likely, lambda.
      effort: the control-effort matrix Q on (speed, turn rate), by rows: symmetric, without negative eigenvalues.
    """

    limits: VehicleLimits = struct.field(pytree_node=False, default=VehicleLimits())
    horizon: int = struct.field(pytree_node=False, default=50)
    samples: int = struct.field(pytree_node=False, default=512)
    noise: tuple[float, float] = struct.field(pytree_node=False, default=(0.35, 0.35))
    correlation: float = struct.field(pytree_node=False, default=0.9)
    temperature: float = struct.field(pytree_node=False, default=1.0)
    effort: tuple[tuple[float, float], tuple[float, float]] = struct.field(
        pytree_node=False, default=((0.01, 0.0), (0.0, 0.01))
    )


@struct.dataclass
class SampledPlans:
    """The sampled copies of a plan.

    Attributes:
      path: state of the vehicle after each command.
      costs: cost of each copy, summed over the horizon, S.
      weights: weight of each copy, w; they sum to one.
    """

    path: VehicleState
    costs: Float[Array, "k"]
    weights: Float[Array, "k"]


def plan_controls(
    key: Key[Array, ""],
    controls: Float[Array, "h 2"],
    state: VehicleState,
    cost_of_pose: CostOfPose,
    settings: MPPISettings,
    candidate: Float[Array, "h 2"] | None = None,
) -> tuple[Float[Array, "h 2"], SampledPlans]:
    """Improve a plan by one step of IT-MPC. Apply its first command, then `shift` it for the next call.

    Args:
      key: random key of the noise.
      controls: current plan, speed and turn rate of each command.
      state: current state of the vehicle.
      cost_of_pose: cost of a pose.
      settings: settings of the controller.
      candidate: a plan that replaces one of the noisy copies.

    Returns:
      The new plan, and its samples.
    """
    noise = sampled_noise(key, settings)
    if candidate is not None:
        noise = noise.at[0].set(candidate - controls)
    return improved(controls, noise, state, cost_of_pose, settings)


def shifted_controls(controls: Float[Array, "h 2"]) -> Float[Array, "h 2"]:
    """The plan without its first command, which has been executed; the last command is repeated."""
    return jnp.concatenate([controls[1:], controls[-1:]])


def sampled_noise(key: Key[Array, ""], settings: MPPISettings) -> Float[Array, "k h 2"]:
    """Normally distributed noise on the commands of every copy, with the same standard deviation at every time.

    The noise is a first-order autoregressive process: commands n apart have correlation `correlation` ** n.
    """
    time = np.arange(settings.horizon)
    mixing = np.linalg.cholesky(settings.correlation ** np.abs(time[:, None] - time).astype(float))
    white = jax.random.normal(key, (settings.samples, 2, settings.horizon))
    noise = (white @ jnp.asarray(mixing.T, jnp.float32)).swapaxes(1, 2)
    return noise * jnp.array(settings.noise, jnp.float32)


def improved(
    controls: Float[Array, "h 2"],
    noise: Float[Array, "k h 2"],
    state: VehicleState,
    cost_of_pose: CostOfPose,
    settings: MPPISettings,
) -> tuple[Float[Array, "h 2"], SampledPlans]:
    """The plan moved by the weighted mean of its noise (equation 6).

    The noise is first clipped by the vehicle's limits on velocities and accelerations in every copy, so the new plan
    respects them too. Where the limits are inactive this is exactly the equation.
    """
    path = _driven(state, controls + noise, settings)
    commands = jnp.stack([path.speed, path.turn_rate], axis=-1)
    effort = jnp.einsum("khi,ij,khj->k", commands, jnp.array(settings.effort, jnp.float32), commands)
    costs = jax.vmap(jax.vmap(cost_of_pose))(path.position, path.yaw).sum(axis=1) + effort
    # exp(-(S - min S) / lambda) / eta: softmax subtracts the largest exponent, that of the least cost, first.
    weights = jax.nn.softmax(-costs / settings.temperature)
    new = controls + jnp.einsum("k,khi->hi", weights, commands - controls)
    return new, SampledPlans(path=path, costs=costs, weights=weights)


def _driven(state: VehicleState, commands: Float[Array, "k h 2"], settings: MPPISettings) -> VehicleState:
    """The vehicle after each command of each copy, `[k h ...]`."""

    def step(state: VehicleState, command: Float[Array, "2"]) -> tuple[VehicleState, VehicleState]:
        state = drive(state, command, settings.limits)
        return state, state

    return jax.vmap(lambda sequence: jax.lax.scan(step, state, sequence)[1])(commands)
