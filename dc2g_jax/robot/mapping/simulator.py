"""A simulated camera: depth and class of every pixel, by ray casting through a height field.

Ray casting is exact: a ray steps from tile to tile and intersects walls and tops in closed form. Over open ground it
crosses all tiles that are known to be flat around it in one step. Nearer surfaces hide farther ones.

- A ray that leaves the map or the range, or passes above everything, hits nothing: depth 0, class 0.
- A camera inside an obstacle, below the ground or off the map sees nothing.
- Class 0 with a positive depth is ground that the map does not know.

All functions take one camera; use `jax.vmap` for batches of cameras, in separate scenes or in the same. On CPUs
`jax.lax.map` is several times as fast: the data of one small image stay in the cache, and no image waits for another.

The default camera suits a delivery robot. Its field of view is the paper's (section IV-B): 90 degrees. It is 1 m high
and looks down by 15 degrees, so the visible ground begins 0.8 m ahead, in the next cell, and a front door is visible up
to its lintel from 3 m on. At 160 x 120 pixels, adjacent rows of pixels are 1 m of ground apart at 9 m distance. With
finer images, every visible cell of 1 m up to 8 cells away has its own pixels; with coarser images, distant cells are
observed only when the robot comes nearer.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax.grid import CAR, CLASS_NAMES, HEADINGS, HOUSE, Pose
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, Intrinsics, level_camera, rays
from dc2g_jax.robot.mapping.scene import CELL_SIZE, SHAPES, Scene

#: The default camera: horizontal field of view in degrees, height in meters, pitch in radians.
FIELD_OF_VIEW = 90.0
CAMERA_HEIGHT = 1.0
CAMERA_PITCH = math.radians(15)

#: Range of the default camera, meters: to the far side of a cell 8 cells away.
CAMERA_RANGE = 8.5

#: Faces that a ray may hit: those across x, across y, and tops.
FACE_X, FACE_Y, FACE_TOP = 0, 1, 2

#: Class name -> RGB by daylight, for pictures. Maps are drawn in `CLASS_COLORS` instead.
_PAINT: dict[str, tuple[int, int, int]] = {
    "__ignore__": (150, 150, 150),
    "front_door": (150, 40, 35),
    "grass": (104, 148, 74),
    "road": (92, 94, 100),
    "driveway": (176, 172, 166),
    "car": (58, 92, 150),
    "path": (196, 178, 150),
    "house": (226, 212, 184),
    "sidewalk": (205, 203, 198),
    "fence": (236, 232, 222),
    "tree": (48, 98, 56),
    "mailbox": (40, 60, 120),
    "bush": (70, 116, 60),
    "garage door": (240, 240, 236),
    "nothing": (120, 108, 92),
    "traversable": (188, 188, 180),
}
_COLORS = np.array([_PAINT[name] for name in CLASS_NAMES])

#: Class index -> (height in meters, RGB): the color above that height, for roofs and the windows of cars.
_UPPER = {HOUSE: (SHAPES["house"].rings[0], (142, 92, 76)), CAR: (SHAPES["car"].rings[0], (52, 62, 74))}

#: Class index -> whether it is an obstacle; RGB of the flat ground around obstacles.
_OBSTACLES, _FOOT = np.array([name in SHAPES for name in CLASS_NAMES]), (112, 106, 94)
_ZENITH, _HORIZON, _HAZE = (118, 166, 220), (222, 233, 242), (200, 206, 210)

#: Direction to the sun in the world; brightness of a face that the sun does not reach.
_SUN = (-0.42, -0.36, 0.83)
_SHADE = 0.6

#: Variation in brightness between tiles, which gives flat ground a visible texture.
_GRAIN = 0.05

#: Tolerance for rounding errors of heights, meters.
_ROUNDING = 1e-3


@struct.dataclass
class Hit:
    """The end of a ray.

    Attributes:
      distance: in lengths of the ray's direction, which is depth for the rays of a camera; 0 without a hit.
      row: row of the tile that is hit.
      column: column of that tile.
      face: face of that tile: `FACE_X`, `FACE_Y` or `FACE_TOP`.
    """

    distance: Float[Array, ""]
    row: Int[Array, ""]
    column: Int[Array, ""]
    face: Int[Array, ""]


class _March(NamedTuple):
    """State of a ray: its tile (whole numbers), when and by which face it entered, and whether it ends there."""

    column: Float[Array, ""]
    row: Float[Array, ""]
    time: Float[Array, ""]
    face: Int[Array, ""]
    ended: Bool[Array, ""]


class _Axis(NamedTuple):
    """One coordinate of a ray, in tiles."""

    start: Float[Array, ""]
    speed: Float[Array, ""]
    inverse: Float[Array, ""]

    @classmethod
    def of(cls, start: Float[Array, ""], speed: Float[Array, ""]) -> "_Axis":
        return cls(start, speed, jnp.where(speed == 0, jnp.inf, 1 / speed))

    def leaves(self, tile: Float[Array, ""], clearance: Float[Array, ""]) -> Float[Array, ""]:
        """When the ray leaves the tiles within `clearance` tiles of this one."""
        border = jnp.where(self.speed >= 0, tile + 1 + clearance, tile - clearance)
        return (border - self.start) * self.inverse

    def beyond(self, tile: Float[Array, ""], clearance: Float[Array, ""]) -> Float[Array, ""]:
        """The first tile past that border."""
        return tile + jnp.where(self.speed >= 0, 1 + clearance, -1 - clearance)

    def tile(self, time: Float[Array, ""], near: Float[Array, ""], clearance: Float[Array, ""]) -> Float[Array, ""]:
        """The tile at a time, clipped to the clearance around `near` against rounding errors."""
        return jnp.clip(jnp.floor(self.start + self.speed * time), near - clearance, near + clearance)


def cast(scene: Scene, origin: Float[Array, "3"], direction: Float[Array, "3"], max_range: Float[Array, ""]) -> Hit:
    """Cast one ray to the first surface it hits.

    Args:
      scene: the scene.
      origin: origin of the ray in the world, meters.
      direction: direction of the ray; need not be normalized.
      max_range: length of the ray, meters.
    """
    rows, columns = scene.field.shape
    across = _Axis.of(origin[0] / scene.tile_size, direction[0] / scene.tile_size)
    down = _Axis.of(-origin[1] / scene.tile_size, -direction[1] / scene.tile_size)
    start, speed = origin[2], direction[2]
    reach = max_range / jnp.sqrt(jnp.sum(direction**2))
    end = jnp.minimum(reach, jnp.where(speed > 0, (scene.ceiling - start) / speed, jnp.inf))

    def inside(ray: _March) -> Bool[Array, ""]:
        return (ray.column >= 0) & (ray.column < columns) & (ray.row >= 0) & (ray.row < rows)

    def goes_on(ray: _March) -> Bool[Array, ""]:
        return ~ray.ended & (ray.time <= end) & inside(ray)

    def advance(ray: _March) -> _March:
        value = scene.field.at[ray.row.astype(jnp.int32), ray.column.astype(jnp.int32)].get(mode="clip")
        top, clearance = jnp.maximum(value, 0), jnp.maximum(-value, 0)
        across_time, down_time = across.leaves(ray.column, clearance), down.leaves(ray.row, clearance)
        sideways = across_time <= down_time
        leaving = jnp.minimum(across_time, down_time)
        landing = jnp.where(speed < 0, (top - start) / speed, jnp.inf)
        meets_wall = start + speed * ray.time < top
        lands = ~meets_wall & (landing <= leaving)
        time = jnp.where(meets_wall, ray.time, jnp.minimum(landing, leaving))
        column, row = across.tile(time, ray.column, clearance), down.tile(time, ray.row, clearance)
        goes = ~meets_wall & ~lands
        return _March(
            column=jnp.where(goes & sideways, across.beyond(ray.column, clearance), column),
            row=jnp.where(goes & ~sideways, down.beyond(ray.row, clearance), row),
            time=time,
            face=jnp.where(meets_wall, ray.face, jnp.where(lands, FACE_TOP, jnp.where(sideways, FACE_X, FACE_Y))),
            ended=~goes,
        )

    begin = _March(
        column=jnp.floor(across.start),
        row=jnp.floor(down.start),
        time=jnp.float32(0),
        face=jnp.int32(FACE_TOP),
        ended=jnp.bool_(False),
    )
    ray = jax.lax.while_loop(goes_on, advance, begin)
    return Hit(
        distance=jnp.where(ray.ended & inside(ray) & (ray.time <= reach), ray.time, 0),
        row=ray.row.astype(jnp.int32),
        column=ray.column.astype(jnp.int32),
        face=ray.face,
    )


def cast_all(scene: Scene, pose: CameraPose, directions: Float[Array, "h w 3"], max_range: ArrayLike) -> Hit:
    """The hit of every pixel's ray; the fields of the `Hit` are images."""
    along_row = jax.vmap(cast, in_axes=(None, None, 0, None))
    return jax.vmap(along_row, in_axes=(None, None, 0, None))(
        scene, pose.position, directions, jnp.asarray(max_range, jnp.float32)
    )


