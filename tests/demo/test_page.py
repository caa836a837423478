"""The page of `dc2g demo`, with a simulated visitor and with a browser."""

import asyncio
import importlib.util
import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid.terrain import FRONT_DOOR
from dc2g_jax._src.planning.decisions import RobotPose
from dc2g_jax._src.runtime.errors import require_extra
from dc2g_jax.demo import command as command
from dc2g_jax.demo.robots import Demo
from tests.support.networks import random_network
from tests.support.places import ROOT
from tests.support.refusals import refusal
from tests.support.toy import HOUSE

if not importlib.util.find_spec("nicegui"):
    pytest.skip("the extra demo is not installed", allow_module_level=True)
# NiceGUI, and the page that is written with it, are imported by the tests, as it takes seconds.
import httpx
import websockets.exceptions
import websockets.sync.client
from nicegui import ui
from nicegui.testing import user_simulation
from starlette.responses import PlainTextResponse

from dc2g_jax.demo.local_server import LARGEST_BODY, OwnOriginOnly
from dc2g_jax.demo.page import Page, check_port


def broken(rules):
    """A planner of the user's own that cannot be made."""
    raise RuntimeError("no planner yet")


def visited(visit) -> None:
    """Run `visit(user, pages)` on pages with a toy map and frontier exploration; `pages` grows with each visit."""
    network, pages = random_network(Architecture(widths=(4, 4, 4, 4))), []

    def root() -> None:
        state = Demo({"toy": HOUSE.terrain}, ["frontier"], network)
        state.start, state.sensing_range = RobotPose(9, 6, 0), 3
        pages.append(Page(state))

    async def run() -> BaseException | None:
        async with user_simulation(root) as user:
            try:
                await visit(user, pages)
            except AssertionError as error:  # raised in here, it would keep the server from ending
                return error
        return None

    if failure := asyncio.run(run()):
        raise failure


def test_a_visitor_steps_scrubs_and_meets_nobody_else():
    async def visit(user, pages):
        await user.open("/")
        await user.should_see("step 0", retries=200)
        page = pages[0]
        await page.forward()
        await user.should_see("step 1")
        image = page.panels["frontier"][1]
        second = image.content
        page.show(0)
        await user.should_see("step 0")
        assert image.content != second
        await page.forward()
        assert (image.content, len(page.state.walks["frontier"].snapshots)) == (second, 2)
        await user.http_client.get("/")
        pages[1].state.paint((0, 0), (3, 3), "road", 1)
        np.testing.assert_array_equal(page.state.terrain, HOUSE.terrain)

    visited(visit)


def test_a_visitor_draws_a_map_and_is_told_what_is_wrong():

    async def visit(user, pages):
        await user.open("/")
        await user.should_see("step 0", retries=200)
        (page,) = pages
        user.find("Empty map").click()
        pointer = user.find(ui.interactive_image).elements - {panel[1] for panel in page.panels.values()}
        assert pointer == {page.canvas}

        def point(kind: str, x: float, y: float) -> None:
            with user:
                for listener in page.canvas._event_listeners.values():
                    event = {"mouse_event_type": kind, "image_x": x, "image_y": y}
                    if listener.type == "mouse":
                        listener.handler(type("Event", (), {"args": event}))

        point("pointermove", 9.5, 9.5)  # nothing is pressed
        assert not np.any(page.state.terrain == FRONT_DOOR)
        for kind, x in (("pointerdown", 3.2), ("pointermove", 6.7), ("pointerup", 6.7), ("pointermove", 9.5)):
            point(kind, x, 12.5)
        assert np.argwhere(page.state.terrain == FRONT_DOOR).tolist() == [[12, x] for x in (3, 4, 5, 6)]
        assert page.choice.value is None  # so that the map can be chosen again
        page.tool.value = "rectangle"
        for kind, x in (("pointerdown", 20.5), ("pointermove", 22.5), ("pointerup", 21.5)):
            point(kind, x, 3.5)
        assert np.argwhere(page.state.terrain == FRONT_DOOR).tolist()[:2] == [[3, 20], [3, 21]]
        user.find("Undo").click()
        assert len(np.argwhere(page.state.terrain == FRONT_DOOR)) == 4
        point("pointerdown", 2.5, 2.5)  # released outside the picture
        for kind, x in (("pointerdown", 20.5), ("pointerup", 21.5)):
            point(kind, x, 3.5)
        assert np.argwhere(page.state.terrain == FRONT_DOOR).tolist()[:3] == [[3, 20], [3, 21], [12, 3]]
        page.tool.value = "robot"
        point("pointerdown", 0.5, 0.5)
        assert page.state.start[:2] == (0, 0)
        await page.restart()
        assert "the robot's cell (0, 0) is 'grass'" in user.notify.messages[-1]
        page.state.planners = ["tests.demo.test_page:broken"]
        page.state.choose("toy")
        with pytest.raises(RuntimeError):
            await page.restart()
        assert user.notify.messages[-1] == "RuntimeError: no planner yet"
        assert not page.busy.visible

    visited(visit)


