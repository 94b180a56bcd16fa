"""The window of a run: a listener that keeps the newest step, for pages that ask for it."""

import json
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from smarttouch.base.clock import prioritized
from smarttouch.base.errors import DesignError, SmartTouchError
from smarttouch.base.events import Event, RunEnded, RunFailed
from smarttouch.base.stopping import StopRequest
from smarttouch.physiology.finger import Finger
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Source
from smarttouch.views.live_finger import LiveFinger
from smarttouch.views.window_messages import (
    array_message,
    finger_message,
    picture_message,
    response_message,
)
from smarttouch.views.window_pages import ConnectedPage, Pages, Steering
from smarttouch.views.window_server import PageServer, open_browser

_EVENTS = 200
_LOOK_S = 0.02
_SWITCH_S = 0.0005


class Window(Listener):
    """Shows a run in a browser, from a thread of its own, and lets one page control it.

    The loop's thread only stores the newest step. Port 0 of 127.0.0.1 is a free one. With
    ``alone``, a run is paused once no page controls it; with ``blind``, pages do not show what is
    delivered. ``finger`` is the seed and the anatomy of a simulated finger, None for none. ``show``
    is called with the address once it is served.
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
        finger: tuple[int, str] | None = (1, "branched"),
        show: Callable[[str], object] | None = None,
    ) -> None:
        super().__init__()
        self._run_stop, self._keys, self._keys_help = stop, keys or {}, keys_help
        self._alone, self._blind, self._show = alone, blind, show or _announce
        self._simulated = finger
        self._pages = Pages(self)
        self.server: PageServer = PageServer(port, self._pages.routes())
        self.steering: Steering
        self.hello: str = ""
        self._latest: StepResult | None = None
        self._encoded: tuple[StepResult | None, str] = (None, "null")
        self._events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_EVENTS)
        self._event_count = 0
        self._event_lock = threading.Lock()
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

    @property
    def source(self) -> Source:
        return self._context.source

    @property
    def ended(self) -> str:
        return json.dumps(self._ended)

    def prepare(self, run: RunContext) -> None:
        self._context = run
        self.steering = Steering(run.controls, self._run_stop, self._keys, alone=self._alone)
        finger = self._finger(run)
        hello: dict[str, Any] = {
            "type": "hello",
            "blind": self._blind,
            "draws": run.source.canvas is not None,
            "board": str(run.settings.get("board", "")),
            "modes": [str(each) for each in run.controls.modes],
            "keys": list(self._keys),
            "keys_help": self._keys_help,
            "array": array_message(run.profile),
            "finger": None if finger is None else finger_message(finger),
        }
        self.hello = json.dumps(hello)
        # Drawing must not hold the loop up for a whole default interval of 5 ms.
        if sys.getswitchinterval() > _SWITCH_S:
            self._switch_s = sys.getswitchinterval()
            sys.setswitchinterval(_SWITCH_S)
        self.server.start()
        if finger is not None:
            self._live = LiveFinger(finger)
            threading.Thread(target=self._feel, args=(self._live,), daemon=True).start()
        self._show(self.address)

    def step(self, result: StepResult) -> None:
        """Keep the newest step, and check that the page in control is alive."""
        self._latest = result
        self.steering.look_after()

    def event(self, event: Event) -> None:
        """Keep an event for the pages, unless it would give an answer away."""
        if isinstance(event, RunEnded | RunFailed):
            failed = isinstance(event, RunFailed)
            self._ended |= {"reason": str(event), "failed": failed}
        if self._blind and event.reveals:
            return
        entry = {"time_s": event.time_ns / 1e9, "text": str(event), "kind": type(event).__name__}
        with self._event_lock:
            self._event_count += 1
            self._events.append((self._event_count, entry))

    def close(self) -> None:
        """Send pages the end of the run, and stop serving."""
        if self._pages.over.is_set():
            return
        self._pages.over.set()
        if self._live is not None:
            self._live.abandon()
        self._pages.wait()
        self.server.close()
        if self._switch_s is not None:
            sys.setswitchinterval(self._switch_s)

    def _finger(self, run: RunContext) -> Finger | None:
        if self._blind or self._simulated is None:
            return None
        try:
            return Finger(run.profile, *self._simulated)
        except DesignError as error:
            self.notes.append(f"the window shows no finger: {error}")
            return None

    @prioritized()
    def _feel(self, live: LiveFinger) -> None:
        """Simulate the newest step whenever the finger's process is idle and a page is
        connected."""
        latest = feeling = None
        try:
            live.prepare(self._context)
            while not self._pages.over.wait(_LOOK_S):
                if self._latest is not None and self._latest is not latest and self._pages:
                    latest = self._latest
                    live.step(latest)
                if live.newest is not None and live.newest is not feeling:
                    feeling = live.newest
                    self._felt = json.dumps(response_message(feeling))
        except SmartTouchError as error:
            # Delivery does not depend on it.
            if not self._pages.over.is_set():
                self.notes.append(f"the window shows no finger any more: {error}")
        finally:
            live.close()

    def has_seen(self, page: ConnectedPage) -> bool:
        return self._latest is page.shown and page.events == self._event_count

    def update(self, page: ConnectedPage) -> str:
        latest = self._latest
        with self._event_lock:
            count, kept = self._event_count, [*self._events]
        events = [entry for number, entry in kept if number > page.events]
        state = {**self._state(page, latest), "events": events}
        parts = [f'"type":"update","state":{json.dumps(state)}']
        if latest is not None and latest is not page.shown and not self._blind:
            if self._encoded[0] is not latest:
                self._encoded = latest, json.dumps(picture_message(latest))
            parts.append(f'"picture":{self._encoded[1]}')
        if self._felt is not page.felt:
            page.felt = self._felt
            parts.append(f'"felt":{self._felt}')
        canvas = self.source.canvas
        if canvas is not None and canvas.changes != page.drawn:
            drawn = canvas.message()
            page.drawn = drawn["changes"]
            parts.append(f'"drawn":{json.dumps(drawn)}')
        page.shown, page.events = latest, count
        return "{" + ",".join(parts) + "}"

    def _state(self, page: ConnectedPage, latest: StepResult | None) -> dict[str, Any]:
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
            # Whether and how often current flows may be what the subject is asked.
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