def classes_of(scene: Scene, hits: Hit) -> UInt8[Array, "h w"]:
    """The class of each pixel, 0 where its ray hits nothing."""
    return jnp.where(hits.distance > 0, scene.classes.at[hits.row, hits.column].get(mode="clip"), 0).astype(jnp.uint8)


def render(scene: Scene, intrinsics: Intrinsics, pose: CameraPose, max_range: ArrayLike = CAMERA_RANGE) -> Frame:
    """Render the frame of a camera with a range of `max_range` meters, without errors."""
    hits = cast_all(scene, pose, rays(intrinsics, pose), max_range)
    return Frame(depth=hits.distance, classes=classes_of(scene, hits), pose=pose)


def robot_camera(pose: Pose, cell_size: ArrayLike = CELL_SIZE) -> CameraPose:
    """The pose of the default camera of a robot in the middle of a cell of `cell_size` meters."""
    return level_camera(
        x=(pose.x + 0.5) * cell_size,
        y=-(pose.y + 0.5) * cell_size,
        z=CAMERA_HEIGHT,
        yaw=-pose.heading * (2 * math.pi / HEADINGS),
        pitch=CAMERA_PITCH,
    )


def picture(scene: Scene, intrinsics: Intrinsics, pose: CameraPose) -> UInt8[Array, "h w 3"]:
    """Render a color picture of the scene by daylight, without shadows and with unlimited range."""
    directions = rays(intrinsics, pose)
    hits = cast_all(scene, pose, directions, math.inf)
    classes = classes_of(scene, hits)
    height = pose.position[2] + hits.distance * directions[..., 2]
    is_foot = jnp.asarray(_OBSTACLES)[classes] & (height < _ROUNDING)
    paint = jnp.where(is_foot[..., None], jnp.asarray(_FOOT), jnp.asarray(_COLORS)[classes])
    for index, (above, color) in _UPPER.items():
        is_upper = (classes == index) & (height > above + _ROUNDING)
        paint = jnp.where(is_upper[..., None], jnp.asarray(color), paint)
    light = _brightness(directions, hits)[..., None]
    seen = jnp.where(hits.distance[..., None] > 0, paint * light, _sky(directions))
    return jnp.clip(jnp.round(seen), 0, 255).astype(jnp.uint8)


