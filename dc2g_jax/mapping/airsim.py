"""Client for AirSim, the simulator of the paper's Unreal experiments (sections III-C, IV-D).

AirSim's own Python package depends on a web server from 2018 and is not used. This module speaks AirSim's protocol,
MessagePack-RPC over TCP: a request is the array [0, number, method, parameters], an answer is [1, number, error,
result]. Its only requirement is `msgpack` (`pip install "dc2g_jax[all]"`). The layouts of messages follow AirLib's
`RpcLibAdaptorsBase.hpp`, version 1 of the protocol. Cosys-AirSim has version 4 and other image requests, and is not
supported.

AirSim's frame is x north, y east, z down, in meters from the start of the vehicle. A body looks along x, with y to the
right and z down. The world frame here is x east, y north, z up; `Camera.origin` gives its origin.

In AirSim's `settings.json`, give the images of types 0 (scene), 1 (planar depth) and 5 (segmentation) the same size
and field of view: they must show the same pixels.
"""

import dataclasses
import socket
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from dc2g_jax.errors import InputError, require_extra
from dc2g_jax.files.class_images import Palette
from dc2g_jax.grid.terrain import CLASS_NAMES, UNKNOWN
from dc2g_jax.mapping.camera import CameraPose, Frame, Intrinsics, intrinsics
from dc2g_jax.mapping.quaternions import quaternion_from_rotation, rotation_from_quaternion

#: AirSim's default port.
PORT = 41451

#: Types of images (`ImageCaptureBase::ImageType`).
SCENE, DEPTH_PLANAR, SEGMENTATION = 0, 1, 5

#: The version of the protocol (`getServerVersion` and the least that a server asks for).
_VERSION = 1

_REQUEST, _RESPONSE = 0, 1

#: Bytes taken from the socket at once.
_CHUNK = 1 << 16

#: Depths beyond this are sky, meters: AirSim's depth images have no other mark for it.
_SKY = 1000.0

#: Rotations from AirSim's frame to the world, and from the camera's axes right, down, forward to AirSim's body.
_WORLD_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_BODY_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


class AirSim:
    """A connection to a running AirSim. Use it in a `with` statement, or `close` it.

    Args:
      host: host on which AirSim runs.
      port: port on which it listens.
      timeout: longest total duration of a request, seconds.

    Raises:
      InputError: nothing listens there, it does not answer, it is not a supported AirSim, or `msgpack` is missing.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = PORT, timeout: float = 10.0):
        require_extra("msgpack")
        import msgpack

        self._address, self._timeout, self._number = f"{host}:{port}", timeout, 0
        self._pack = msgpack.packb
        # Old versions declare the bytes of images as text, which they are not.
        self._unpacker = msgpack.Unpacker(raw=False, unicode_errors="surrogateescape")
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            raise self._fault(f"cannot be reached ({error}); start it, or give its host and port") from None
        try:
            self._confirm()
        except InputError:
            self.close()
            raise

    def __enter__(self) -> "AirSim":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def call(self, method: str, *parameters: Any) -> Any:
        """Send one request and wait for its answer.

        Args:
          method: name of an AirSim function.
          parameters: its parameters: numbers, text, lists and dictionaries.

        Returns:
          The result: numbers, text, lists and dictionaries.

        Raises:
          InputError: no answer in time, the connection is lost, or AirSim reports an error.
        """
        self._number += 1
        deadline = time.monotonic() + self._timeout
        try:
            self._socket.settimeout(self._timeout)
            self._socket.sendall(self._pack([_REQUEST, self._number, method, list(parameters)]))
            answer = self._receive(deadline)
            # A late answer belongs to an earlier request that timed out.
            while self._is_late(answer):
                answer = self._receive(deadline)
        except TimeoutError:
            raise self._fault(
                f"no answer to {method} within {self._timeout:g} s; see whether it is paused, or give a longer timeout"
            ) from None
        except OSError as error:
            raise self._fault(f"gone during {method} ({error}); start it again") from None
        except ValueError as error:
            raise self._fault(f"answers {method} with what is no message ({error}); give AirSim's own port") from None
        if answer[2] is not None:
            raise self._fault(f"refuses {method}: {' '.join(str(answer[2]).split())}; see AirSim's log")
        return answer[3]

    def _is_late(self, answer: Any) -> bool:
        """Whether this is the answer to an earlier request.

        Raises:
          ValueError: it is not the answer to any request.
        """
        if not (isinstance(answer, list) and len(answer) == 4 and answer[0] == _RESPONSE):
            raise ValueError(f"a {type(answer).__name__} instead of [1, number, error, result]")
        if not (isinstance(answer[1], int) and answer[1] <= self._number):
            raise ValueError(f"the number {answer[1]!r}, which was not asked for")
        return bool(answer[1] < self._number)

    def _receive(self, deadline: float) -> Any:
        """The next message. The errors of msgpack are `ValueError`s."""
        while True:
            for message in self._unpacker:
                return message
            left = deadline - time.monotonic()
            if left <= 0:
                raise TimeoutError
            self._socket.settimeout(left)
            data = self._socket.recv(_CHUNK)
            if not data:
                raise ConnectionError("it has closed the connection")
            self._unpacker.feed(data)

    def _confirm(self) -> None:
        """Check that this is an AirSim of the supported version, as AirSim's own `confirmConnection` does."""
        if self.call("ping") is not True:
            raise self._fault("does not answer a ping with true; give AirSim's own port")
        for method in ("getServerVersion", "getMinRequiredClientVersion"):
            if (version := self.call(method)) != _VERSION:
                raise self._fault(f"{method} is {version!r}, not {_VERSION}; use a version that fits")

    def _fault(self, problem: str) -> InputError:
        return InputError(f"AirSim at {self._address}: {problem}")