def test_a_link_holds_what_was_drawn():
    async def visit(user, pages):
        drawn = Demo({"toy": HOUSE.terrain}, ["frontier"], random_network(Architecture(widths=(4, 4, 4, 4))))
        drawn.paint((0, 0), (9, 0), "road", 1)
        drawn.start = RobotPose(3, 5, 2)
        await user.open(f"/?map={drawn.link}")
        await user.should_see("step 0", retries=200)
        np.testing.assert_array_equal(pages[0].state.terrain, drawn.terrain)
        assert (pages[0].state.start, pages[0].choice.value) == (drawn.start, None)
        await user.open("/?map=nothing")
        assert "holds no map" in user.notify.messages[-1]

    visited(visit)


def test_other_users_need_the_token():
    async def served(scope, receive, send):
        await PlainTextResponse("the page")(scope, receive, send)

    async def visit() -> None:
        transport = httpx.ASGITransport(OwnOriginOnly(served, token="a-secret", port=8080))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as stranger:
            for path in ("/", "/?token=", "/?token=a-secre", SOCKET + "polling"):
                assert (await stranger.get(path)).status_code == 403
            assert (await stranger.get("/", headers={"Cookie": "dc2g_token_8080=another"})).status_code == 403
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as owner:
            first = await owner.get("/?token=a-secret")
            assert (first.status_code, first.text) == (200, "the page")
            assert "HttpOnly; SameSite=Strict" in first.headers["set-cookie"]
            assert (await owner.get(SOCKET + "polling")).status_code == 200
            # A browser sends the cookies of all ports, and replaces those of the same name.
            other = httpx.ASGITransport(OwnOriginOnly(served, token="other", port=8081))
            async with httpx.AsyncClient(transport=other, base_url="http://127.0.0.1", cookies=owner.cookies) as both:
                assert (await both.get("/")).status_code == 403
                assert (await both.get("/?token=other")).status_code == 200
                owner.cookies.update(both.cookies)
            assert (await owner.get("/")).status_code == 200

    asyncio.run(visit())


@pytest.mark.parametrize("token", ["a b", "a;b", "a&b", "caf\u00e9", "a\n"])
def test_a_token_that_no_cookie_holds_is_refused(token):
    refusal(lambda: command.main(command.Options(port=0, token=token)), f"--token {token!r}", "digits")


def test_an_extra_that_is_missing_is_named():
    refusal(lambda: require_extra("no_such_module", extra="demo"), "no_such_module", 'pip install "dc2g_jax[demo]"')


