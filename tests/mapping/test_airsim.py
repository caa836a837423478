"""The client against a server that speaks AirSim's messages; it knows nothing of the client."""

import contextlib
import math
import socket
import threading
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.files.class_images import Palette
from dc2g_jax.grid.terrain import CLASS_NAMES, HOUSE, ROAD
from dc2g_jax.mapping import airsim
from dc2g_jax.mapping.airsim import AirSim, Camera
from dc2g_jax.mapping.camera import CameraPose, check_shapes, points
from tests.support.refusals import refusal

msgpack = pytest.importorskip("msgpack")

PALETTE = Palette(Path("palette.csv"), ("road", "house"), np.array([(10, 20, 30), (200, 100, 50)], np.uint8))
CAMERA = Camera(PALETTE, name="front", vehicle="Rover", origin=(100.0, -50.0, 0.5))
WIDTH, HEIGHT = 4, 3

LEVEL_NORTH = {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0}


def vector(x, y, z):
    return {"x_val": x, "y_val": y, "z_val": z}


def about(axis: str, degrees: float):
    half = math.radians(degrees) / 2
    return LEVEL_NORTH | {"w_val": math.cos(half), f"{axis}_val": math.sin(half)}


def response(kind, *, uint8=b"\0", floats=(0.0,), **changes):
    """An ImageResponse as AirLib packs it; of what is not meant, one value is sent."""
    return {
        "image_data_uint8": uint8,
        "image_data_float": list(floats),
        "camera_position": vector(10.0, 3.0, -2.0),
        "camera_name": "front",
        "camera_orientation": LEVEL_NORTH,
        "time_stamp": 1_500_000_000,
        "message": "",
        "pixels_as_float": len(floats) > 1,
        "compress": False,
        "width": WIDTH,
        "height": HEIGHT,
        "image_type": kind,
    } | changes


def images(**changes):
    """What AirSim answers to `simGetImages`: scene, depth and segmentation; colors go blue, green, red."""
    bgr = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    bgr[0], bgr[1] = (30, 20, 10), (50, 100, 200)
    scene = np.arange(HEIGHT * WIDTH * 3, dtype=np.uint8)
    depth = [0.5 * pixel for pixel in range(HEIGHT * WIDTH - 1)] + [65504.0]
    answers = {
        "scene": response(0, uint8=scene.tobytes()),
        "depth": response(1, floats=depth),
        "segmentation": response(5, uint8=bgr.tobytes()),
    }
    return list((answers | changes).values())


class Server:
    """Answers requests on one connection from a table, method -> result or function of the parameters."""

    def __init__(self, **answers):
        versions = {"ping": True, "getServerVersion": 1, "getMinRequiredClientVersion": 1}
        self.answers, self.requests = versions | answers, []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._listening.close()
        self._thread.join(5)
        assert not self._thread.is_alive()

    def _serve(self):
        with contextlib.suppress(OSError), self._listening.accept()[0] as connection:
            unpacker = msgpack.Unpacker()
            while data := connection.recv(1000):
                unpacker.feed(data)
                for request in unpacker:
                    answer = self.answer(*request)
                    if not answer:
                        return
                    # In two pieces: a message need not come as a whole.
                    connection.sendall(answer[:7])
                    connection.sendall(answer[7:])

    def answer(self, kind, number, method, parameters):
        assert kind == 0
        if method not in self.answers:
            return msgpack.packb([1, number, f"rpclib: server could not find function '{method}'", None])
        self.requests.append((method, parameters))
        answer = self.answers[method]
        try:
            result = answer(*parameters) if callable(answer) else answer
        except TypeError:
            # As rpclib says it.
            words = f"rpclib: Function '{method}' was called with an invalid number of arguments. Expected: 2, got: 3"
            return msgpack.packb([1, number, words, None])
        except RuntimeError as error:
            return msgpack.packb([1, number, str(error), None])
        return result if isinstance(result, bytes) else msgpack.packb([1, number, None, result], use_single_float=True)


@contextlib.contextmanager
def connected(timeout=5.0, **answers):
    with Server(**answers) as server, AirSim(port=server.port, timeout=timeout) as client:
        yield client, server


def test_a_connection_is_confirmed_as_airsim_does():
    with connected() as (_, server):
        assert [method for method, _ in server.requests] == ["ping", "getServerVersion", "getMinRequiredClientVersion"]


