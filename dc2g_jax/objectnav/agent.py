"""A robot that looks for an object: camera -> map -> costs -> IT-MPC -> vehicle (Fig. 1 of the paper on dense costs).

Ten times a second the controller plans anew and the vehicle takes the first command of its plan. Every few of these
periods the robot looks, takes what it sees into its map, and asks its guide (`dc2g_jax.objectnav.guides`) what it costs
to be where. It has come to its end when the guide leads to an object itself and no more than `STOP` meters are left.

A vehicle does not drive into obstacles: one that would stays where it is, and its speed is gone.

Everything is a pure function of one robot; `dc2g_jax.objectnav.searches` runs many.
"""

import dataclasses
import functools
import math
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt8

from dc2g_jax.mapping.camera import CameraPose, Frame, Intrinsics, intrinsics, level_camera
from dc2g_jax.mapping.scene import Scene
from dc2g_jax.mapping.simulator import render
from dc2g_jax.objectnav.classes import GOALS, NOTHING
from dc2g_jax.objectnav.cost_maps import cost_lookup, dense_costs
from dc2g_jax.objectnav.goal_reacher import STOP, distance_to_object
from dc2g_jax.objectnav.mapping import IndoorMap, IndoorMapSettings, empty_map, grid_cell, integrate, stood_on
from dc2g_jax.objectnav.paint import painted
from dc2g_jax.objectnav.starts import ROBOT_RADIUS
from dc2g_jax.objectnav.worlds import IndoorWorld, scene
from dc2g_jax.programs import jit
from dc2g_jax.vehicles import mppi
from dc2g_jax.vehicles.footprint import Ground, clearance, surroundings
from dc2g_jax.vehicles.mppi import CostOfPose, MPPISettings
from dc2g_jax.vehicles.vehicle import CONTROL_PERIOD, VehicleLimits, VehicleState, at_rest, drive, wrapped

#: The camera: meters above the floor, how far it looks down (radians), degrees from side to side, rows and columns. It
#: is as high as those of the usual research robots. Level, it would see no floor nearer than 1.2 m and leave a hole in
#: the map around the start; looking down like this the floor begins at 0.6 m, and walls are in view up to 1.5 m from
#: 2.0 m on.
INDOOR_CAMERA_HEIGHT, INDOOR_CAMERA_PITCH, INDOOR_FIELD_OF_VIEW, INDOOR_IMAGE_SIZE = (
    0.9,
    math.radians(20),
    90.0,
    (120, 160),
)

#: Floor this near counts as explored, meters: the camera never sees it, and robots went back to look for it.
FOOTROOM = 0.6

#: What an indoor robot can do: as fast as one walks about a room.
LIMITS = VehicleLimits(
    max_speed=1.0, max_turn_rate=2.0, max_acceleration=1.5, max_turn_acceleration=8.0, radius=ROBOT_RADIUS
)

#: The controller; how many samples it takes was measured on validation houses.
CONTROLLER = MPPISettings(limits=LIMITS, samples=128)

#: What it costs the controller to be where the guide says that the robot must not be; how much of that is felt already
#: on the way there from the next cell; what each meter further in costs; and what it costs to leave the local map.
#: Meters. A short cut through a wall saves the rest of the horizon as much as the way around is longer: 50 steps, 20 m.
_COLLISION, _MARGIN, _SLOPE, _OUTSIDE = 2000.0, 1.0, 3.0, 2000.0

#: Seconds in which a vehicle that follows falling costs would turn to where they fall, at the rate it begins with.
_TURNING_TIME = 0.3

#: What a robot is doing.
UNDER_WAY, DECLARED = 0, 1

#: Columns of a robot's track.
TRACK = ("x", "y", "yaw", "speed", "turn_rate")


@struct.dataclass
class IndoorSite:
    """A house as it is. Sites of one size can be stacked.

    Attributes:
      scene: what its camera sees.
      paint: color of what is highest in a cell, see `dc2g_jax.objectnav.paint.painted`.
      free: floor on which nothing stands.
      distances: what the robot's middle has to drive until an object of each of `GOALS` is at arm's length, meters;
        infinite where it does not fit or finds no way. Only a privileged guide looks at it.
    """

    scene: Scene
    paint: UInt8[Array, "h w 3"]
    free: Bool[Array, "h w"]
    distances: Float[Array, "goal h w"]


@struct.dataclass
class Guidance:
    """What a guide says about the cells of the local map.

    Attributes:
      distance: what it costs to be there, in meters of way as a rule; infinite where the robot must not be.
      to_goal: is that the way to an object of the wanted class, to which the robot declares to have come at its end?
    """

    distance: Float[Array, "n n"]
    to_goal: Bool[Array, ""]