def _brightness(directions: Float[Array, "h w 3"], hits: Hit) -> Float[Array, "h w"]:
    """Brightness of each pixel's surface: Lambert's law for the face that is hit, with a random grain per tile."""
    sun = jnp.asarray(_SUN) / math.hypot(*_SUN)
    # A ray hits the side of a tile that faces it.
    facing = jnp.where(directions > 0, -sun, sun).at[..., FACE_TOP].set(sun[FACE_TOP])
    share = jnp.take_along_axis(facing, hits.face[..., None], axis=-1)[..., 0]
    grain = (hits.row * 73 + hits.column * 151 + hits.row * hits.column * 7) % 17 / 16 - 0.5
    return (_SHADE + (1 - _SHADE) * jnp.maximum(share, 0)) * (1 + _GRAIN * grain)


def _sky(directions: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    """The color of rays that hit nothing: sky, and haze below the horizon."""
    rise = (directions[..., 2] / jnp.linalg.norm(directions, axis=-1))[..., None]
    sky = jnp.asarray(_HORIZON) + jnp.sqrt(jnp.maximum(rise, 0)) * (jnp.asarray(_ZENITH) - jnp.asarray(_HORIZON))
    return jnp.where(rise > 0, sky, jnp.asarray(_HAZE, jnp.float32))