def test_a_capture_is_a_frame_of_the_world():
    with connected(simGetImages=lambda requests, vehicle, external: images()) as (client, server):
        found = airsim.capture(client, CAMERA)
    method, (requests, vehicle, external) = server.requests[-1]
    assert (method, vehicle, external) == ("simGetImages", "Rover", False)
    assert requests == [
        {"camera_name": "front", "image_type": kind, "pixels_as_float": kind == 1, "compress": False}
        for kind in (0, 1, 5)
    ]
    expected = 0.5 * np.arange(12).reshape(3, 4)
    expected[2, 3] = 0  # sky
    np.testing.assert_array_equal(found.frame.depth, expected.astype(np.float32))
    # Black is in no palette.
    np.testing.assert_array_equal(found.frame.classes, np.repeat([[ROAD], [HOUSE], [0]], WIDTH, axis=1))
    assert found.frame.classes.dtype == np.uint8
    assert found.picture[0, 1].tolist() == [5, 4, 3]
    assert found.seconds == 1.5
    # 10 m north, 3 m east, 2 m up from where the vehicle started; looking north.
    np.testing.assert_allclose(found.frame.pose.position, [103.0, -40.0, 2.5])
    np.testing.assert_allclose(found.frame.pose.rotation, [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-7)


@pytest.mark.parametrize(
    ("turn", "ahead", "right"),
    [
        (about("z", 90), (1, 0, 0), (0, -1, 0)),  # yaw to the right: east
        (about("z", 180), (0, -1, 0), (-1, 0, 0)),
        (about("y", 30), (0, math.sqrt(0.75), 0.5), (1, 0, 0)),  # nose up
        (about("x", 90), (0, 1, 0), (0, 0, -1)),  # rolled to the right
    ],
)
def test_turns_in_airsims_frame_are_turns_in_the_world(turn, ahead, right):
    pose = {"position": vector(0.0, 0.0, 0.0), "orientation": turn}
    with connected(simGetVehiclePose=lambda vehicle: pose) as (client, _):
        found = airsim.vehicle_pose(client, CAMERA)
    np.testing.assert_allclose(found.rotation[:, 2], ahead, atol=1e-6)
    np.testing.assert_allclose(found.rotation[:, 0], right, atol=1e-6)
    assert np.linalg.det(found.rotation) == pytest.approx(1)
    np.testing.assert_allclose(found.position, CAMERA.origin)


def test_a_pose_that_is_set_is_the_pose_that_is_got():
    kept = {}

    def keep(pose, ignore_collision, vehicle):
        assert ignore_collision is True
        kept[vehicle] = pose

    pose = CameraPose(
        position=np.float32([90, -45, 1.5]), rotation=np.float32([[0.6, 0, 0.8], [-0.8, 0, 0.6], [0, -1, 0]])
    )
    with connected(simSetVehiclePose=keep, simGetVehiclePose=lambda vehicle: kept[vehicle]) as (client, _):
        airsim.set_vehicle_pose(client, CAMERA, pose)
        found = airsim.vehicle_pose(client, CAMERA)
    assert kept["Rover"]["position"] == vector(5.0, -10.0, -1.0)
    np.testing.assert_allclose(found.position, pose.position, atol=1e-5)
    np.testing.assert_allclose(found.rotation, pose.rotation, atol=1e-6)


def test_points_of_a_capture_lie_where_airsim_says():
    info = {"pose": {"position": vector(0, 0, 0), "orientation": LEVEL_NORTH}, "fov": 90.0, "proj_mat": {"matrix": []}}
    with connected(
        simGetImages=lambda *_: images(depth=response(1, floats=[8.0] * 12, camera_orientation=about("z", 90))),
        simGetCameraInfo=lambda camera, vehicle, external: info,
    ) as (client, server):
        frame = airsim.capture(client, CAMERA).frame
        camera = airsim.camera_intrinsics(client, CAMERA, *frame.depth.shape)
    assert server.requests[-1] == ("simGetCameraInfo", ["front", "Rover", False])
    check_shapes(frame, camera)
    found = np.asarray(points(jnp.asarray(frame.depth), camera, frame.pose))
    # 8 m to the east; the outer edges of the first and the last column are as far to the sides, the last one south.
    np.testing.assert_allclose(found[..., 0], 111.0, atol=1e-4)
    np.testing.assert_allclose(found[0, :, 1] + 40, [6, 2, -2, -6], atol=1e-4)
    np.testing.assert_allclose(found[:, 0, 2] - 2.5, [4, 0, -4], atol=1e-4)


def test_versions_without_cameras_of_the_scene_are_asked_without():
    with connected(simGetImages=lambda requests, vehicle: images()) as (client, server):
        assert airsim.capture(client, CAMERA).frame.depth.shape == (HEIGHT, WIDTH)
    assert [len(parameters) for method, parameters in server.requests if method == "simGetImages"] == [3, 2]


def test_old_versions_send_opacity_and_text():
    bgra = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    bgra[:] = 50, 100, 200, 255
    message = msgpack.packb(
        [1, 4, None, images(segmentation=response(5, uint8=bgra.tobytes()))], use_bin_type=False, use_single_float=True
    )
    with connected(simGetImages=lambda *_: message) as (client, _):
        found = airsim.capture(client, CAMERA)
    assert np.all(found.frame.classes == HOUSE)


def test_a_car_is_driven():
    done = []
    with connected(
        enableApiControl=lambda on, vehicle: done.append((on, vehicle)),
        setCarControls=lambda controls, vehicle: done.append((controls, vehicle)),
    ) as (client, _):
        airsim.drive(client, CAMERA, throttle=-0.5, steering=0.25)
        refusal(lambda: airsim.drive(client, CAMERA, 0.0, 1.5), "steering is 1.5", "-1 to 1")
    assert done == [
        (True, "Rover"),
        (
            {
                "throttle": -0.5,
                "steering": 0.25,
                "brake": 0.0,
                "handbrake": False,
                "is_manual_gear": True,
                "manual_gear": -1,
                "gear_immediate": True,
            },
            "Rover",
        ),
    ]


def test_objects_get_their_numbers():
    with connected(simSetSegmentationObjectID=lambda name, number, is_regex: name != "Doors.*") as (client, server):
        airsim.label_objects(client, {"Road.*": CLASS_NAMES.index("road")})
        assert server.requests[-1] == ("simSetSegmentationObjectID", ["Road.*", ROAD, True])
        refusal(lambda: airsim.label_objects(client, {"Doors.*": 1}), "'Doors.*'", "no mesh")
        refusal(lambda: airsim.label_objects(client, {"x": 256}), "256", "0 to 255")


def test_images_of_another_size_are_refused():
    short = response(5, uint8=bytes(WIDTH * HEIGHT * 3 - 1))
    small = response(5, uint8=bytes((WIDTH - 1) * HEIGHT * 3), width=WIDTH - 1)
    unknown = response(1, floats=[0.0], width=0, height=0, message="no camera\n'front'")
    for changes, *mentions in (
        ({"segmentation": short}, "type 5", "35 values for 4 x 3 pixels"),
        ({"segmentation": small}, "segmentation is 3 x 3 pixels, depth 4 x 3", "CaptureSettings"),
        ({"depth": unknown}, "type 1", "1 values for 0 x 0 pixels", "no camera 'front'"),
    ):
        with connected(simGetImages=lambda *_, changes=changes: images(**changes)) as (client, _):
            refusal(lambda client=client: airsim.capture(client, CAMERA), *mentions)
    with connected(simGetImages=lambda *_: images()[:2]) as (client, _):
        refusal(lambda: airsim.capture(client, CAMERA), "no 3 images", "'front'")


def test_errors_of_airsim_are_told():
    def fail(*_):
        raise RuntimeError(
            "rpclib: function 'simGetImages' (called with 3 arg(s)) threw:\nVehicle API is not available"
        )

    with connected(simGetImages=fail) as (client, server):
        refusal(lambda: airsim.capture(client, CAMERA), f":{server.port}", "simGetImages", "Vehicle API is not")
        refusal(lambda: client.call("simFly"), "could not find function 'simFly'")
        assert client.call("ping") is True


def test_a_server_that_is_gone_is_told():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    refusal(lambda: AirSim(port=port), f"127.0.0.1:{port}", "cannot be reached", "start it")
    with connected(simPause=lambda *_: b"") as (client, _):
        refusal(lambda: client.call("simPause", True), "gone during simPause")


def test_no_answer_is_waited_for_longer_than_said():
    begun = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        refusal(lambda: AirSim(port=silent.getsockname()[1], timeout=0.2), "no answer to ping within 0.2 s")
    assert time.monotonic() - begun < 2


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_one():
    def late(*_):
        time.sleep(0.6)
        return "too late"

    with connected(timeout=0.3, simRunConsoleCommand=late, simIsPaused=False) as (client, _):
        refusal(lambda: client.call("simRunConsoleCommand", "x"), "no answer to simRunConsoleCommand")
        time.sleep(0.5)
        assert client.call("simIsPaused") is False


@pytest.mark.parametrize("garbage", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\xc1", msgpack.packb([1, 99, None, 0])])
def test_other_servers_are_refused(garbage):
    with Server(ping=lambda: garbage) as server:
        refusal(lambda: AirSim(port=server.port, timeout=2), f":{server.port}", "no message")


@pytest.mark.parametrize(
    ("method", "answer"), [("ping", False), ("getServerVersion", 4), ("getMinRequiredClientVersion", 2)]
)
def test_other_versions_are_refused(method, answer):
    with Server(**{method: answer}) as server:
        refusal(
            lambda: AirSim(port=server.port), f":{server.port}", "ping" if method == "ping" else f"{method} is {answer}"
        )
