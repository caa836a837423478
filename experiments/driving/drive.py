"""The whole loop of one robot: camera -> semantic map -> estimator -> Algorithm 2 -> vehicle (paper, section IV-D).

The vehicle gets a command ten times a second. Every few control periods the robot adds a camera frame to its map. A
planner of `dc2g_jax.planning` decides on this map as in the gridworld, from the cell and the quarter turn
nearest to the robot's pose. The vehicle follows the plan until it enters the next cell, reaches the end of the plan, or
a second is over. Then the planner decides again.

A robot with a camera also corrects its map. A cell that it does not see although it should counts as an obstacle from
then on, so that exploration ends whatever the camera misses. A mapped door that is none becomes ground once the robot
has been there. A robot with nothing left to explore distrusts its map: it begins a new one a few times before it gives
up.

The vehicle avoids the people that its camera has shown in the last few seconds. What a frame tells of them is exact;
afterwards they are supposed to walk on as they did.

All functions take one robot; `support.driving` runs many.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Key, UInt8

from dc2g_jax import grid
from dc2g_jax.planning import EXPLORE, GAVE_UP, TO_GOAL, Planner
from dc2g_jax.robot.driving.footprint import Ground, blocked_around, cell_at, cell_centers, clearance
from dc2g_jax.robot.driving.robot import DRIVING, SimulatedRobot
from dc2g_jax.robot.driving.vehicle import CONTROL_PERIOD, VehicleLimits, VehicleState, at_rest, drive, wrapped
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, Intrinsics, level_camera
from dc2g_jax.robot.mapping.noise import PoseDrift, drift_on, drifted, noisy_frame
from dc2g_jax.robot.mapping.scene import Scene
from dc2g_jax.robot.mapping.semantic_map import MapSettings, SemanticMap, empty_map, integrate, terrain_map
from dc2g_jax.robot.mapping.simulator import CAMERA_HEIGHT, CAMERA_PITCH, CAMERA_RANGE, render
from experiments.driving.avoidance import People, navigate
from experiments.driving.following import ARRIVAL, Path, path_through
from experiments.driving.pedestrians import (
    NOWHERE,
    PERSON_RADIUS,
    Pedestrians,
    place,
    walk,
    walkable_cells,
    without_people,
)

#: Status of a robot that has reached a front door, and of one that has nothing left to explore.
ARRIVED, NOTHING_LEFT = 1, 2

#: Largest number of actions of a plan that are executed before the next decision.
_ACTIONS_AHEAD = 10

#: Control periods after which the robot decides again in any case.
_DECISION_PERIODS = 10

#: Number of new maps that a robot with nothing left to explore begins before it gives up.
_NEW_MAPS = 3

#: Control periods after which a robot forgets a person that its camera does not show.
_FORGETTING_PERIODS = 30

#: The robot has turned to a yaw if it differs by less, radians.
_TURNED = 0.1


@struct.dataclass
class Site:
    """A true house in three dimensions. Sites of equal size can be stacked.

    Attributes:
      terrain: class index of each cell.
      scene: scene for the simulated camera.
    """

    terrain: UInt8[Array, "h w"]
    scene: Scene


@struct.dataclass
class Equipment:
    """Components of a robot. Noise levels and weights are values, so other ones need no new program.

    Attributes:
      planner: chooses subgoals.
      sensing: the planner's model of which cells the camera sees.
      camera: intrinsics of the camera.
      mapping: settings of the map.
      noise: noise of the camera and the estimated pose.
      limits: limits of the vehicle.
      frame_periods: control periods between two camera frames.
    """

    planner: Planner
    sensing: grid.Kernel = struct.field(pytree_node=False)
    camera: Intrinsics
    mapping: MapSettings
    noise: grid.NoiseLevels
    limits: VehicleLimits
    frame_periods: int = struct.field(pytree_node=False, default=2)


@struct.dataclass
class Robot(SimulatedRobot):
    """State of a robot. Its status is `DRIVING`, `ARRIVED` or `NOTHING_LEFT`.

    Attributes:
      drift: error of its estimated pose.
      moved: distance driven since the last frame, meters, plus quarter turns.
      prior: class index of each cell that it knew beforehand, 0 elsewhere.
      map: map from its camera.
      missed: cells that it should have seen and has not.
      no_door: cells where it has been and found no door.
      terrain: class index of each cell by all of these, 0 where unknown.
      planner_state: state of the planner.
      path: path that it follows.
      decided_in: column and row of the cell of its last decision.
      decided_on: class index of each cell at that decision.
      mode: plan mode of that decision.
      new_maps: number of new maps that it has begun.
      people: pedestrians around it.
      seen: each of them in the last frame that showed it.
      seen_at: control period of that frame.
      decided_at: control period of the last decision.
      off_ground: control periods in which its footprint touched ground where it should not be.
      touched: control periods in which it touched a pedestrian.
    """

    drift: PoseDrift
    moved: Float[Array, ""]
    prior: UInt8[Array, "h w"]
    map: SemanticMap
    missed: Bool[Array, "h w"]
    no_door: Bool[Array, "h w"]
    terrain: UInt8[Array, "h w"]
    planner_state: Any
    path: Path
    decided_in: Int[Array, "2"]
    decided_on: UInt8[Array, "h w"]
    mode: Int[Array, ""]
    new_maps: Int[Array, ""]
    people: Pedestrians
    seen: Pedestrians
    seen_at: Int[Array, "people"]
    decided_at: Int[Array, ""]
    off_ground: Int[Array, ""]
    touched: Int[Array, ""]


def reset(
    key: Key[Array, ""], own: tuple[grid.Pose, ArrayLike], site: Site, equipment: Equipment, pedestrians: int = 0
) -> Robot:
    """The robot at its start. Its own are its pose, and whether it knows the whole map instead of an empty one."""
    start, knows_map = own
    key, own_key = jax.random.split(key)
    cell_size = equipment.mapping.cell_size
    here = jnp.stack([start.x, start.y])
    position, yaw = cell_centers(here, cell_size), -start.heading * (2 * jnp.pi / grid.HEADINGS)
    nowhere = jnp.zeros(site.terrain.shape, bool)
    prior = jnp.where(knows_map, site.terrain, jnp.uint8(grid.UNKNOWN))
    zero = jnp.int32(0)
    people = place(own_key, Ground(walkable_cells(site.terrain), cell_size), pedestrians, position)
    return Robot(
        key=key,
        vehicle=at_rest(position, yaw),
        drift=jnp.zeros(3, jnp.float32),
        moved=jnp.float32(0),
        prior=prior,
        map=empty_map(equipment.mapping),
        missed=nowhere,
        no_door=nowhere,
        terrain=prior,
        planner_state=equipment.planner.init(grid.World.from_terrain(site.terrain)),
        path=path_through(jnp.tile(here, (_ACTIONS_AHEAD + 1, 1)), 1, start.heading, cell_size),
        decided_in=here,
        decided_on=prior,
        mode=jnp.int32(EXPLORE),
        new_maps=zero,
        people=people,
        seen=people,
        seen_at=jnp.full_like(people.turned_back, -_FORGETTING_PERIODS - 1),
        periods=zero,
        # The first period begins with a decision.
        decided_at=jnp.int32(-_DECISION_PERIODS),
        status=jnp.int32(DRIVING),
        off_ground=zero,
        touched=zero,
    )


def step(robot: Robot, site: Site, equipment: Equipment) -> Robot:
    """The robot one control period later. It does not change after the end of its episode."""

    def go_on(robot: Robot) -> Robot:
        looks = robot.periods % equipment.frame_periods == 0
        robot = jax.lax.cond(looks, lambda robot: look(robot, site, equipment), lambda robot: robot, robot)
        robot = jax.lax.cond(
            _has_to_decide(robot, equipment), lambda robot: decide(robot, equipment), lambda robot: robot, robot
        )
        return _drive(robot, site, equipment)

    return jax.lax.cond(robot.status == DRIVING, go_on, lambda robot: robot, robot)


def believed(robot: Robot) -> VehicleState:
    """The vehicle at the estimated pose."""
    vehicle, drift = robot.vehicle, robot.drift
    return dataclasses.replace(vehicle, position=vehicle.position + drift[:2], yaw=wrapped(vehicle.yaw + drift[2]))


def outdoor_camera(vehicle: VehicleState) -> CameraPose:
    """The pose of the camera of a vehicle."""
    x, y = vehicle.position
    return level_camera(x, y, CAMERA_HEIGHT, vehicle.yaw, CAMERA_PITCH)


def look(robot: Robot, site: Site, equipment: Equipment) -> Robot:
    """Add a camera frame to the map."""
    frame, robot = sensed(robot, site, equipment)
    return _with_terrain(
        dataclasses.replace(robot, map=integrate(robot.map, frame, equipment.camera, equipment.mapping)), equipment
    )


def sensed(robot: Robot, site: Site, equipment: Equipment) -> tuple[Frame, Robot]:
    """The next camera frame with noise, at the estimated pose. Its error grows with the motion since the last frame.

    The robot then knows of the people that the frame shows.
    """
    key, drift_key, frame_key = jax.random.split(robot.key, 3)
    drift = drift_on(drift_key, robot.drift, equipment.noise, robot.moved)
    pose = outdoor_camera(robot.vehicle)
    frame = render(site.scene, equipment.camera, pose, CAMERA_RANGE)
    frame, shown = without_people(frame, robot.people.position, equipment.camera, CAMERA_RANGE)
    frame = noisy_frame(frame_key, frame, equipment.noise)
    latest = jax.vmap(lambda shown, *both: jax.tree.map(lambda now, before: jnp.where(shown, now, before), *both))
    robot = dataclasses.replace(
        robot,
        key=key,
        drift=drift,
        moved=jnp.zeros_like(robot.moved),
        seen=latest(shown, robot.people, robot.seen),
        seen_at=jnp.where(shown, robot.periods, robot.seen_at),
    )
    return dataclasses.replace(frame, pose=drifted(pose, drift)), robot


def _with_terrain(robot: Robot, equipment: Equipment) -> Robot:
    terrain = jnp.where(robot.prior != grid.UNKNOWN, robot.prior, terrain_map(robot.map, equipment.mapping))
    terrain = jnp.where(robot.missed & (terrain == grid.UNKNOWN), jnp.uint8(grid.NOTHING), terrain)
    terrain = jnp.where(robot.no_door & (terrain == grid.FRONT_DOOR), jnp.uint8(grid.FREE), terrain)
    # The robot is on traversable ground.
    column, row = _cell(believed(robot), equipment)
    here = terrain[row, column]
    here = jnp.where(jnp.asarray(grid.TRAVERSABLE)[here], here, jnp.uint8(grid.FREE))
    return dataclasses.replace(robot, terrain=terrain.at[row, column].set(here))


def decide(robot: Robot, equipment: Equipment) -> Robot:
    """Choose a path (Algorithm 2)."""
    vehicle = believed(robot)
    column, row = _cell(vehicle, equipment)
    quarter = jnp.round(-vehicle.yaw / (2 * jnp.pi / grid.HEADINGS)).astype(jnp.int32) % grid.HEADINGS
    pose = grid.Pose(x=column, y=row, heading=quarter)
    robot = _corrected(robot, pose, equipment)
    belief = grid.belief_from_map(robot.terrain, pose)
    changed = grid.bitboard.pack(robot.terrain != robot.decided_on)
    plan, planner_state = equipment.planner.plan(belief, equipment.planner.revised(robot.planner_state, changed))
    cells, length, heading = _path(belief, plan.subgoals)
    # A new map begins with the view to the left.
    gives_up = plan.mode == GAVE_UP
    length, heading = jnp.where(gives_up, 1, length), jnp.where(gives_up, quarter - 1, heading)
    new_maps = robot.new_maps + gives_up
    nowhere = jnp.zeros_like(robot.missed)
    voxels, missed, no_door = jax.tree.map(
        lambda new, old: jnp.where(gives_up, new, old),
        (empty_map(equipment.mapping), nowhere, nowhere),
        (robot.map, robot.missed, robot.no_door),
    )
    return dataclasses.replace(
        robot,
        map=voxels,
        missed=missed,
        no_door=no_door,
        planner_state=planner_state,
        path=path_through(cells, length, heading, equipment.mapping.cell_size),
        decided_in=jnp.stack([column, row]),
        decided_on=robot.terrain,
        mode=plan.mode,
        new_maps=new_maps,
        decided_at=robot.periods,
        status=jnp.where(new_maps > _NEW_MAPS, NOTHING_LEFT, robot.status).astype(jnp.int32),
    )


def _cell(vehicle: VehicleState, equipment: Equipment) -> Int[Array, "2"]:
    """Column and row of the map's cell that contains the vehicle or is nearest to it."""
    mapping = equipment.mapping
    last = jnp.array([mapping.columns - 1, mapping.rows - 1])
    return jnp.clip(cell_at(vehicle.position, mapping.cell_size), 0, last)


