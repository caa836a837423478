"""The page of `dc2g demo`, served on this machine by NiceGUI, which loads nothing from other hosts."""

import asyncio
import io
import socket
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from jaxtyping import UInt8
from matplotlib import colormaps
from matplotlib.colors import to_hex
from nicegui import app, events, run, ui
from nicegui.server import Server
from starlette.middleware.trustedhost import TrustedHostMiddleware

from dc2g_jax.demo.local_server import OwnOriginOnly
from dc2g_jax.demo.robots import Demo, cost_picture, map_picture, open_dropped, open_maps, start_marks, walk_marks
from dc2g_jax.estimation import Estimator
from dc2g_jax.grid import FIGURE_COLORS
from dc2g_jax.inspection import COST_COLORS, MARK_COLOR, ROBOT_COLOR, SUBGOAL_COLOR, planner_style
from dc2g_jax.planning import PLANNERS
from dc2g_jax.runtime import InputError

_STYLE = """
.nicegui-content { padding: 0.75rem; }
.map { width: 100%; border: 1px solid #bbb; }
.map img { image-rendering: pixelated; }
.canvas img { touch-action: none; cursor: crosshair; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 21rem), 1fr)); gap: 1rem; }
.panels > * { max-width: 34rem; }
.why { min-height: 4.5em; line-height: 1.35; }
.key { white-space: nowrap; margin-right: 0.8em; }
.key i { display: inline-block; width: 0.85em; height: 0.85em; margin-right: 0.3em; border: 1px solid #777; }
"""

#: Marks on the maps, in the legend.
_KEYS = {"robot": ROBOT_COLOR, "door": MARK_COLOR, "plan and subgoal": SUBGOAL_COLOR, "path so far": "#000000"}

_TASK = (
    "Without a map, a robot must find the door of a house. It sees a quarter disk ahead and remembers "
    "what it has seen. Pale or white ground has not been seen."
)

#: Seconds between steps while playing.
_PAUSE = 0.12


def serve(
    maps: dict[str, UInt8[np.ndarray, "h w"]],
    planners: Sequence[str],
    estimator: Estimator,
    *,
    port: int,
    token: str,
    open_browser: bool,
) -> None:
    """Serve the page on 127.0.0.1 until Ctrl-C. Each visitor has separate state.

    Args:
      maps: class indices of the maps to choose from, by name.
      planners: names of the planners that run at first, including the user's own.
      estimator: network of planners that use one.
      port: port to listen on, see `check_port`.
      token: secret that the first address must have, see `OwnOriginOnly`; empty for none.
      open_browser: whether to open the page in a browser.
    """
    # A web site elsewhere must not reach the page, nor by a name of its own for this machine.
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"])
    app.add_middleware(OwnOriginOnly, token=token, port=port)
    path = f"/?token={token}" if token else "/"

    async def announce() -> None:
        while not Server.instance.started:  # the port opens after the startup
            await asyncio.sleep(0.01)
        print(f"Serving the page at http://127.0.0.1:{port}{path} (Ctrl-C stops it)", flush=True)

    app.on_startup(announce)
    ui.run(
        lambda: Page(Demo(maps, planners, estimator)), host="127.0.0.1", port=port,
        show=path if open_browser else False, reload=False,
        title="dc2g demo", favicon="🚪", language="en-US", show_welcome_message=False,
    )  # fmt: skip


def check_port(port: int) -> None:
    """Check that a server can listen on a port of this machine.

    Raises:
      InputError: it cannot.
    """
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or "not a port"
            raise InputError(
                f"--port {port}: {reason.lower()}; give another --port, such as {8000 + port % 999}"
            ) from None