def test_a_port_that_is_taken():

    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        refusal(lambda: command.main(command.Options(port=port)), f"--port {port}", "in use", "another --port")
    check_port(port)
    refusal(lambda: check_port(70000), "--port 70000")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Host and port of the real command, with a toy map and frontier exploration."""
    toy = tmp_path_factory.mktemp("demo") / "toy.npy"
    np.save(toy, HOUSE.terrain)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    options = ["--no-browser", "--port", port, "--dataset", toy, "--planner", "frontier", "--token", ""]
    # Where NiceGUI sees pytest, it serves as its own tests need it.
    outside = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    command_line = [sys.executable, "-m", "dc2g_jax", "demo", *options]
    with subprocess.Popen(command_line, cwd=ROOT, env=outside, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert port in process.stdout.readline()
        socket.create_connection(("127.0.0.1", int(port))).close()  # the port is open when the line is printed
        yield f"127.0.0.1:{port}"
        process.terminate()


#: Where the page keeps its connection, with engine.io's parameters.
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport="


def foreign_origins(address: str) -> list[str]:
    """Another site, another server on this machine, another spelling of it, and a page without an origin."""
    port = address.partition(":")[2]
    elsewhere = ["https://example.com", f"http://{address}.example"]
    return [*elsewhere, "http://127.0.0.1:1", f"http://localhost:{port}", "null"]


def assert_guarded(answer: Any) -> None:
    """Every answer has the headers."""
    assert "frame-ancestors 'none'" in answer.headers["content-security-policy"]
    assert answer.headers["x-frame-options"] == "DENY"
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("path", ["/", SOCKET + "polling"])
def test_pages_of_other_origins_are_refused(address, path):
    for origin in (None, f"http://{address}"):
        answer = httpx.get(f"http://{address}{path}", headers={} if origin is None else {"Origin": origin})
        assert answer.status_code == 200
        assert_guarded(answer)
    for origin in foreign_origins(address):
        answer = httpx.get(f"http://{address}{path}", headers={"Origin": origin})
        assert (answer.status_code, answer.text) == (403, "pages of other origins are refused"), origin
        assert_guarded(answer)


def test_web_sockets_of_other_origins_are_refused(address):
    for origin in (None, f"http://{address}"):
        with websockets.sync.client.connect(f"ws://{address}{SOCKET}websocket", origin=origin) as connection:
            assert connection.recv(timeout=20).startswith('0{"sid":')
    for origin in foreign_origins(address):
        with pytest.raises(websockets.exceptions.InvalidStatus) as refused:
            websockets.sync.client.connect(f"ws://{address}{SOCKET}websocket", origin=origin)
        assert refused.value.response.status_code == 403
        assert_guarded(refused.value.response)


def test_large_bodies_are_refused(address):
    large = LARGEST_BODY * b"x"
    for body in (large + b"x", iter([large, b"x"])):  # with a length, and in chunks without one
        answer = httpx.post(f"http://{address}/", content=body)
        assert answer.status_code == 413
        assert_guarded(answer)
    assert httpx.post(f"http://{address}/", content=large).status_code == 200
    opened = httpx.get(f"http://{address}{SOCKET}polling").text
    session = json.loads(opened[1:])["sid"]
    assert httpx.post(f"http://{address}{SOCKET}polling&sid={session}", content=b"40").text.lower() == "ok"


def test_other_names_of_this_machine_are_refused(address):
    answer = httpx.get(f"http://{address}/", headers={"Host": "example.com"})
    assert answer.status_code == 400
    assert_guarded(answer)


def test_the_page_names_its_language(address):
    assert '<html lang="en-US"' in httpx.get(f"http://{address}/").text


@pytest.fixture
def page() -> Iterator[Any]:
    """A page of Chromium."""
    browsers = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
    chromium = next(filter(None, map(shutil.which, names)), None)
    if chromium is None:
        pytest.skip(f"no browser is installed: none of {', '.join(names)}")
    with browsers.sync_playwright() as play:
        page = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"]).new_page()
        page.set_default_timeout(60_000)
        yield page


@pytest.mark.slow
def test_a_browser_plays_paints_and_keeps_what_was_drawn(page, address, tmp_path):
    """It asks nobody but this machine."""
    dropped = tmp_path / "dropped.npy"
    np.save(dropped, HOUSE.terrain[:, ::-1])
    asked: list[str] = []
    told: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: told.append(message.text))
    page.goto(f"http://{address}/")
    page.get_by_text("step 0:").wait_for()
    page.get_by_role("img", name="Map of frontier, step 0:").wait_for()
    page.get_by_role("button", name="Play").click()
    page.get_by_text("reached the door").wait_for()
    page.get_by_role("tab", name="Draw").click()
    page.get_by_role("img", name="Map to draw on").wait_for()
    canvas = page.locator(".canvas img")
    before = canvas.get_attribute("src")
    canvas.click(position={"x": 5, "y": 5})
    differs = "src => document.querySelector('.canvas img').src != src"
    page.wait_for_function(differs, arg=before)
    painted = canvas.get_attribute("src")
    page.get_by_role("tab", name="Watch").click()
    page.wait_for_function("() => location.search.startsWith('?map=')")
    page.reload()
    page.get_by_role("tab", name="Draw").click()
    page.wait_for_function("src => document.querySelector('.canvas img')?.src == src", arg=painted)
    canvas.click(position={"x": 120, "y": 120})
    page.wait_for_function(differs, arg=painted)
    page.get_by_role("button", name="Undo").click()
    page.wait_for_function("src => document.querySelector('.canvas img').src == src", arg=painted)
    page.locator("input[type=file]").set_input_files(dropped)
    page.wait_for_function(differs, arg=painted)
    page.get_by_role("tab", name="Watch").click()
    page.get_by_text("step 0:").wait_for()
    assert {url.split("/")[2] for url in asked if not url.startswith("data:")} == {address}
    assert [words for words in told if "Content Security Policy" in words] == []


@pytest.mark.slow
def test_a_page_elsewhere_cannot_connect_from_a_browser(page, address):
    connect = """url => new Promise(done => {
        const connection = new WebSocket(url)
        connection.onopen = () => done("open")
        connection.onerror = () => done("refused")
    })"""
    poll = "url => fetch(url).then(answer => answer.status, () => 'refused')"
    where = f"{address}{SOCKET}"
    for place, outcomes in ((f"http://{address}/", ["open", 200]), ("about:blank", ["refused", "refused"])):
        page.goto(place)
        found = [page.evaluate(connect, f"ws://{where}websocket"), page.evaluate(poll, f"http://{where}polling")]
        assert found == outcomes
