"""Pages that are connected to a run: each is sent the newest state, and one has control."""

import asyncio
import contextlib
import itertools
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from smarttouch.running.step import StepResult
from smarttouch.sources.source import Source
from smarttouch.window.server import import_server
from smarttouch.window.steering import Steering

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.routing import BaseRoute
    from starlette.websockets import WebSocket

MOST_PAGES = 16
MOST_HZ = 60
MOST_MESSAGES_PER_S = 400  # limit for one page; one that sends more loses its connection
_BEAT_S = 0.2  # longest time without a message to a page: its answer says that it is alive
_INFORMED_WITHIN_S = 0.5


@dataclass
class Page:
    """One connected page, and what it has seen."""

    number: int
    waits: bool = True  # whether it has drawn what it was sent last
    shown: StepResult | None = None
    events: int = 0
    felt: str = ""
    drawn: int = 0  # changes of the drawing that it has seen
    received: int = 0  # messages of this second
    second: int = 0


class PageState(Protocol):
    """State of a run as JSON messages to pages."""

    @property
    def steering(self) -> Steering: ...
    @property
    def source(self) -> Source: ...
    @property
    def hello(self) -> str:
        """The first message."""

    @property
    def ended(self) -> str:
        """The last message."""

    def has_seen(self, page: Page) -> bool:
        """Return whether there is nothing new for a page."""

    def update(self, page: Page) -> str:
        """Return a message with all that a page has not seen yet."""


class Pages:
    """Connections of all pages of a run; ``over`` is set once the run is over."""

    def __init__(self, state: PageState) -> None:
        import_server()
        self._state = state
        self._pages: dict[int, Page] = {}
        self._numbers = itertools.count(1)
        self.over, self._all_informed = threading.Event(), threading.Event()

    def __len__(self) -> int:
        return len(self._pages)

    def routes(self) -> "list[BaseRoute]":
        """Return the addresses that pages talk to."""
        from starlette.routing import Route, WebSocketRoute

        return [
            WebSocketRoute("/socket", self._connected),
            Route("/stop", self._stopped, methods=["POST"]),
        ]

    def wait(self) -> None:
        """Wait briefly until all pages know that the run is over."""
        if self._pages:
            self._all_informed.wait(_INFORMED_WITHIN_S)

    async def _stopped(self, request: "Request") -> "Response":
        """Stop for a page that has lost its connection."""
        from starlette.responses import Response

        # The run, and with it the server, may end first.
        with contextlib.suppress(asyncio.CancelledError):
            await self._stop()
        return Response(status_code=204)

    async def _stop(self) -> None:
        # A board may wait for its line, which must not block other pages.
        await asyncio.to_thread(self._state.steering.stop)

    async def _connected(self, socket: "WebSocket") -> None:
        from starlette.websockets import WebSocketDisconnect

        await socket.accept()
        if len(self._pages) >= MOST_PAGES or self.over.is_set():
            await socket.close(1013, "too many pages")
            return
        page = Page(next(self._numbers))
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
            if not self._pages and self.over.is_set():
                self._all_informed.set()
            # It may have failed on the lost connection.
            await asyncio.gather(feeding, return_exceptions=True)

    async def _take(self, page: Page, text: str) -> bool:
        """Execute a page's message; return False if it is none."""
        steering, second = self._state.steering, int(time.monotonic())
        page.received = page.received + 1 if second == page.second else 1
        page.second = second
        if page.received > MOST_MESSAGES_PER_S:
            return False
        steering.note_alive(page.number)
        verb, _, rest = text.partition(" ")
        if text == "seen":
            page.waits = True
        elif text == "stop":
            await self._stop()
        elif text == "steer":
            steering.steer(page.number)
        elif text == "leave":
            steering.leave(page.number)
        elif verb in ("do", "draw"):
            try:
                await self._act(page, verb, rest)
            except ValueError:
                return False
        else:
            return False
        return True

    async def _act(self, page: Page, verb: str, rest: str) -> None:
        canvas, steering = self._state.source.canvas, self._state.steering
        if verb == "do" and rest.startswith("key:"):
            # It may wait for the source's line, which must not block a stop.
            await asyncio.to_thread(steering.act, page.number, rest)
        elif verb == "do":
            steering.act(page.number, rest)
        elif canvas is None:
            raise ValueError(rest)
        elif steering.steer(page.number):
            await asyncio.to_thread(canvas.draw, rest)

    async def _feed(self, socket: "WebSocket", page: Page) -> None:
        """Send a page the newest state whenever it has drawn the last one."""
        await socket.send_text(self._state.hello)
        sent_s = 0.0
        while True:
            await asyncio.sleep(1 / MOST_HZ)
            over, idle = self.over.is_set(), self._state.has_seen(page)
            if over or (page.waits and not (idle and time.monotonic() - sent_s < _BEAT_S)):
                sent_s, page.waits = time.monotonic(), False
                await socket.send_text(self._state.update(page))
            if over:
                await socket.send_text(self._state.ended)
                await socket.close(1000)
                return