@dataclasses.dataclass(frozen=True)
class Camera:
    """A camera of AirSim, and how to interpret its images.

    Attributes:
      palette: classes of the colors of segmentation images; a color that is not in the palette has no label.
      name: name of the camera, as in AirSim's settings.
      vehicle: vehicle that carries the camera; if empty, AirSim's first vehicle.
      origin: start of the vehicle in the world: x, y, and the height of AirSim's zero above the ground, meters.
    """

    palette: Palette
    name: str = "0"
    vehicle: str = ""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Capture(NamedTuple):
    """The images of one moment; NumPy arrays on the host.

    Attributes:
      frame: depth, classes and pose.
      picture: image of the scene, RGB.
      seconds: AirSim's time, seconds.
    """

    frame: Frame
    picture: UInt8[np.ndarray, "h w 3"]
    seconds: float


def capture(airsim: AirSim, camera: Camera) -> Capture:
    """Take the depth, segmentation and scene images of one moment.

    Raises:
      InputError: AirSim reports an error, or an image has another size or kind than AirSim states.
    """
    requests = [
        {"camera_name": camera.name, "image_type": kind, "pixels_as_float": kind == DEPTH_PLANAR, "compress": False}
        for kind in (SCENE, DEPTH_PLANAR, SEGMENTATION)
    ]
    answers = _call_of_camera(airsim, "simGetImages", requests, camera.vehicle)
    if not isinstance(answers, list) or len(answers) != len(requests):
        raise InputError(
            f"AirSim's simGetImages: sent no {len(requests)} images for camera {camera.name!r}; see its log"
        )
    scene, depth, segmentation = answers
    picture, colors = _pixels(scene), _pixels(segmentation)
    meters = _shaped(depth, np.asarray(depth["image_data_float"], np.float32), 1)[..., 0]
    for name, image in (("scene", picture), ("segmentation", colors)):
        if image.shape[:2] != meters.shape:
            raise InputError(
                f"AirSim's camera {camera.name!r}: {name} is {image.shape[1]} x {image.shape[0]} pixels, depth "
                f"{meters.shape[1]} x {meters.shape[0]}; give all CaptureSettings in settings.json one size"
            )
    classes = camera.palette.classes(colors)
    labels: Any = np.where(classes < len(CLASS_NAMES), classes, UNKNOWN).astype(np.uint8)
    returned: Any = np.where(meters < _SKY, meters, 0).astype(np.float32)
    pose = _world_pose(depth["camera_position"], depth["camera_orientation"], camera.origin)
    return Capture(Frame(depth=returned, classes=labels, pose=pose), picture, depth["time_stamp"] * 1e-9)


def camera_intrinsics(airsim: AirSim, camera: Camera, height: int, width: int) -> Intrinsics:
    """The intrinsics of a camera whose images have this size.

    Raises:
      InputError: AirSim reports an error or an impossible field of view.
    """
    degrees = _call_of_camera(airsim, "simGetCameraInfo", camera.name, camera.vehicle)["fov"]
    if not 0 < degrees < 180:
        raise InputError(f"AirSim's camera {camera.name!r}: has a field of view of {degrees} degrees; set FOV_Degrees")
    return intrinsics(degrees, height, width)


def vehicle_pose(airsim: AirSim, camera: Camera) -> CameraPose:
    """The vehicle's pose, as the pose of a camera in its middle that looks ahead."""
    pose = airsim.call("simGetVehiclePose", camera.vehicle)
    return _world_pose(pose["position"], pose["orientation"], camera.origin)