class Guide(Protocol):
    """Says where to go: a pytree."""

    def guide(self, key: Key[Array, ""], robot: "IndoorRobot", site: IndoorSite, agent: "Agent") -> Guidance:
        """Costs of the cells of the robot's local map, see `IndoorRobot.local_middle`."""
        ...


class Steering(Protocol):
    """Makes commands of costs: a pytree."""

    def plan(self, key: Key[Array, ""], robot: "IndoorRobot", costs: CostOfPose, agent: "Agent") -> Float[Array, "h 2"]:
        """The robot's next plan, whose first command is driven."""
        ...


@struct.dataclass
class Agent:
    """What a robot is made of.

    Attributes:
      guide: says where to go.
      steering: makes commands of that.
      camera: its intrinsics.
      mapping: what its map covers.
      controller: settings of the controller, and the limits of the vehicle.
      renewal: control periods from one look, and one set of costs, to the next.
    """

    guide: Guide
    steering: Steering
    camera: Intrinsics
    mapping: IndoorMapSettings = IndoorMapSettings()
    controller: MPPISettings = CONTROLLER
    renewal: int = struct.field(pytree_node=False, default=5)


@struct.dataclass
class IndoorRobot:
    """A robot on its way.

    Attributes:
      key: of its random numbers.
      target: what it looks for, an index into `GOALS`.
      vehicle: where it is.
      map: what it has seen of the house.
      frame: what it saw last.
      local_middle: row and column in the world's grid of the cell around which its costs lie, at half their side.
      distance: what the guide said last.
      costs: the same, and elsewhere a cost that leads back to where there is one.
      to_goal: do they lead to an object of the wanted class?
      controls: plan of the controller.
      periods: control periods since it set out.
      bumps: of these, those in which it ran into something.
      status: `UNDER_WAY`, or `DECLARED` when it says that it is there.
      track: `TRACK` at the start and after each period; where it stopped, from then on.
    """

    key: Key[Array, ""]
    target: Int[Array, ""]
    vehicle: VehicleState
    map: IndoorMap
    frame: Frame
    local_middle: Int[Array, "2"]
    distance: Float[Array, "n n"]
    costs: Float[Array, "n n"]
    to_goal: Bool[Array, ""]
    controls: Float[Array, "h 2"]
    periods: Int[Array, ""]
    bumps: Int[Array, ""]
    status: Int[Array, ""]
    track: Float[Array, "time 5"]


