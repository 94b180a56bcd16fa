"""The window of a run: a listener that keeps the newest step, and pages that ask for it."""

import asyncio
import contextlib
import itertools
import json
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from smarttouch.delivered.live import LiveFinger
from smarttouch.drawing.source import DrawSource
from smarttouch.errors import DesignError, SmartTouchError
from smarttouch.events import Event, RunEnded, RunFailed
from smarttouch.physiology.finger import Finger
from smarttouch.realtime import prioritized
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult
from smarttouch.stopping import StopRequest
from smarttouch.window.pictures import array_message, felt_message, finger_message, picture_message
from smarttouch.window.server import PageServer, import_server, open_browser
from smarttouch.window.steering import Steering

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

MOST_PAGES = 16
MOST_HZ = 60
MOST_MESSAGES_PER_S = 400
"""Of one page; one that sends more loses its connection."""
_BEAT_S = 0.2
"""Longest time without a message to a page: its answer says that it is alive."""
_EVENTS = 200
_TOLD_WITHIN_S = 0.5
_LOOK_S = 0.02
_SWITCH_S = 0.0005


@dataclass
class _Page:
    """One page that is connected."""

    number: int
    waits: bool = True
    """Whether it has drawn what it was sent last."""
    shown: StepResult | None = None
    events: int = 0
    felt: str = ""
    drawn: int = 0
    """Changes of the drawing that it has seen."""
    heard: int = 0
    """Messages of this second."""
    second: int = 0


