"""Sampling-based model predictive control: IT-MPC (information-theoretic MPPI, Williams et al. 2018).

A plan is a sequence of commands over a horizon. Each call drives many noisy copies of it, in the model of the vehicle
that also drives the robot, prices them with any function of a pose, and moves the plan to their mean, weighted by price
(equations 5 and 6 of the paper on dense cost maps for object goals). All functions are for one robot; `jax.vmap` makes
them take many.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Key

from dc2g_jax.errors import InputError
from dc2g_jax.vehicles.vehicle import VehicleLimits, VehicleState, drive

#: What it costs to be at a position (x and y, meters) facing a yaw (radians): a finite number.
CostOfPose = Callable[[Float[Array, "2"], Float[Array, ""]], Float[Array, ""]]


def _is_count(number: float) -> bool:
    """Is it a whole number of at least 1?"""
    return isinstance(number, int | np.integer) and number >= 1


@struct.dataclass
class MPPISettings:
    """How the controller samples and what it weighs. Known when programs are compiled.

    Attributes:
      limits: of the vehicle.
      horizon: commands in a plan, H.
      samples: noisy copies of the plan a call drives, K.
      noise: standard deviation of the noise on speed (meters per second) and turn rate (radians per second), sigma.
      correlation: of the noise of a command with that of the next, at least 0 and below 1. The paper's noise is
        independent, 0: then sampled headings hardly leave the plan's, as turns to the left and right cancel.
      temperature: difference in cost that makes a copy e times less likely, lambda, in units of the summed cost.
      effort: the control-effort matrix Q on (speed, turn rate), by rows: symmetric, no negative eigenvalue.

    Raises:
      InputError: a value out of its range.
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

    def __post_init__(self) -> None:
        effort, noise = np.array(self.effort, float), np.array(self.noise, float)
        symmetric = effort.shape == (2, 2) and np.all(np.isfinite(effort)) and np.array_equal(effort, effort.T)
        for name, sound, remedy in (
            ("horizon", _is_count(self.horizon), "give a whole number from 1 on"),
            ("samples", _is_count(self.samples), "give a whole number from 1 on"),
            ("noise", noise.shape == (2,) and np.all((noise >= 0) & (noise < np.inf)), "give two numbers from 0 on"),
            ("correlation", 0 <= self.correlation < 1, "give a number from 0 to below 1"),
            ("temperature", 0 < self.temperature < np.inf, "give a number above 0"),
            (
                "effort",
                symmetric and np.linalg.eigvalsh(effort)[0] >= 0,
                "give a symmetric 2x2 matrix without negative eigenvalues",
            ),
        ):
            if not sound:
                raise InputError(f"{name} of the controller is {getattr(self, name)}; {remedy}")


@struct.dataclass
class Samples:
    """The copies of a plan that a call drove.

    Attributes:
      path: the vehicle after each command.
      commands: speeds and turn rates that the vehicle could make of the noisy ones.
      costs: of each copy, summed over the horizon, S.
      weights: of each copy, w; they sum to one.
    """

    path: VehicleState
    commands: Float[Array, "k h 2"]
    costs: Float[Array, "k"]
    weights: Float[Array, "k"]


def standing_still(settings: MPPISettings) -> Float[Array, "h 2"]:
    """The plan to begin with."""
    return jnp.zeros((settings.horizon, 2), jnp.float32)


def plan(
    key: Key[Array, ""],
    controls: Float[Array, "h 2"],
    state: VehicleState,
    cost_of_pose: CostOfPose,
    settings: MPPISettings,
) -> tuple[Float[Array, "h 2"], Samples]:
    """A better plan: one step of IT-MPC. Apply its first command, then `shift` it for the next call.

    Args:
      key: for the noise.
      controls: plan so far, speed and turn rate of each command.
      state: of the vehicle now.
      cost_of_pose: what a pose costs.
      settings: of the controller.

    Returns:
      The new plan, and the samples it was made from.
    """
    return improved(controls, sampled_noise(key, settings), state, cost_of_pose, settings)


def shift(controls: Float[Array, "h 2"]) -> Float[Array, "h 2"]:
    """The plan without its first command, which has been driven; its last one is repeated."""
    return jnp.concatenate([controls[1:], controls[-1:]])


def sampled_noise(key: Key[Array, ""], settings: MPPISettings) -> Float[Array, "k h 2"]:
    """Normal noise on the commands of every copy, of the same deviation at every time.

    Commands n apart correlate by `correlation` to the n-th power, as those of a first-order autoregressive process.
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
) -> tuple[Float[Array, "h 2"], Samples]:
    """The plan moved by the weighted mean of its noise (equation 6).

    The noise that counts is what the vehicle makes of it: its limits on speeds and on their changes cut it off in every
    copy, and so the new plan keeps to them too. Where they do not bind this is the equation as it stands.

    Args:
      controls: plan so far.
      noise: on the commands of each copy.
      state: of the vehicle now.
      cost_of_pose: what a pose costs.
      settings: of the controller.
    """
    path = _driven(state, controls + noise, settings)
    commands = jnp.stack([path.speed, path.turn_rate], axis=-1)
    effort = jnp.einsum("khi,ij,khj->k", commands, jnp.array(settings.effort, jnp.float32), commands)
    costs = jax.vmap(jax.vmap(cost_of_pose))(path.position, path.yaw).sum(axis=1) + effort
    # exp(-(S - min S) / lambda) / eta: softmax takes the largest exponent, the least cost, off first.
    weights = jax.nn.softmax(-costs / settings.temperature)
    new = controls + jnp.einsum("k,khi->hi", weights, commands - controls)
    return new, Samples(path=path, commands=commands, costs=costs, weights=weights)


def _driven(state: VehicleState, commands: Float[Array, "k h 2"], settings: MPPISettings) -> VehicleState:
    """The vehicle after each command of each copy, `[k h ...]`."""

    def step(state: VehicleState, command: Float[Array, "2"]) -> tuple[VehicleState, VehicleState]:
        state = drive(state, command, settings.limits)
        return state, state

    return jax.vmap(lambda sequence: jax.lax.scan(step, state, sequence)[1])(commands)