def set_vehicle_pose(airsim: AirSim, camera: Camera, pose: CameraPose) -> None:
    """Place the vehicle so that a camera in its middle that looks ahead has this pose. Collisions are ignored."""
    position = _WORLD_FROM_NED.T @ (np.asarray(pose.position, np.float64) - camera.origin)
    rotation = _WORLD_FROM_NED.T @ np.asarray(pose.rotation, np.float64) @ _BODY_FROM_CAMERA.T
    ned = {"position": _named("xyz", position), "orientation": _named("xyzw", quaternion_from_rotation(rotation))}
    airsim.call("simSetVehiclePose", ned, True, camera.vehicle)


def drive(airsim: AirSim, camera: Camera, throttle: float, steering: float, brake: float = 0.0) -> None:
    """Set the controls of a car. AirSim holds them until the next call.

    Args:
      airsim: the connection.
      camera: a camera on the car.
      throttle: -1 to 1; negative values drive in reverse gear.
      steering: -1 (left) to 1 (right).
      brake: 0 to 1.

    Raises:
      InputError: AirSim reports an error, or a number is out of range.
    """
    for name, value, low in (("throttle", throttle, -1), ("steering", steering, -1), ("brake", brake, 0)):
        if not low <= value <= 1:
            raise InputError(f"{name} is {value}; give {low} to 1")
    reverse = throttle < 0
    controls = {
        "throttle": float(throttle),
        "steering": float(steering),
        "brake": float(brake),
        "handbrake": False,
        "is_manual_gear": reverse,
        "manual_gear": -1 if reverse else 0,
        "gear_immediate": True,
    }
    airsim.call("enableApiControl", True, camera.vehicle)
    airsim.call("setCarControls", controls, camera.vehicle)


def label_objects(airsim: AirSim, object_ids: Mapping[str, int]) -> None:
    """Set the object numbers that determine colors in segmentation images.

    Args:
      airsim: the connection.
      object_ids: regular expression for names of meshes -> number from 0 to 255; later entries take precedence.

    Raises:
      InputError: AirSim reports an error, or no mesh has such a name.
    """
    for pattern, number in object_ids.items():
        if not 0 <= number <= 255:
            raise InputError(f"object number {number} of {pattern!r}: give 0 to 255")
        if airsim.call("simSetSegmentationObjectID", pattern, number, True) is not True:
            raise InputError(f"{pattern!r}: AirSim has no mesh of such a name; see simListSceneObjects")


def _call_of_camera(airsim: AirSim, method: str, *parameters: Any) -> Any:
    """Call a function of a camera. Some versions need a further argument: the camera is on a vehicle, not external."""
    try:
        return airsim.call(method, *parameters, False)
    except InputError as error:
        if "invalid number of arguments" not in str(error):
            raise
        return airsim.call(method, *parameters)


def _pixels(answer: Mapping[str, Any]) -> UInt8[np.ndarray, "h w 3"]:
    """The RGB image of an answer. AirSim sends blue, green, red and, in old versions, opacity."""
    data = answer["image_data_uint8"]
    values = np.frombuffer(data.encode("utf-8", "surrogateescape") if isinstance(data, str) else data, np.uint8)
    channels = 4 if values.size == 4 * answer["height"] * answer["width"] else 3
    return np.ascontiguousarray(_shaped(answer, values, channels)[..., 2::-1])


def _shaped(answer: Mapping[str, Any], values: np.ndarray, channels: int) -> np.ndarray:
    """The values as an image of the size that the answer states."""
    height, width = answer["height"], answer["width"]
    if not values.size == height * width * channels > 0:
        raise InputError(
            f"AirSim's image of type {answer['image_type']}: has {values.size} values for {width} x {height} pixels "
            f"({' '.join(str(answer['message']).split()) or 'no message'}); see AirSim's log and the camera's name"
        )
    return values.reshape(height, width, channels)


def _world_pose(
    position: Mapping[str, float], orientation: Mapping[str, float], origin: tuple[float, ...]
) -> CameraPose:
    """The world pose of something with this position and orientation in AirSim's frame."""
    ned = np.array([position[f"{axis}_val"] for axis in "xyz"])
    turn = rotation_from_quaternion(np.array([orientation[f"{axis}_val"] for axis in "xyzw"]))
    place: Any = (_WORLD_FROM_NED @ ned + origin).astype(np.float32)
    rotation: Any = (_WORLD_FROM_NED @ turn @ _BODY_FROM_CAMERA).astype(np.float32)
    return CameraPose(position=place, rotation=rotation)


def _named(axes: str, values: np.ndarray) -> dict[str, float]:
    return {f"{axis}_val": value for axis, value in zip(axes, values.tolist(), strict=True)}