@struct.dataclass
class MPC:
    """Plans with IT-MPC all the way. One of the sampled plans is no random one but goes straight down the costs.

    Random copies of a plan hardly ever stand still for the second or two that facing about takes, and all that do not
    run into the wall ahead.
    """

    def plan(self, key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
        """See `Steering`."""
        return self.weighed(key, robot, costs, agent)[0]

    @staticmethod
    def weighed(
        key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent
    ) -> tuple[Float[Array, "h 2"], mppi.SampledPlans]:
        """The next plan, and the sampled ones that it was made from."""
        settings = agent.controller
        noise = mppi.sampled_noise(key, settings)
        noise = noise.at[0].set(descent(robot.vehicle, costs, agent) - robot.controls)
        return mppi.improved(robot.controls, noise, robot.vehicle, costs, settings)


def descent(vehicle: VehicleState, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
    """The commands of a vehicle that turns to where costs fall most and then goes there, all through the horizon."""
    limits, settings = agent.controller.limits, agent.controller
    steps = agent.mapping.cell_size * jnp.array([[1, 0], [-1, 0], [0, 1], [0, -1]], jnp.float32)

    def follow(vehicle: VehicleState, _: None) -> tuple[VehicleState, Float[Array, "2"]]:
        east, west, north, south = (costs(vehicle.position + step, vehicle.yaw) for step in steps)
        error = wrapped(jnp.arctan2(south - north, west - east) - vehicle.yaw)
        ahead = jnp.maximum(jnp.cos(error), 0) ** 2
        command = jnp.stack([limits.max_speed * ahead, error / _TURNING_TIME])
        return drive(vehicle, command, limits), command

    return jax.lax.scan(follow, vehicle, length=settings.horizon)[1]


@struct.dataclass
class LookAround:
    """Turns once around on the spot before it sets out, unless it has seen an object by then. A look costs no way.

    Attributes:
      steering: goes on from there.
    """

    steering: Steering

    def plan(self, key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
        """See `Steering`."""
        limits = agent.controller.limits
        looks = ~robot.to_goal & (robot.periods * CONTROL_PERIOD * limits.max_turn_rate < 2 * math.pi)
        turning = jnp.zeros_like(robot.controls).at[0, 1].set(limits.max_turn_rate)
        return jax.lax.cond(looks, lambda: turning, lambda: self.steering.plan(key, robot, costs, agent))


@struct.dataclass
class RandomUntilSeen:
    """Takes any command at all until it knows the way to an object, and then plans with IT-MPC.

    The paper's privileged random agent (section IV-A): speed and turn rate are drawn anew in each period.
    """

    def plan(self, key: Key[Array, ""], robot: IndoorRobot, costs: CostOfPose, agent: Agent) -> Float[Array, "h 2"]:
        """See `Steering`."""
        limits = agent.controller.limits

        def drawn() -> Float[Array, "h 2"]:
            least, most = jnp.array([0, -limits.max_turn_rate]), jnp.array([limits.max_speed, limits.max_turn_rate])
            return jax.random.uniform(key, robot.controls.shape, minval=least, maxval=most)

        return jax.lax.cond(robot.to_goal, lambda: MPC().plan(key, robot, costs, agent), drawn)


def usual_camera() -> Intrinsics:
    """The camera of all agents here."""
    return intrinsics(INDOOR_FIELD_OF_VIEW, *INDOOR_IMAGE_SIZE)


def site_of(world: IndoorWorld, name: str, radius: float = ROBOT_RADIUS) -> IndoorSite:
    """A house for robots to drive in.

    Args:
      world: one house.
      name: of the house; it is painted by chance, but always alike.
      radius: of the robots, meters.
    """
    return IndoorSite(
        scene=scene(world),
        paint=jnp.asarray(painted(world, np.random.default_rng([*name.encode()]))),
        free=jnp.asarray(world.free),
        distances=_distances(world.free, world.classes, radius, float(world.cell_size)),
    )


@functools.partial(jit, static_argnames=("radius", "cell_size"))
def _distances(free: Array, classes: Array, radius: float, cell_size: float) -> Float[Array, "goal h w"]:
    """Of every cell to the nearest object of each of `GOALS`. What is not free and no object is wall, or outside."""
    walls = ~free & (classes == NOTHING)
    return jax.lax.map(
        lambda goal: distance_to_object(~free, walls, classes == goal, radius=radius, cell_size=cell_size),
        jnp.array(GOALS, jnp.uint8),
    )


def reset(
    key: Key[Array, ""], start: Float[Array, "3"], target: Int[Array, ""], agent: Agent, limit: int
) -> IndoorRobot:
    """A robot at its start, which has seen nothing.

    Args:
      key: of all its random numbers.
      start: x and y, meters, and yaw, radians.
      target: what it looks for, an index into `GOALS`.
      agent: what it is made of.
      limit: control periods after which its time is up.
    """
    vehicle = at_rest(start[:2], start[2])
    side, image = agent.mapping.local, (agent.camera.height, agent.camera.width)
    nothing = jnp.int32(0)
    return IndoorRobot(
        key=key,
        target=jnp.asarray(target, jnp.int32),
        vehicle=vehicle,
        map=empty_map(vehicle.position, agent.mapping),
        frame=Frame(depth=jnp.zeros(image), classes=jnp.zeros(image, jnp.uint8), pose=camera_pose(vehicle)),
        local_middle=grid_cell(vehicle.position, agent.mapping.cell_size),
        distance=jnp.full((side, side), jnp.inf, jnp.float32),
        costs=jnp.zeros((side, side), jnp.float32),
        to_goal=jnp.bool_(False),
        controls=mppi.standing_still(agent.controller),
        periods=nothing,
        bumps=nothing,
        status=jnp.int32(UNDER_WAY),
        track=jnp.tile(_tracked(vehicle), (limit + 1, 1)),
    )


def camera_pose(vehicle: VehicleState) -> CameraPose:
    """Where a vehicle's camera is: above its middle, looking ahead and down."""
    return level_camera(
        vehicle.position[0], vehicle.position[1], INDOOR_CAMERA_HEIGHT, vehicle.yaw, INDOOR_CAMERA_PITCH
    )


def look(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """Take what the camera shows into the map."""
    frame = render(site.scene, agent.camera, camera_pose(robot.vehicle), agent.mapping.reach)
    seen = integrate(robot.map, frame, agent.camera, agent.mapping)
    known = stood_on(seen, robot.vehicle.position, FOOTROOM, agent.mapping)
    return dataclasses.replace(robot, map=known, frame=frame)


def decide(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """Ask the guide for new costs around the robot."""
    key, own_key = jax.random.split(robot.key)
    robot = dataclasses.replace(robot, key=key, local_middle=grid_cell(robot.vehicle.position, agent.mapping.cell_size))
    guidance = agent.guide.guide(own_key, robot, site, agent)
    return dataclasses.replace(
        robot,
        distance=guidance.distance,
        costs=filled_costs(guidance.distance, agent.mapping.cell_size),
        to_goal=guidance.to_goal,
    )


def filled_costs(distance: Float[Array, "n n"], cell_size: float) -> Float[Array, "n n"]:
    """Costs for the controller: the distance where there is one; elsewhere more, so that it leads back.

    What is beside cells with a distance costs more than all of these: a way that is shorter on the other side of a wall
    must not shine through.

    Args:
      distance: what the guide says, meters; infinite where the robot must not be.
      cell_size: meters.
    """
    known = jnp.isfinite(distance)
    around = jax.lax.reduce_window(jnp.where(known, distance, -jnp.inf), -jnp.inf, jax.lax.max, (3, 3), (1, 1), "SAME")
    rest = dense_costs(distance, cell_size, collision=_MARGIN, slope=_SLOPE)
    return jnp.where(known, distance, jnp.where(jnp.isfinite(around), around + _MARGIN, rest))


def act(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """One control period: plan, drive, and see whether that was the way."""
    key, own_key = jax.random.split(robot.key)
    size, limits = agent.mapping.cell_size, agent.controller.limits
    first = robot.local_middle - agent.mapping.local // 2
    plan = agent.steering.plan(own_key, robot, cost_of_pose(robot, agent), agent)
    driven = drive(robot.vehicle, plan[0], limits)
    vehicle, bumped = stopped_by_obstacles(robot.vehicle, driven, Ground(site.free, size), limits.radius)
    row, column = grid_cell(vehicle.position, size) - first
    arrived = robot.to_goal & (robot.distance[row, column] <= STOP)
    periods = robot.periods + 1
    return dataclasses.replace(
        robot,
        key=key,
        vehicle=vehicle,
        controls=mppi.shift(plan),
        periods=periods,
        bumps=robot.bumps + bumped,
        status=jnp.where(arrived, DECLARED, robot.status).astype(jnp.int32),
        track=jnp.where(jnp.arange(len(robot.track))[:, None] < periods, robot.track, _tracked(vehicle)),
    )


def cost_of_pose(robot: IndoorRobot, agent: Agent) -> CostOfPose:
    """What a place costs the controller: the guide's distance, bilinear between cells, and a price on collisions.

    That one has its edge on the borders of cells: bilinear too, it would close gaps of a single cell, which the robot
    just fits through.
    """
    side, size = agent.mapping.local, agent.mapping.cell_size
    first = robot.local_middle - side // 2
    corner = first[::-1].astype(jnp.float32) * jnp.array([size, -size], jnp.float32)
    lookup, closed = cost_lookup(robot.costs, size, _OUTSIDE), ~jnp.isfinite(robot.distance)

    def cost(position: Float[Array, "2"], yaw: Float[Array, ""]) -> Float[Array, ""]:
        row, column = jnp.clip(grid_cell(position, size) - first, 0, side - 1)
        return lookup(position - corner, yaw) + jnp.where(closed[row, column], _COLLISION, 0)

    return cost


def leg(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """From one look to the next: a robot that is under way looks, decides, and acts for `Agent.renewal` periods."""
    return act_on(look_and_decide(robot, site, agent), site, agent)


def look_and_decide(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """The first part of a leg: what its actions are based on."""
    return decide(look(robot, site, agent), site, agent)


def act_on(robot: IndoorRobot, site: IndoorSite, agent: Agent) -> IndoorRobot:
    """The second part of a leg: its actions."""
    begun = robot.periods
    limit = robot.track.shape[0] - 1

    def goes_on(robot: IndoorRobot) -> Bool[Array, ""]:
        return (robot.status == UNDER_WAY) & (robot.periods < jnp.minimum(begun + agent.renewal, limit))

    return jax.lax.while_loop(goes_on, lambda robot: act(robot, site, agent), robot)


def under_way(robot: IndoorRobot) -> Bool[Array, ""]:
    """Has the robot neither declared that it is there nor run out of time?"""
    return (robot.status == UNDER_WAY) & (robot.periods < robot.track.shape[0] - 1)


def stopped_by_obstacles(
    before: VehicleState, after: VehicleState, ground: Ground, radius: float
) -> tuple[VehicleState, Bool[Array, ""]]:
    """The vehicle as far as obstacles let it: in its old place without speed if it touched one in the new one.

    It still turns: a round body covers no new ground. One that touches something already may move away from it.

    Args:
      before: the vehicle.
      after: where it would be a period later.
      ground: the floor it may be on.
      radius: of the body, meters.

    Returns:
      The vehicle, and whether it was stopped.
    """
    around = surroundings(ground, before.position, radius + 2 * ground.cell_size)
    now, then = clearance(jnp.stack([before.position, after.position]), around)
    bumped = (then < radius) & (then < now)
    position, speed = jnp.where(bumped, before.position, after.position), jnp.where(bumped, 0, after.speed)
    return dataclasses.replace(after, position=position, speed=speed), bumped


def _tracked(vehicle: VehicleState) -> Float[Array, "5"]:
    """`TRACK` of a vehicle."""
    return jnp.stack([*vehicle.position, vehicle.yaw, vehicle.speed, vehicle.turn_rate])
