"""Searches for objects on a real robot: each call takes pose, speeds and camera frame, and returns a command.

There is no simulator, no house and no batch. Functions and random numbers are those of the simulated robots, so equal
frames lead to equal commands.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.indoor.maps.camera import VIEW_SIZE, camera_pose
from dc2g_jax.indoor.maps.classes import TARGETS
from dc2g_jax.indoor.search.agent import DECLARED, Agent, Searcher, arrives, begin, cost_at, look, steer
from dc2g_jax.indoor.search.guides import agent_with
from dc2g_jax.robot import (
    CONTROL_PERIOD,
    DRIVING,
    CameraPose,
    Frame,
    Intrinsics,
    VehicleState,
    check_shapes,
    reachable_command,
)
from dc2g_jax.runtime import InputError, check_name, jit, keep_compiled_programs, short

#: Agents that a robot can be. The others of `search.guides.AgentName` know the house or drive at random.
ONLINE_AGENTS = ("promising", "predicted", "frontier")


class SearchDecision(NamedTuple):
    """A decision of an `OnlineSearcher`.

    Attributes:
      speed: forward speed to drive at for the next control period, meters per second.
      turn_rate: turn rate, counter-clockwise, radians per second.
      mode: `explore`, `to_goal` once a path to an object is known, or `arrived`, with a command to stand still.
      cost: the guide's cost at the robot, infinite if it knows none there. In mode `to_goal`, meters to drive.
      why: the reason, in one sentence.
    """

    speed: float
    turn_rate: float
    mode: str
    cost: float
    why: str


_look = jit(look)


@jit
def _begin(seed: Int[Array, ""], vehicle: VehicleState, agent: Agent) -> Searcher:
    return begin(jax.random.key(seed), vehicle, jnp.int32(-1), agent)


@jit
def _move(robot: Searcher, vehicle: VehicleState, target: Int[Array, ""], agent: Agent) -> Searcher:
    """The robot where it is now, and whether it has arrived there by its last costs."""
    arrived = (robot.target == target) & arrives(robot, vehicle.position, agent)
    status = jnp.where(arrived, DECLARED, DRIVING).astype(jnp.int32)
    return dataclasses.replace(robot, vehicle=vehicle, target=target, status=status)


@jit
def _steer(robot: Searcher, agent: Agent) -> tuple[Searcher, tuple[Float[Array, "2"], Array, Array, Array]]:
    """The robot one period later; its command, whether it has arrived, whether it drives to an object, and the cost."""
    arrived, cost = robot.status == DECLARED, cost_at(robot, robot.vehicle.position, agent)
    robot, command = steer(robot, agent)
    command = reachable_command(robot.vehicle, jnp.where(arrived, 0, command), agent.controller.limits, CONTROL_PERIOD)
    return robot, (command, arrived, robot.guidance.to_goal, cost)


class OnlineSearcher:
    """Searches for an object with one robot, from its own camera frames, one call every control period (0.1 s).

    ```
    searcher = OnlineSearcher("promising")
    memory = searcher.init((x, y, yaw))
    decision, memory = searcher.decide(memory, "bed", (x, y, yaw), (speed, turn_rate), frame, image)
    ```

    All poses are in one frame of reference, that of the robot's localization: meters, x and y on the floor, z up, yaw
    counter-clockwise from +x. Nothing is changed in place, so one searcher can serve several robots, each with a memory
    of its own.

    Creating the searcher compiles its programs, which takes some seconds. They are kept on disk (see
    `runtime.keep_compiled_programs`), and later starts load them. No call compiles anything afterward.

    Args:
      agent: one of `ONLINE_AGENTS`, or any agent whose guide is not privileged. For an agent by name, a class
        needs the votes of two frames in a cell, and the path ends somewhat nearer to the object than in simulations
        without noise.
      network: folder or place of a trained network for an agent by name, see `estimation.local_folder`;
        `None` for the shipped one.
      camera: intrinsics of the depth images; `None` for the agent's, by default those of the simulated robot,
        `maps.camera.indoor_camera`.

    Attributes:
      agent: components of the robot.

    Raises:
      InputError: the agent is unknown or privileged, or the network cannot be read.
    """

    def __init__(
        self, agent: str | Agent = "promising", *, network: str | Path | None = None, camera: Intrinsics | None = None
    ):
        keep_compiled_programs()
        if isinstance(agent, str):
            check_name("agent for a robot", agent, ONLINE_AGENTS, "or an `Agent` of your own")
            agent = agent_with(agent, network, noise=1.0)  # real labels and poses have errors
        self.agent = agent if camera is None else dataclasses.replace(agent, camera=camera)
        image, still = (self.agent.camera.height, self.agent.camera.width), (0.0, 0.0, 0.0)
        frame = Frame(jnp.zeros(image), jnp.zeros(image, jnp.uint8), camera_pose(0.0, 0.0, 0.0))
        picture = np.zeros((*VIEW_SIZE, 3), np.uint8)
        self.decide(self.init(still), "bed", still, still[:2], frame, picture)

    def init(self, pose: npt.ArrayLike, *, seed: int = 0) -> Searcher:
        """What a robot keeps from call to call: at first, an empty map centered on its start.

        Args:
          pose: x and y of the start, meters, and yaw, radians.
          seed: seed of the controller's samples.

        Raises:
          InputError: the pose is invalid.
        """
        found: Searcher = _begin(np.int32(seed), _vehicle(pose, (0.0, 0.0)), self.agent)
        return found

    def decide(
        self,
        memory: Searcher,
        target: str,
        pose: npt.ArrayLike,
        speeds: npt.ArrayLike,
        frame: Frame | None = None,
        image: npt.ArrayLike | None = None,
    ) -> tuple[SearchDecision, Searcher]:
        """Decide what to do in the next control period.

        The target may change from call to call; the map is kept.

        Args:
          memory: result of `init` for the first call, then of the call before.
          target: one of `maps.classes.TARGETS`.
          pose: x and y of the robot, meters, and yaw, radians.
          speeds: its forward speed, meters per second, and its turn rate, radians per second.
          frame: depth image (meters, 0 without return), class image (see `maps.classes`) and pose of the
            camera, for a robot with the simulated camera `maps.camera.camera_pose`. Simulated robots have
            one every `Agent.renewal` (5) periods. `None` between frames, when the robot drives on by its last costs.
          image: the camera's picture of that moment, uint8 `[48 64 3]`, for agents that use one.

        Returns:
          The decision, and the memory for the next call.

        Raises:
          InputError: a value is invalid, a picture that the agent uses is missing, or there is no frame though the
            target is new.
        """
        check_name("target", target, TARGETS)
        goal, agent = np.int32(TARGETS.index(target)), self.agent
        if frame is None and int(memory.target) != goal:
            raise InputError(f"target {target!r} is new to the robot, but there is no frame; give one with it")
        memory = _move(memory, _vehicle(pose, speeds), goal, agent)
        if frame is not None:
            picture = _checked_picture(image) if agent.estimator is not None else None
            memory = _look(memory, _checked_frame(frame, agent.camera), picture, agent)
        memory, found = _steer(memory, agent)
        (speed, turn_rate), arrived, to_goal, cost = (value.tolist() for value in jax.device_get(found))
        mode = "arrived" if arrived else "to_goal" if to_goal else "explore"
        return SearchDecision(speed, turn_rate, mode, cost, _why(mode, target, cost)), memory


def _why(mode: str, target: str, cost: float) -> str:
    if mode == "arrived":
        return f"arrived: the {target} is within reach"
    if mode == "to_goal":
        left = f"{cost:.1f} m to drive" if math.isfinite(cost) else "the path begins next to the robot"
        return f"to goal: a {target} is on the map, {left}"
    led = f"the guide's cost is {cost:.1f} here" if math.isfinite(cost) else "the guide knows no path from here"
    return f"explore: no path to a {target} is known, {led}"


def _numbers(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    try:
        numbers = np.asarray(values, np.float32)
    except (TypeError, ValueError):
        numbers = np.full((), np.nan, np.float32)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise InputError(f"{name} is {short(values)}; give finite numbers of shape {shape}")
    return numbers


def _vehicle(pose: npt.ArrayLike, speeds: npt.ArrayLike) -> VehicleState:
    x, y, yaw = _numbers("pose", pose, (3,))
    # `remainder` is exact: directions within a half turn stay as they are.
    yaw = np.float32(math.remainder(yaw, 2 * math.pi))
    parts = np.array([x, y]), yaw, *_numbers("speeds", speeds, (2,))
    return VehicleState(*(jnp.asarray(part) for part in parts))


def _checked_frame(frame: Frame, camera: Intrinsics) -> Frame:
    check_shapes(frame, camera)
    depth, classes = np.asarray(frame.depth), np.asarray(frame.classes)
    if not np.issubdtype(depth.dtype, np.floating) or classes.dtype != np.uint8:
        given = f"depth has dtype {depth.dtype} and classes {classes.dtype}"
        raise InputError(f"{given}; give meters as floats, and classes as uint8")
    position = _numbers("the camera's position", frame.pose.position, (3,))
    rotation = _numbers("the camera's rotation", frame.pose.rotation, (3, 3))
    pose = CameraPose(jnp.asarray(position), jnp.asarray(rotation))
    return Frame(jnp.asarray(depth.astype(np.float32)), jnp.asarray(classes), pose)


def _checked_picture(image: Any) -> UInt8[np.ndarray, "48 64 3"]:
    picture, shape = np.asarray(image), (*VIEW_SIZE, 3)
    if image is None or picture.dtype != np.uint8 or picture.shape != shape:
        found = "missing" if image is None else f"of dtype {picture.dtype} and shape {picture.shape}"
        raise InputError(f"the camera's picture is {found}; the agent needs one with each frame, uint8 {list(shape)}")
    return picture
