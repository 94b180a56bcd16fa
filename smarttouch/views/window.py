"""The window of a run: a listener that keeps the newest step, for pages that ask for it."""

import contextlib
import json
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smarttouch.base.clock import prioritized
from smarttouch.base.errors import DesignError, SmartTouchError
from smarttouch.base.events import Event, IntensityChanged, Marked, ModeChanged, RunEnded, RunFailed
from smarttouch.base.stopping import RunStopped, StopRequest
from smarttouch.physiology.finger import Finger
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Source
from smarttouch.views.live_finger import MOST_RECENT, LiveFinger
from smarttouch.views.window_messages import (
    array_message,
    finger_message,
    picture_message,
    response_message,
    sheet_message,
    sheet_png,
)
from smarttouch.views.window_pages import ConnectedPage, Pages, Steering
from smarttouch.views.window_server import PageServer, open_browser

if TYPE_CHECKING:
    from smarttouch.running.recorder import Recorder

SPIKES_OVER_S = 0.1  # time over which spikes are counted
_MOST_NOTE = 200  # characters
_EVENTS = 200
_LOOK_S = 0.02
_SWITCH_S = 0.0005
_GONE_S = 2.0  # time without a page after which the window is closed: a page may be loaded again
_FINGER_WITHIN_S = 2.5  # a finger that takes longer appears while the run goes on