class Window(Listener):
    """Shows a run in a browser, from a thread of its own, and lets one page steer it.

    The loop's thread only leaves the newest step where pages find it.

    Parameters
    ----------
    stop : StopRequest
    port : int
        Of 127.0.0.1; 0: one that is free.
    keys : mapping of str to callable, optional
        Functions of single keys of the source.
    keys_help : str
        Words on them.
    alone : bool
        Whether there are no other controls: a run that no page steers any more is then paused.
    blind : bool
        Whether whoever looks must not see what is delivered.
    finger : int, optional
        Seed of the finger that is simulated; none if None.
    anatomy : str
        Of the finger.
    show : callable, optional
        Given the address once it is served.
    """

    def __init__(
        self,
        stop: StopRequest,
        port: int = 0,
        *,
        keys: Mapping[str, Callable[[], None]] | None = None,
        keys_help: str = "",
        alone: bool = True,
        blind: bool = False,
        finger: int | None = 1,
        anatomy: str = "branched",
        show: Callable[[str], object] | None = None,
    ) -> None:
        super().__init__()
        import_server()
        from starlette.routing import Route, WebSocketRoute

        self._run_stop, self._keys, self._keys_help = stop, keys or {}, keys_help
        self._alone, self._blind, self._show = alone, blind, show or _announce
        self._seed, self._anatomy = finger, anatomy
        self.server = PageServer(
            port,
            [
                WebSocketRoute("/socket", self._connected),
                Route("/stop", self._stopped, methods=["POST"]),
            ],
        )
        self.steering: Steering | None = None
        self._latest: StepResult | None = None
        self._encoded: tuple[StepResult | None, str] = (None, "null")
        self._events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_EVENTS)
        self._event_count = 0
        self._event_lock = threading.Lock()
        self._pages: dict[int, _Page] = {}
        self._numbers = itertools.count(1)
        self._over, self._all_told = threading.Event(), threading.Event()
        self._live: LiveFinger | None = None
        self._felt = ""
        self._switch_s: float | None = None
        self._ended: dict[str, Any] = {"type": "ended", "reason": "", "failed": False}

    @property
    def address(self) -> str:
        """Address of the page, with its secret."""
        return self.server.address

    @property
    def pages(self) -> int:
        """Number of pages that are connected."""
        return len(self._pages)

    def prepare(self, run: RunContext) -> None:
        """Serve the page, and begin to simulate a finger for it."""
        self._context = run
        self.steering = Steering(run.controls, self._run_stop, self._keys, alone=self._alone)
        finger = self._finger(run)
        hello: dict[str, Any] = {
            "type": "hello",
            "blind": self._blind,
            "draws": isinstance(run.source, DrawSource),
            "board": str(run.settings.get("board", "")),
            "modes": [str(each) for each in run.controls.modes],
            "keys": list(self._keys),
            "keys_help": self._keys_help,
            "array": array_message(run.profile),
            "finger": None if finger is None else finger_message(finger),
        }
        self._hello = json.dumps(hello)
        # Whoever draws must not hold the loop up for a whole default interval of 5 ms.
        if sys.getswitchinterval() > _SWITCH_S:
            self._switch_s = sys.getswitchinterval()
            sys.setswitchinterval(_SWITCH_S)
        self.server.start()
        if finger is not None:
            self._live = LiveFinger(finger)
            threading.Thread(target=self._feel, args=(self._live,), daemon=True).start()
        self._show(self.address)

    def step(self, result: StepResult) -> None:
        """Keep the newest; and see whether whoever steers is still there."""
        self._latest = result
        if self.steering is not None:
            self.steering.look_after()

    def event(self, event: Event) -> None:
        """Keep an event for the pages, unless it would tell an answer."""
        if isinstance(event, RunEnded | RunFailed):
            failed = isinstance(event, RunFailed)
            self._ended |= {"reason": str(event), "failed": failed}
        if self._blind and event.reveals:
            return
        told = {"time_s": event.time_ns / 1e9, "text": str(event), "kind": type(event).__name__}
        with self._event_lock:
            self._event_count += 1
            self._events.append((self._event_count, told))

    def close(self) -> None:
        """Tell pages that the run is over, and serve no more."""
        if self._over.is_set():
            return
        self._over.set()
        if self._live is not None:
            self._live.abandon()
        if self._pages:
            self._all_told.wait(_TOLD_WITHIN_S)
        self.server.close()
        if self._switch_s is not None:
            sys.setswitchinterval(self._switch_s)

    def _finger(self, run: RunContext) -> Finger | None:
        if self._blind or self._seed is None:
            return None
        try:
            return Finger(run.profile, self._seed, self._anatomy)
        except DesignError as error:
            self.notes.append(f"the window shows no finger: {error}")
            return None

    @prioritized()
    def _feel(self, live: LiveFinger) -> None:
        """Let the finger feel the newest step whenever it is idle, while somebody looks."""
        latest = feeling = None
        try:
            live.prepare(self._context)
            while not self._over.wait(_LOOK_S):
                if self._latest is not None and self._latest is not latest and self._pages:
                    latest = self._latest
                    live.step(latest)
                if live.newest is not None and live.newest is not feeling:
                    feeling = live.newest
                    self._felt = json.dumps(felt_message(feeling))
        except SmartTouchError as error:
            # What is delivered does not depend on it.
            if not self._over.is_set():
                self.notes.append(f"the window shows no finger any more: {error}")
        finally:
            live.close()

    async def _stopped(self, request: "Request") -> "Response":
        """Stop where a page has lost its connection."""
        from starlette.responses import Response

        # The end that is asked for may come first, and the server's with it.
        with contextlib.suppress(asyncio.CancelledError):
            await self._stop()
        return Response(status_code=204)

    async def _stop(self) -> None:
        assert self.steering is not None
        # A board may wait for its line: nobody else is to wait for that.
        await asyncio.to_thread(self.steering.stop)

    async def _connected(self, socket: "WebSocket") -> None:
        from starlette.websockets import WebSocketDisconnect

        await socket.accept()
        if len(self._pages) >= MOST_PAGES or self._over.is_set():
            await socket.close(1013, "too many pages")
            return
        assert self.steering is not None
        page = _Page(next(self._numbers))
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
            self.steering.leave(page.number)
            if not self._pages and self._over.is_set():
                self._all_told.set()
            # It may have failed on the lost connection.
            await asyncio.gather(feeding, return_exceptions=True)

    async def _take(self, page: _Page, text: str) -> bool:
        """Do what a page says; return False if that is no message."""
        assert self.steering is not None
        second = int(time.monotonic())
        page.heard = page.heard + 1 if second == page.second else 1
        page.second = second
        if page.heard > MOST_MESSAGES_PER_S:
            return False
        self.steering.hear(page.number)
        verb, _, rest = text.partition(" ")
        if text == "seen":
            page.waits = True
        elif text == "stop":
            await self._stop()
        elif text == "steer":
            self.steering.steer(page.number)
        elif text == "leave":
            self.steering.leave(page.number)
        elif verb in ("do", "draw"):
            try:
                await self._act(page, verb, rest)
            except ValueError:
                return False
        else:
            return False
        return True

    async def _act(self, page: _Page, verb: str, rest: str) -> None:
        assert self.steering is not None
        source = self._context.source
        if verb == "do" and rest.startswith("key:"):
            # It may wait for the source's line: a stop must not wait for that.
            await asyncio.to_thread(self.steering.act, page.number, rest)
        elif verb == "do":
            self.steering.act(page.number, rest)
        elif not isinstance(source, DrawSource):
            raise ValueError(rest)
        elif self.steering.steer(page.number):
            await asyncio.to_thread(source.draw, rest)

    async def _feed(self, socket: "WebSocket", page: _Page) -> None:
        """Send the newest to one page whenever it has drawn what it has."""
        await socket.send_text(self._hello)
        sent_s = 0.0
        while True:
            await asyncio.sleep(1 / MOST_HZ)
            over = self._over.is_set()
            idle = self._latest is page.shown and page.events == self._event_count
            if over or (page.waits and not (idle and time.monotonic() - sent_s < _BEAT_S)):
                sent_s, page.waits = time.monotonic(), False
                await socket.send_text(self._update(page))
            if over:
                await socket.send_text(json.dumps(self._ended))
                await socket.close(1000)
                return

    def _update(self, page: _Page) -> str:
        """Return a message with all that a page has not seen yet."""
        latest = self._latest
        with self._event_lock:
            count, kept = self._event_count, [*self._events]
        events = [told for number, told in kept if number > page.events]
        state = {**self._state(page, latest), "events": events}
        parts = [f'"type":"update","state":{json.dumps(state)}']
        if latest is not None and latest is not page.shown and not self._blind:
            if self._encoded[0] is not latest:
                self._encoded = latest, json.dumps(picture_message(latest))
            parts.append(f'"picture":{self._encoded[1]}')
        if self._felt is not page.felt:
            page.felt = self._felt
            parts.append(f'"felt":{self._felt}')
        source = self._context.source
        if isinstance(source, DrawSource) and source.changes != page.drawn:
            drawn = source.message()
            page.drawn = drawn["changes"]
            parts.append(f'"drawn":{json.dumps(drawn)}')
        page.shown, page.events = latest, count
        return "{" + ",".join(parts) + "}"

    def _state(self, page: _Page, latest: StepResult | None) -> dict[str, Any]:
        assert self.steering is not None
        run, steers = self._context, self.steering.page
        time_ns = 0 if latest is None else latest.input.time_ns
        now, dose, statistics = run.controls.state(time_ns), run.board.dose, run.statistics
        force_n = 0.0 if latest is None else latest.input.force_n
        state = {
            "title": run.source.title,
            "time_s": time_ns / 1e9,
            "level": now.level,
            "most": run.controls.most,
            "mode": str(now.mode),
            "paused": now.paused,
            "steers": "nobody" if steers is None else "you" if steers == page.number else "another",
            "force_n": force_n if force_n == force_n else None,
        }
        if self._blind:
            # Whether anything flows, and how often, may be what is asked about.
            return state
        return state | {
            "dose_s": dose.seconds,
            "dose_mc": dose.most_mc,
            "sequences": statistics.frames,
            "acknowledged": run.board.acknowledged,
            "late": statistics.late,
            "work_share": statistics.work_share,
        }


def _announce(address: str) -> None:
    print(f"window: {address}", file=sys.stderr, flush=True)
    open_browser(address)
