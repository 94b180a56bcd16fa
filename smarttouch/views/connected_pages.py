"""Browser pages of a run: all receive the newest state, one has control, each can stop the run."""

import asyncio
import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.stopping import StopRequest
from smarttouch.running.loop import STEP, Controls
from smarttouch.running.step_records import StepResult
from smarttouch.sources.source_contract import Source
from smarttouch.views.window_server import import_server

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.routing import BaseRoute
    from starlette.websockets import WebSocket

LOST_S = 0.7  # time without a message after which a page loses control


class Steering:
    """Control of a run by one browser page at a time. If no page has control, the next page that
    sends a request gets it. If ``alone``, the run pauses when the page in control is gone."""

    def __init__(
        self,
        controls: Controls,
        stop: StopRequest,
        keys: Mapping[str, Callable[[], None]],
        *,
        alone: bool,
        lost_s: float = LOST_S,
    ) -> None:
        self.controls: Controls = controls
        self._stop, self._keys, self._alone, self._lost_s = stop, keys, alone, lost_s
        self._page: int | None = None
        self._alive_s = 0.0
        self._lock = threading.Lock()
        self._does: dict[str, Callable[[], None]] = {
            "more": lambda: controls.change_level(STEP),
            "less": lambda: controls.change_level(-STEP),
            "none": controls.silence,
            "pause": controls.pause,
            "resume": controls.resume,
        }

    @property
    def page(self) -> int | None:
        """Number of the page in control, or None."""
        return self._page

    def stop(self) -> None:
        """End the run with all electrodes at zero, even for a page without control."""
        self._stop.ask("the window")

    def steer(self, page: int) -> bool:
        """Give control to this page if no page has it. Return whether this page has control now."""
        with self._lock:
            if self._page is None:
                self._alive_s, self._page = time.monotonic(), page
            return self._page == page

    def leave(self, page: int) -> None:
        """Release control if this page has it."""
        with self._lock:
            if self._page != page:
                return
            self._page = None
        if self._alone:
            self.controls.pause()

    def note_alive(self, page: int) -> None:
        if self._page == page:
            self._alive_s = time.monotonic()

    def look_after(self) -> None:
        """Release control if the page in control has sent nothing for ``lost_s``. Thread-safe."""
        page = self._page
        if page is not None and time.monotonic() - self._alive_s > self._lost_s:
            self.leave(page)

    def act(self, page: int, what: str) -> bool:
        """Execute the request of a page. Return False if another page has control; raise
        ValueError if the request is unknown."""
        kind, _, name = what.partition(":")
        if what in self._does:
            does = self._does[what]
        elif kind == "mode" and name in {str(mode) for mode in self.controls.modes}:
            does = partial(self.controls.choose_mode, Mode(name))
        elif kind == "level":
            does = partial(self.controls.set_level, float(name))
        elif kind == "key" and name in self._keys:
            does = self._keys[name]
        else:
            raise ValueError(what)
        if not self.steer(page):
            return False
        does()
        return True


MOST_PAGES = 16
MOST_HZ = 60
MOST_MESSAGES_PER_S = 400  # limit for one page; a page that exceeds it is disconnected
_AT_ZERO = ("none", "pause")  # requests after which no current flows
_BEAT_S = 0.2  # longest pause between messages to a page; each answer shows that the page is alive
_INFORMED_WITHIN_S = 0.5


@dataclass
class ConnectedPage:
    """One connected browser page, and the state that it has received."""

    number: int
    waits: bool = True  # whether the page has drawn the last message and waits for the next
    ended: str = ""  # last message of the run; empty until the page receives it
    shown: StepResult | None = None
    events: int = 0
    sheet: int | None = None  # number of the sheet (page or line of print) on display
    refused: str = ""  # reason why the page's last request was refused
    received: int = 0  # number of messages received during ``second``
    second: int = 0


class PageState(Protocol):
    """State of a run, as JSON messages to browser pages."""

    @property
    def steering(self) -> Steering: ...
    @property
    def source(self) -> Source: ...
    @property
    def hello(self) -> str:
        """The first message of a run to each page."""

    @property
    def ended(self) -> str:
        """The last message of a run; empty during the run."""

    def sheet_png(self) -> bytes:
        """Return the page or line of print under the finger as PNG; empty if there is none."""

    def has_seen(self, page: ConnectedPage) -> bool:
        """Return whether a page has received the newest step and all events."""

    def update(self, page: ConnectedPage) -> str:
        """Return a message with everything that is new for a page."""