def _has_driven_path(robot: Robot) -> Bool[Array, ""]:
    """Whether the robot has stopped at the end of its path, at the path's final yaw."""
    vehicle, path = believed(robot), robot.path
    near = jnp.linalg.norm(path.points[-1] - vehicle.position) < ARRIVAL
    turned = jnp.abs(wrapped(path.yaw - vehicle.yaw)) < _TURNED
    return near & turned & (vehicle.speed == 0)


def _has_to_decide(robot: Robot, equipment: Equipment) -> Bool[Array, ""]:
    """Whether the robot has to decide now. After beginning a new map it looks around first."""
    elsewhere = jnp.any(_cell(believed(robot), equipment) != robot.decided_in)
    waited = robot.periods - robot.decided_at >= _DECISION_PERIODS
    return jnp.where(robot.mode == GAVE_UP, False, elsewhere | waited) | _has_driven_path(robot)


def _corrected(robot: Robot, pose: grid.Pose, equipment: Equipment) -> Robot:
    """Note at the end of a path which cells the robot misses there, and that its cell is no door."""
    stands = _has_driven_path(robot)
    belief = grid.belief_from_map(robot.terrain, pose)
    covered = equipment.sensing.visible(pose, belief.opaque, belief.width) & ~belief.seen
    missed = grid.bitboard.unpack(covered, belief.width)
    robot = dataclasses.replace(
        robot,
        missed=robot.missed | (missed & stands & (robot.mode == EXPLORE)),
        no_door=robot.no_door.at[pose.y, pose.x].max(stands & (robot.mode == TO_GOAL)),
    )
    return _with_terrain(robot, equipment)