class Page:
    """The page of one visitor, for a state."""

    def __init__(self, state: Demo):
        self.state, self.client = state, ui.context.client
        self.shown = 0
        self.last: tuple[int, int] | None = None
        self.panels: dict[str, tuple[ui.label, Any, ui.label]] = {}
        self.turn = asyncio.Lock()
        ui.add_css(_STYLE)
        ui.colors(primary="#37474f")
        drawer = ui.left_drawer(bordered=True).classes("gap-1").props("width=270")
        with ui.header().classes("items-center py-1 gap-2"):
            ui.button(icon="menu", on_click=drawer.toggle).props("flat color=white dense aria-label=Settings")
            ui.label("DC2G: a place to play").classes("text-lg")
            with ui.tabs().props("dense inline-label") as tabs:
                ui.tab("Watch", icon="smart_toy")
                ui.tab("Draw", icon="brush")
        with drawer:
            self._settings()
        with ui.tab_panels(tabs, value="Watch", animated=False).classes("w-full bg-transparent"):
            with ui.tab_panel("Watch").classes("p-0 gap-2"):
                self._watch()
            with ui.tab_panel("Draw").classes("p-0 gap-2"):
                self._draw()
        tabs.on_value_change(self._changed_tab)
        self._follow(self.client.request.query_params.get("map", ""))
        self.timer = ui.timer(_PAUSE, self.forward, active=False)
        ui.timer(0.05, self.restart, once=True)

    def _follow(self, link: str) -> None:
        if link:
            try:
                self.state.follow(link)
                self.choice.value = None
            except InputError as error:
                ui.notify(str(error), type="negative", multi_line=True)

    def _settings(self) -> None:
        state = self.state
        self.choice = ui.select(list(state.maps), label="Map", value=next(iter(state.maps)))
        self.choice.classes("w-full").on_value_change(lambda event: self._choose(event.value))
        with ui.input("Open a folder or map file").classes("w-full").props("dense") as place:
            place.on("keydown.enter", lambda: self._open(place.value))
            ui.button(icon="folder_open", on_click=lambda: self._open(place.value)).props("flat dense")
        drop = ui.upload(label="or drop a .npy or .png here", auto_upload=True, on_upload=self._dropped)
        drop.classes("w-full").props("flat bordered accept=.npy,.png")
        offered = {name: planner_style(name).label for name in dict.fromkeys((*PLANNERS, *state.planners))}
        planners = ui.select(offered, label="Planners", value=state.planners, multiple=True).props("use-chips")
        planners.classes("w-full").on_value_change(lambda event: self._set("planners", list(event.value)))
        self._slider("sensing_range", "Sensing range in cells", 1, 20, 1)
        self._slider("field_of_view", "Field of view in degrees", 30, 360, 15)
        ui.label("DC2G: score = predicted cost-to-go + way there - what it reveals").classes("text-xs text-grey-8 mt-2")
        self._slider("distance_weight", "Weight of distance", 0, 2, 0.01)
        self._slider("gain_weight", "Weight of information gain", 0, 20, 0.1)
        ui.label("After a change, the planners compile for some seconds.").classes("text-xs text-grey-8")

    def _slider(self, name: str, label: str, low: float, high: float, step: float) -> None:
        """A slider for an attribute of the state. It takes effect on release."""
        words = ui.label().classes("mt-2")
        slider = ui.slider(min=low, max=high, step=step, value=getattr(self.state, name))
        words.bind_text_from(slider, "value", lambda value: f"{label}: {value:g}")
        slider.on("change", lambda event: self._set(name, event.args))

    def _watch(self) -> None:
        ui.label(_TASK).classes("text-sm text-grey-9")
        with ui.row().classes("w-full items-center gap-1"):
            for icon, tip, act in (
                ("replay", "Back to the start", lambda: self.show(0)),
                ("skip_previous", "One step back", lambda: self.show(self.shown - 1)),
                ("skip_next", "One step", self.forward),
            ):
                ui.button(icon=icon, on_click=act).props(f'flat dense aria-label="{tip}"').tooltip(tip)
            self.play = ui.button("Play", icon="play_arrow", on_click=self._toggle).props("dense").classes("px-2")
            self.heat = ui.switch("Cost-to-go", value=True, on_change=lambda: self.show(self.shown))
            self.heat.tooltip("Show the predicted cost-to-go of observed ground, where a planner predicts it")
            ui.button("New start", icon="casino", on_click=self._new_start).props("flat dense")
        self.slider = ui.slider(min=0, max=1, value=0).classes("px-2")
        self.slider.on("update:model-value", lambda event: self.show(int(event.args)))
        self.busy = ui.linear_progress(show_value=False).props("indeterminate")
        self.grid = ui.element("div").classes("panels w-full")
        self.legend = ui.html(sanitize=False).classes("text-sm")

    def _draw(self) -> None:
        with ui.row().classes("w-full items-start gap-4"):
            with ui.column().classes("w-full md:w-72 gap-2"):
                tools = {"paint": "Paint", "rectangle": "Rectangle", "robot": "Place robot"}
                self.tool = ui.toggle(tools, value="paint").props("dense")
                ui.label("Drag to paint. Click to place the robot, and click it to turn it.").classes("text-sm")
                self.swatches: dict[str, ui.button] = {}
                with ui.element("div").classes("w-full grid grid-cols-3 md:grid-cols-2"):
                    for name, color in FIGURE_COLORS.items():
                        if name != "__ignore__":
                            swatch = ui.button(name.replace("_", " "), color=None, on_click=partial(self._take, name))
                            swatch.props("flat dense no-caps align=left").style(f"border-left: 1.5rem solid {color}")
                            self.swatches[name] = swatch
                self._take("front_door")
                ui.label("Brush width in cells").classes("text-sm")
                self.width = ui.toggle([1, 2, 3, 5], value=1).props("dense")
                with ui.row().classes("gap-2"):
                    ui.button("Undo", icon="undo", on_click=self._undo).props("flat dense")
                    ui.button("Empty map", icon="crop_square", on_click=self._blank).props("flat dense")
                    ui.button("Save as .npy", icon="download", on_click=self._save).props("flat dense")
            self.canvas = ui.interactive_image(
                on_mouse=self._drawn, sanitize=False, events=["pointerdown", "pointermove", "pointerup"]
            ).classes("map canvas max-w-xl")
            self.canvas.props('role=img aria-label="Map to draw on"')

    def _take(self, name: str) -> None:
        """Paint with this class from now on."""
        self.brush = name
        for other, swatch in self.swatches.items():
            swatch.classes(**{"add" if other == name else "remove": "bg-blue-grey-2"})

    async def _work(self, act: Callable[[], Any]) -> Any:
        """Compute in a thread, one task at a time. Shows errors, and then returns `False`."""
        async with self.turn:
            try:
                return await run.io_bound(act)
            except InputError as error:
                ui.notify(str(error), type="negative", multi_line=True)
            except Exception as error:  # a planner of the user's own may raise anything
                ui.notify(f"{type(error).__name__}: {error}", type="negative", multi_line=True)
                raise
        return False

    async def restart(self) -> None:
        """Restart with the current map, start and settings."""
        self._pause()
        self.state.walks = {}
        self._redraw_canvas()

        def begin() -> None:
            self.state.begin()
            self.state.step()

        self.busy.set_visibility(True)
        try:
            await self._work(begin)
        finally:
            self.busy.set_visibility(False)
        self._make_panels()
        self.show(0)
        # So that a reload, or whoever gets the address, has what was drawn.
        link = self.state.link if self.choice.value is None else ""
        self.client.run_javascript(
            f"history.replaceState(null, '', '{'?map=' * bool(link)}{link}' || location.pathname)"
        )

    def _make_panels(self) -> None:
        self.grid.clear()
        self.panels = {}
        with self.grid:
            for name in self.state.walks:
                style = planner_style(name)
                with ui.column().classes("w-full gap-1"):
                    with ui.row().classes("w-full items-baseline justify-between"):
                        ui.label(style.label).classes("font-bold").style(f"color: {style.color}")
                        progress = ui.label().classes("text-sm")
                    image = ui.interactive_image(sanitize=False).classes("map").props("role=img")
                    self.panels[name] = progress, image, ui.label().classes("why text-sm text-grey-9")

    @property
    def _last(self) -> int:
        """The last step that any planner has decided."""
        return max((len(walk.snapshots) for walk in self.state.walks.values()), default=1) - 1

    def show(self, step: int) -> None:
        """Show a step that has been decided. Robots that have arrived stay where they are."""
        self.shown = min(max(step, 0), self._last)
        self.slider.props(f"max={max(self._last, 1)}")
        self.slider.value = self.shown
        terrain = self.state.terrain
        for name, (progress, image, why) in self.panels.items():
            walk = self.state.walks.get(name)
            if walk is None or not walk.snapshots:
                continue
            at = min(self.shown, len(walk.snapshots) - 1)
            snapshot = walk.snapshots[at]
            image.set_source(
                cost_picture(walk, terrain, snapshot) if self.heat.value else map_picture(terrain, snapshot.seen)
            )
            image.set_content(walk_marks(walk, terrain, at, self.state.sensing_range, self.state.field_of_view))
            progress.text, why.text = walk.summary(at), snapshot.decision.why
            image.props["aria-label"] = f"Map of {planner_style(name).label}, {progress.text}"
        self.legend.content = self._legend()

    def _legend(self) -> str:
        keys = [(name, f"background:{color}") for name, color in _KEYS.items()]
        keys.append(("candidates: white is best", "background:#fff;border-radius:50%"))
        if self.heat.value:
            stops = ",".join(to_hex(colormaps[COST_COLORS](share)) for share in np.linspace(0, 1, 9))
            in_cells = all(walk.in_cells for walk in self.state.walks.values())
            span = f"0 to {max(self.state.terrain.shape)} cells" if in_cells else "from the lowest to the highest"
            bar = f"width:5em;background:linear-gradient(90deg,{stops})"
            keys.append((f"predicted cost-to-go, {span}", bar))
        return "".join(f'<span class="key"><i style="{style}"></i>{name}</span> ' for name, style in keys)

    async def forward(self) -> None:
        """Show the next step, deciding it first if necessary."""
        if self.shown == self._last and not await self._work(self.state.step):
            self._pause()
        self.show(self.shown + 1)

    def _toggle(self) -> None:
        if self.timer.active:
            self._pause()
        else:
            self.timer.activate()
            self.play.props("icon=pause").set_text("Pause")

    def _pause(self) -> None:
        self.timer.deactivate()
        self.play.props("icon=play_arrow").set_text("Play")

    async def _changed_tab(self, event: events.ValueChangeEventArguments) -> None:
        """Run what was drawn."""
        if event.value == "Watch" and not self.state.walks:
            await self.restart()

    async def _changed(self, change: Callable[[], None]) -> None:
        change()
        await self.restart()

    async def _set(self, name: str, value: Any) -> None:
        await self._changed(lambda: setattr(self.state, name, value))

    async def _choose(self, name: str | None) -> None:
        """Choose a map by name; `None` for the drawn map."""
        if name is not None:
            await self._changed(lambda: self.state.choose(name))

    async def _new_start(self) -> None:
        await self._changed(lambda: self.state.sample_start(int(np.random.default_rng().integers(2**31))))

    async def _dropped(self, event: events.UploadEventArguments) -> None:
        data, name = await event.file.read(), event.file.name
        self._offer(await self._work(lambda: open_dropped(name, data)))

    async def _open(self, location: str) -> None:
        self._offer(await self._work(lambda: open_maps(location)))

    def _offer(self, maps: dict[str, UInt8[np.ndarray, "h w"]] | Literal[False]) -> None:
        if maps:
            self.state.maps = maps
            self.choice.value = None  # a map may have the name of the one before
            self.choice.set_options(list(maps), value=next(iter(maps)))

    def _undo(self) -> None:
        self.choice.value = None
        self.state.undo()
        self._redraw_canvas()

    def _blank(self) -> None:
        self.choice.value = None
        self.state.keep()
        self.state.blank()
        self._redraw_canvas()

    def _save(self) -> None:
        file = io.BytesIO()
        np.save(file, self.state.terrain)
        ui.download.content(file.getvalue(), "map.npy")

    def _drawn(self, event: events.MouseEventArguments) -> None:
        height, width = self.state.terrain.shape
        cell = min(max(int(event.image_x), 0), width - 1), min(max(int(event.image_y), 0), height - 1)
        if event.type == "pointerdown":
            self.state.keep()
            self.last = None  # the pointer may have been released outside the picture
        if event.type == "pointerup" and self.tool.value == "rectangle" and self.last is not None:
            self.choice.value = None
            self.state.fill(self.last, cell, self.brush)
            self.last = None
        elif event.type == "pointerup" or (event.type == "pointermove" and self.last is None):
            self.last = None
            return
        elif self.tool.value == "robot":
            if event.type == "pointerdown":
                self.state.place(*cell)
        elif self.tool.value == "rectangle":
            self.last = self.last or cell
            return
        elif cell != self.last:
            self.choice.value = None
            self.state.paint(self.last or cell, cell, self.brush, self.width.value)
            self.last = cell
        self._redraw_canvas()

    def _redraw_canvas(self) -> None:
        self.canvas.set_source(map_picture(self.state.terrain))
        self.canvas.set_content(start_marks(self.state.terrain, self.state.start))