class Window(Listener):
    """Shows runs in a browser, from a thread of its own, and lets one page control them.

    The loop's thread only stores the newest step. Port 0 of 127.0.0.1 is a free one. With
    ``alone``, a run is paused once no page controls it; with ``blind``, pages do not show what is
    delivered. ``finger`` is the seed and the anatomy of a simulated finger, None for none. ``show``
    is called with the address once it is served. A run begins once the finger is ready and a page
    is open, or after ``waits_s``. A window that ``stays`` shows the end of a run until `shut`.
    """

    def __init__(
        self,
        stop: StopRequest,
        port: int = 0,
        *,
        blind: bool = False,
        finger: tuple[int, str] | None = (1, "branched"),
        show: Callable[[str], object] | None = None,
        waits_s: float = 0.0,
        stays: bool = False,
        keys: Mapping[str, Callable[[], None]] | None = None,
        keys_help: str = "",
        alone: bool = True,
    ) -> None:
        super().__init__()
        self._blind, self._show, self._simulated = blind, show or _announce, finger
        self._waits_s, self._stays = waits_s, stays
        self._pages = Pages(self)
        self.server: PageServer = PageServer(port, self._pages.routes())
        self.steering: Steering
        self.hello: str = ""
        self.ended: str = ""  # how the run ended, as a message to pages; empty while it is on
        self._event_lock = threading.Lock()
        self._live: LiveFinger | None = None
        self._finger_ready = threading.Event()
        self._switch_s: float | None = None
        self._shut = threading.Event()
        self._run_stop, self._keys, self._keys_help = stop, keys or {}, keys_help
        self._alone = alone
        self._latest: StepResult | None = None
        self._encoded: tuple[StepResult | None, str] = (None, "null")
        self._events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_EVENTS)
        self._event_count = 0
        self._recent: deque[StepResult] = deque(maxlen=MOST_RECENT)
        self._recording: Recorder | None = None
        self._felt = ""
        self._end: tuple[str, bool] = ("", False)
        self._marks = 0

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

    def prepare(self, run: RunContext) -> None:
        """Serve the page, and wait for it and for the finger: the board is not open."""
        self._context = run
        self.steering = Steering(run.controls, self._run_stop, self._keys, alone=self._alone)
        if run.source.pointer is not None:
            run.source.pointer.is_shown = True
        finger = self._finger(run)
        hello: dict[str, Any] = {
            "type": "hello",
            "blind": self._blind,
            "board": str(run.settings.get("board", "")),
            "moves": run.source.pointer is not None,
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
        if finger is None:
            self._finger_ready.set()
        else:
            self._live = LiveFinger(finger, over_s=SPIKES_OVER_S)
            threading.Thread(target=self._feel, args=(self._live,), daemon=True).start()
        self._show(self.address)
        self._wait_for_page()

    def _wait_for_page(self) -> None:
        """Wait until the finger is ready and a page is open, or for as long as the window waits."""
        if not self._waits_s:
            return
        begun_s = time.monotonic()
        while (waited_s := time.monotonic() - begun_s) < self._waits_s:
            ready = self._finger_ready.is_set() or waited_s > _FINGER_WITHIN_S
            if ready and self._pages:
                return
            if self._run_stop.event.wait(_LOOK_S):
                raise RunStopped(signal.SIGTERM, self._run_stop.reason)

    def step(self, result: StepResult) -> None:
        """Keep the newest step, and check that the page in control is alive."""
        self._latest = result
        self._recent.append(result)
        recording = self._recording
        if recording is not None:
            recording.step(result)
        self.steering.look_after()

    def event(self, event: Event) -> None:
        """Keep an event for the pages, unless it would reveal an answer."""
        if isinstance(event, RunEnded | RunFailed):
            self._end = str(event), isinstance(event, RunFailed)
        recording = self._recording
        if recording is not None:
            recording.event(event)
        if self._blind and event.reveals:
            return
        entry = {"time_s": event.time_ns / 1e9, "text": str(event), "kind": type(event).__name__}
        with self._event_lock:
            self._event_count += 1
            self._events.append((self._event_count, entry))

    def close(self) -> None:
        """Send pages the end of the run; stop serving, unless the window stays."""
        if not self.ended:
            reason, failed = self._end
            self.ended = json.dumps({"type": "ended", "reason": reason, "failed": failed})
        if self._switch_s is not None:
            sys.setswitchinterval(self._switch_s)
            self._switch_s = None
        if not self._stays:
            self.shut()
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()

    def stay(self) -> None:
        """Show the end of a run until all pages are closed, or until Ctrl-C."""
        seen_s = time.monotonic()
        with contextlib.suppress(RunStopped, KeyboardInterrupt):
            while time.monotonic() - seen_s < _GONE_S:
                if self._pages:
                    seen_s = time.monotonic()
                time.sleep(_LOOK_S)

    def shut(self) -> None:
        """Close all connections, and stop serving."""
        if self._shut.is_set():
            return
        self._shut.set()
        if self._live is not None:
            self._live.abandon()
        self._pages.close()
        self.server.close()

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
        """Simulate the newest steps whenever the finger's process is idle."""
        feeling = None
        try:
            live.prepare(self._context)
            self._finger_ready.set()
            while not self._shut.wait(_LOOK_S):
                while self._recent:
                    live.step(self._recent.popleft())
                if live.newest is not None and live.newest is not feeling:
                    feeling, felt = live.newest, live.felt
                    assert felt is not None
                    self._felt = json.dumps(response_message(feeling, felt.input.pose))
        except SmartTouchError as error:
            # Delivery does not depend on it.
            if not self._shut.is_set():
                self.notes.append(f"the window shows no finger any more: {error}")
                self._finger_ready.set()
        finally:
            live.close()

    def ask(self, page: int, verb: str, text: str) -> None:
        """Do what a page asks for: a recording begun or ended, or a note.

        Raises SmartTouchError with why it is refused, ValueError for what is no request.
        """
        if self.ended:
            raise SmartTouchError("the run is over")
        if not self.steering.steer(page):
            raise SmartTouchError("another page steers this run: only that one can do this")
        if verb == "record":
            self._record()
        else:
            self._note(text)

    def _note(self, text: str) -> None:
        text = text.strip()
        if len(text) > _MOST_NOTE or not text.isprintable():
            raise SmartTouchError(
                f"a note of {len(text)} characters is not kept: type one line of at most "
                f"{_MOST_NOTE}"
            )
        self._marks += 1
        self.source.emit(Marked(self._time_ns, text or f"mark {self._marks}"))

    def _record(self) -> None:
        """Begin a recording of the run beside where it was started, or end it."""
        from smarttouch.running.recorder import Recorder

        recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()
            return
        number = 1
        while (path := Path(f"recording-{number}.mcap")).exists():
            number += 1
        # Steps may pass while the file is opened: even before the first, the start may be missed.
        begun = Recorder(path, begun_ns=max(1, self._time_ns))
        begun.start(self._context)
        now = self._context.controls.state(self._time_ns)
        begun.event(IntensityChanged(self._time_ns, now.level))
        begun.event(ModeChanged(self._time_ns, now.mode))
        self._recording = begun

    @property
    def _time_ns(self) -> int:
        return 0 if self._latest is None else self._latest.input.time_ns

    def sheet_png(self) -> bytes:
        sheet = None if self._blind else self.source.sheet
        return b"" if sheet is None else sheet_png(sheet)

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
        if self._felt and self._felt is not page.felt:
            page.felt = self._felt
            parts.append(f'"felt":{self._felt}')
        sheet = None if self._blind else self.source.sheet
        if sheet is not None and sheet.number != page.sheet:
            page.sheet = sheet.number
            parts.append(f'"sheet":{json.dumps(sheet_message(sheet))}')
        if page.refused:
            parts.append(f'"refused":{json.dumps(page.refused)}')
            page.refused = ""
        page.shown, page.events = latest, count
        return "{" + ",".join(parts) + "}"

    def _phase(self, latest: StepResult | None) -> str:
        if self.ended:
            return "ended"
        if not self._finger_ready.is_set() and latest is None:
            return "preparing the finger"
        return "running" if latest is not None else "starting"

    def _state(self, page: ConnectedPage, latest: StepResult | None) -> dict[str, Any]:
        run, steers = self._context, self.steering.page
        time_ns = 0 if latest is None else latest.input.time_ns
        now, dose, statistics = run.controls.state(time_ns), run.board.dose, run.statistics
        force_n = 0.0 if latest is None else latest.input.force_n
        recording = self._recording
        state = {
            "title": run.source.title,
            "phase": self._phase(latest),
            "time_s": time_ns / 1e9,
            "words": run.source.words,
            "recording": "" if recording is None else recording.path.name,
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
    print(f"window: {address} (the run begins once it is open)", file=sys.stderr, flush=True)
    open_browser(address)