class Pages:
    """Connections of all browser pages of a window."""

    def __init__(self, state: PageState) -> None:
        import_server()
        self._state = state
        self._pages: dict[int, ConnectedPage] = {}
        self._numbers = itertools.count(1)
        self._over, self._all_informed = threading.Event(), threading.Event()

    def __len__(self) -> int:
        return len(self._pages)

    def routes(self) -> "list[BaseRoute]":
        """Return the routes of the server that pages use."""
        from starlette.routing import Route, WebSocketRoute

        return [
            WebSocketRoute("/socket", self._connected),
            Route("/stop", self._stopped, methods=["POST"]),
            Route("/sheet.png", self._sheet),
        ]

    def close(self) -> None:
        """Tell all pages that the run has ended, and close their connections."""
        self._over.set()
        if self._pages:
            self._all_informed.wait(_INFORMED_WITHIN_S)

    async def _sheet(self, request: "Request") -> "Response":
        from starlette.responses import Response

        png = await asyncio.to_thread(self._state.sheet_png)
        return Response(png, status_code=200 if png else 404, media_type="image/png")

    async def _stopped(self, request: "Request") -> "Response":
        """Stop the run for a page that has lost its connection."""
        from starlette.responses import Response

        # The server ends with the run, perhaps before this request is answered.
        with contextlib.suppress(asyncio.CancelledError):
            await self._stop()
        return Response(status_code=204)

    async def _stop(self) -> None:
        # A stop may wait for the board. Use a thread, so that other pages are served meanwhile.
        await asyncio.to_thread(self._state.steering.stop)

    async def _connected(self, socket: "WebSocket") -> None:
        from starlette.websockets import WebSocketDisconnect

        await socket.accept()
        if len(self._pages) >= MOST_PAGES or self._over.is_set():
            await socket.close(1013, "too many pages")
            return
        page = ConnectedPage(next(self._numbers))
        self._pages[page.number] = page
        feeding = asyncio.create_task(self._feed(socket, page))
        try:
            while True:
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                text = message.get("text")
                if text is None or not await self._take(page, text):
                    await socket.close(1008, "not understood")
                    break
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            feeding.cancel()
            del self._pages[page.number]
            self._state.steering.leave(page.number)
            if not self._pages and self._over.is_set():
                self._all_informed.set()
            # Ignore errors: the task fails if the connection is lost.
            await asyncio.gather(feeding, return_exceptions=True)

    async def _take(self, page: ConnectedPage, text: str) -> bool:
        """Execute a message of a page; return False if it is invalid."""
        steering, second = self._state.steering, int(time.monotonic())
        page.received = page.received + 1 if second == page.second else 1
        page.second = second
        if page.received > MOST_MESSAGES_PER_S:
            return False
        steering.note_alive(page.number)
        verb, _, rest = text.partition(" ")
        if text == "seen":
            page.waits = True
        elif verb == "move":
            return self._move(page, rest)
        elif text == "stop":
            await self._stop()
        elif text == "steer":
            steering.steer(page.number)
        elif text == "leave":
            steering.leave(page.number)
        elif verb == "do":
            try:
                await self._act(page, rest)
            except SmartTouchError as error:
                page.refused = str(error)
            except ValueError:
                return False
        else:
            return False
        return True

    def _move(self, page: ConnectedPage, place: str) -> bool:
        """Move the finger to the mouse pointer if the page has control. Return False if the place
        is invalid or the source does not follow the mouse pointer."""
        pointer = self._state.source.pointer
        try:
            x_mm, y_mm = map(float, place.split())
            if pointer is not None and self._state.steering.steer(page.number):
                pointer.move(x_mm, y_mm)
        except ValueError:
            return False
        return pointer is not None

    async def _act(self, page: ConnectedPage, what: str) -> None:
        steering = self._state.steering
        if what.startswith("key:"):
            # `act` may wait for the source. Use a thread, so that pages can stop the run meanwhile.
            await asyncio.to_thread(steering.act, page.number, what)
        elif not steering.act(page.number, what) and what in _AT_ZERO:
            # This page does not control the run, so it cannot set the current to zero: end the run.
            await self._stop()

    async def _feed(self, socket: "WebSocket", page: ConnectedPage) -> None:
        """Send the newest state to a page each time the page has drawn the previous state."""
        state, sent_s = self._state, 0.0
        await socket.send_text(state.hello)
        while True:
            ended, over = state.ended, self._over.is_set()
            idle = state.has_seen(page) and time.monotonic() - sent_s < _BEAT_S
            news = ended != page.ended
            if news or page.refused or (page.waits and not idle):
                sent_s, page.waits = time.monotonic(), False
                await socket.send_text(state.update(page))
            if news:
                page.ended = ended
                await socket.send_text(ended)
            if over:
                await socket.close(1000)
                return
            await asyncio.sleep(1 / MOST_HZ)