def _path(belief: grid.Belief, subgoals: grid.PoseSet) -> tuple[Int[Array, "n 2"], Int[Array, ""], Int[Array, ""]]:
    """The cells of the first actions of a shortest plan into the subgoals (Algorithm 2, line 12).

    Returns:
      Column and row of the robot's cell and of the cell after each action; the number of them that count; last heading.
    """

    def act(carry: tuple[grid.Pose, Array], _: None) -> tuple[tuple[grid.Pose, Array], Array]:
        pose, length = carry
        first = grid.search.first_action(pose, subgoals, belief.traversable)
        goes_on = first.length > 0
        after = grid.moved(pose, first.action, belief.height, belief.width)
        pose = jax.tree.map(lambda new, old: jnp.where(goes_on, new, old), after, pose)
        return (pose, length + goes_on), jnp.stack([pose.x, pose.y])

    (last, length), cells = jax.lax.scan(act, (belief.pose, jnp.int32(1)), length=_ACTIONS_AHEAD)
    return jnp.concatenate([jnp.stack([belief.pose.x, belief.pose.y])[None], cells]), length, last.heading


def _drive(robot: Robot, site: Site, equipment: Equipment) -> Robot:
    """One control period: choose a command on the estimated map, and execute it on the true ground."""
    limits, cell_size = equipment.limits, equipment.mapping.cell_size
    ground = Ground(jnp.asarray(grid.TRAVERSABLE)[robot.terrain], cell_size)
    vehicle = believed(robot)
    command = navigate(vehicle, robot.path, ground, _people_around(robot), limits)
    key, walk_key = jax.random.split(robot.key)
    after = drive(robot.vehicle, command, limits)
    sidewalks = Ground(walkable_cells(site.terrain), cell_size)
    people = walk(walk_key, robot.people, sidewalks, robot.vehicle, limits.radius)
    drivable = Ground(jnp.asarray(grid.TRAVERSABLE)[site.terrain], cell_size)
    clear = clearance(after.position, blocked_around(drivable, after.position, 2 * limits.radius))
    nearest = jnp.min(jnp.linalg.norm(people.position - after.position, axis=-1))
    column, row = _cell(after, equipment)
    turned = jnp.abs(after.turn_rate) * CONTROL_PERIOD / (2 * jnp.pi / grid.HEADINGS)
    return dataclasses.replace(
        robot,
        key=key,
        vehicle=after,
        moved=robot.moved + after.speed * CONTROL_PERIOD + turned,
        people=people,
        periods=robot.periods + 1,
        status=jnp.where(site.terrain[row, column] == grid.FRONT_DOOR, ARRIVED, robot.status).astype(jnp.int32),
        off_ground=robot.off_ground + (clear < limits.radius),
        touched=robot.touched + (nearest < limits.radius + PERSON_RADIUS),
    )


def _people_around(robot: Robot) -> People:
    """The people that the robot has seen lately, where it supposes them, placed around its estimated pose."""
    yaw, age = robot.drift[2], (robot.periods - robot.seen_at)[:, None]
    supposed = robot.seen.position + age * CONTROL_PERIOD * robot.seen.velocity
    supposed = jnp.where(age > _FORGETTING_PERIODS, NOWHERE, supposed)
    along, across = jnp.cos(yaw), jnp.sin(yaw)
    turn = jnp.stack([jnp.stack([along, across]), jnp.stack([-across, along])])

    def turned(offsets: Float[Array, "people 2"]) -> Float[Array, "people 2"]:
        return jnp.sum(offsets[..., None] * turn, axis=-2)

    positions = believed(robot).position + turned(supposed - robot.vehicle.position)
    return People(positions=positions, velocities=turned(robot.seen.velocity), radius=PERSON_RADIUS)
