"""Window of a run: a listener that stores the newest step for pages in a browser."""

import base64
import contextlib
import json
import math
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.events import Event, RunEnded, RunFailed
from smarttouch.base.stopping import RunStopped, StopRequest
from smarttouch.profile import Profile
from smarttouch.running.step_records import Listener, RunContext, StepResult
from smarttouch.sources.source_contract import Pose, Sheet, Source
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.views.connected_pages import LOST_S, ConnectedPage, Pages, Steering
from smarttouch.views.window_server import PageServer, open_browser

MOST_PIXELS = 160  # longer side of the sensor's image, pixels; larger images are reduced
_MOST_SHEET_PX = 1600
_DIGITS = 4
Message = dict[str, Any]
_EVENTS = 200
_LOOK_S = 0.02
_SWITCH_S = 0.0005
_GONE_S = 2.0  # time without a page after which the window closes; a reload takes less


class Window(Listener):
    """View of a run in a browser. One page at a time has control.

    The run begins when a page is open, or after ``waits_s``. ``show`` receives the address of the
    page. With ``blind``, pages hide the stimulus. A page that sends nothing for ``lost_s`` is lost,
    and loses control. ``alone`` means that no terminal controls the run. Then the run pauses when a
    page gives up or loses control. With ``stays``, pages show the end of the run until `shut`.
    """

    def __init__(
        self,
        stop: StopRequest,
        *,
        blind: bool = False,
        show: Callable[[str], object] | None = None,
        waits_s: float = 0.0,
        stays: bool = False,
        keys: Mapping[str, Callable[[], None]] | None = None,
        keys_help: str = "",
        alone: bool = True,
        lost_s: float = LOST_S,
    ) -> None:
        super().__init__()
        self._blind, self._show = blind, show or _announce
        self._waits_s, self._stays = waits_s, stays
        self._pages = Pages(self)
        self.server: PageServer = PageServer(self._pages.routes())
        self.steering: Steering
        self.hello: str = ""
        self.ended: str = ""  # message about the end of the run; empty during the run
        self._event_lock = threading.Lock()
        self._switch_s: float | None = None
        self._shut = threading.Event()
        self._run_stop, self._keys, self._keys_help = stop, keys or {}, keys_help
        self._alone, self._lost_s = alone, lost_s
        self._latest: StepResult | None = None
        self._encoded: tuple[StepResult | None, str] = (None, "null")
        self._events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_EVENTS)
        self._event_count = 0
        self._end: tuple[str, bool] = ("", False)

    @property
    def address(self) -> str:
        """Address of the page, with the secret."""
        return self.server.address

    @property
    def pages(self) -> int:
        """Number of connected pages."""
        return len(self._pages)

    @property
    def source(self) -> Source:
        return self._context.source

    def prepare(self, run: RunContext) -> None:
        """Serve the page, and wait until a browser opens it. The run then opens the board."""
        self._context = run
        self.steering = Steering(
            run.controls, self._run_stop, self._keys, alone=self._alone, lost_s=self._lost_s
        )
        if run.source.pointer is not None:
            run.source.pointer.is_shown = True
        hello: dict[str, Any] = {
            "type": "hello",
            "blind": self._blind,
            "board": str(run.settings.get("board", "")),
            "moves": run.source.pointer is not None,
            "modes": [str(mode) for mode in run.controls.modes],
            "keys": list(self._keys),
            "keys_help": self._keys_help,
            "array": array_message(run.profile),
        }
        self.hello = json.dumps(hello)
        # With Python's default switch interval, drawing could delay the run loop by 5 ms.
        if sys.getswitchinterval() > _SWITCH_S:
            self._switch_s = sys.getswitchinterval()
            sys.setswitchinterval(_SWITCH_S)
        self.server.start()
        self._show(self.address)
        self._wait_for_page()

    def _wait_for_page(self) -> None:
        """Wait until a browser has opened the page, at most ``waits_s``."""
        until_s = time.monotonic() + self._waits_s
        while not self._pages and time.monotonic() < until_s:
            if self._run_stop.event.wait(_LOOK_S):
                raise RunStopped(signal.SIGTERM, self._run_stop.reason)

    def step(self, result: StepResult) -> None:
        """Store the newest step, and check that the page in control is alive."""
        self._latest = result
        self.steering.look_after()

    def event(self, event: Event) -> None:
        """Store an event for the pages. With ``blind``, omit events that reveal answers."""
        if isinstance(event, RunEnded | RunFailed):
            self._end = str(event), isinstance(event, RunFailed)
        if self._blind and event.reveals:
            return
        entry = {"time_s": event.time_ns / 1e9, "text": str(event), "kind": type(event).__name__}
        with self._event_lock:
            self._event_count += 1
            self._events.append((self._event_count, entry))

    def close(self) -> None:
        """Tell the pages that the run has ended. Stop serving, unless ``stays`` is set."""
        if not self.ended:
            reason, failed = self._end
            self.ended = json.dumps({"type": "ended", "reason": reason, "failed": failed})
        if self._switch_s is not None:
            sys.setswitchinterval(self._switch_s)
            self._switch_s = None
        if not self._stays:
            self.shut()

    def stay(self) -> None:
        """Show the end of the run until all pages are closed or the user presses Ctrl-C."""
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
        self._pages.close()
        self.server.close()

    def sheet_png(self) -> bytes:
        sheet = None if self._blind else self.source.sheet
        return b"" if sheet is None else sheet_png(sheet)

    def has_seen(self, page: ConnectedPage) -> bool:
        return self._latest is page.shown and page.events == self._event_count

    def update(self, page: ConnectedPage) -> str:
        latest = self._latest
        with self._event_lock:
            count, new_events = self._event_count, [*self._events]
        events = [entry for number, entry in new_events if number > page.events]
        state = {**self._state(page, latest), "events": events}
        parts = [f'"type":"update","state":{json.dumps(state)}']
        if latest is not None and latest is not page.shown and not self._blind:
            if self._encoded[0] is not latest:
                self._encoded = latest, json.dumps(picture_message(latest))
            parts.append(f'"picture":{self._encoded[1]}')
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
        return "running" if latest is not None else "starting"

    def _state(self, page: ConnectedPage, latest: StepResult | None) -> dict[str, Any]:
        run, steers = self._context, self.steering.page
        time_ns = 0 if latest is None else latest.input.time_ns
        now, dose, statistics = run.controls.state(time_ns), run.board.dose, run.statistics
        force_n = 0.0 if latest is None else latest.input.force_n
        state = {
            "title": run.source.title,
            "phase": self._phase(latest),
            "time_s": time_ns / 1e9,
            "words": run.source.words,
            "level": now.level,
            "most": run.controls.most,
            "mode": str(now.mode),
            "paused": now.paused,
            "steers": "nobody" if steers is None else "you" if steers == page.number else "another",
            "force_n": force_n if force_n == force_n else None,
        }
        if self._blind:
            # Hide the current: the question to the participant may be about the current.
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
    print(f"window: {address} (open it to begin the run)", file=sys.stderr, flush=True)
    open_browser(address)


def array_message(profile: Profile) -> Message:
    """Return the electrode array and the limits of a profile as a message to pages."""
    electrodes, limits = profile.electrodes, profile.limits
    radius_mm = 0.42 * min(*electrodes.cell_mm, electrodes.pitch_mm)
    return {
        "profile": profile.title,
        "place_mm": electrodes.position_mm.round(_DIGITS).tolist(),
        "extent_mm": [round(side_mm, _DIGITS) for side_mm in electrodes.extent_mm],
        "field_mm": [float(profile.optics.field_width_mm), float(profile.optics.field_height_mm)],
        "radius_mm": round(radius_mm, _DIGITS),
        "full_ma": float(profile.full_ma.max()),
        "full_n": float(profile.force.full_n),
        "limits": {
            "current_ma": float(limits.current_ma),
            "charge_uc": float(limits.charge_uc),
            "session_s": float(limits.session_s),
            "session_mc": float(limits.session_mc),
        },
    }


def picture_message(sent: StepResult) -> Message:
    """Return the image and the scan sequence of one step as a message to pages."""
    step, stimulus, sequence = sent.step, sent.step.input, sent.step.sequence
    picture = {
        "time_s": stimulus.time_ns / 1e9,
        "number": sent.number,
        "mode": str(step.mode),
        "pose": _pose(stimulus.pose),
        "force_n": _number(stimulus.force_n),
        "age_ms": stimulus.age_ns / 1e6,
        "latency_ms": stimulus.age_ns / 1e6 + sent.latency_us / 1e3,
        "pulse_ms": sent.first_pulse and sent.first_pulse.latency_us / 1e3,
        **sequence_message(sequence),
    }
    if stimulus.image is not None:
        picture["image"] = _image(stimulus.image)
    return picture


def sequence_message(sequence: ScanSequence) -> Message:
    """Return the currents of a scan sequence as a message to pages; positive is cathodic."""
    peak_ma = float(np.abs(sequence.current_ua.astype(np.int32)).max(initial=0)) / 1000
    return {
        "slots": sequence.slots,
        "points": sequence.points,
        "period_us": sequence.period_us,
        "intensity": float(sequence.intensity),
        "peak_ma": peak_ma,
        "charge_uc": peak_ma * float(sequence.width_us.max(initial=0)) / 1000,
        "current_ua": _base64(sequence.current_ua.astype("<i2")),
        "width_us": sequence.width_us.tolist(),
        "site": sequence.site.tolist(),
    }


def _image(image: NDArray[np.uint8]) -> Message:
    longer = max(image.shape)
    if longer > MOST_PIXELS:
        height, width = (max(1, round(side * MOST_PIXELS / longer)) for side in image.shape)
        image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))
    return {"height": image.shape[0], "width": image.shape[1], "grey": _base64(image)}


def sheet_message(sheet: Sheet) -> Message:
    """Return a message with the number, size and top left corner of a page or line."""
    return {
        "number": sheet.number,
        "size_mm": [round(length_mm, _DIGITS) for length_mm in sheet.page.size_mm],
        "corner_mm": [round(length_mm, _DIGITS) for length_mm in sheet.corner_mm],
    }


def sheet_png(sheet: Sheet) -> bytes:
    """Return the picture of a page or line of print as PNG, at most 1600 pixels long."""
    grey = sheet.page.grey
    scale = min(1.0, _MOST_SHEET_PX / max(grey.shape))
    if scale < 1:
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return cv2.imencode(".png", grey)[1].tobytes()


def _pose(pose: Pose) -> list[float]:
    return [round(pose.x_mm, 3), round(pose.y_mm, 3), round(pose.angle_rad, 4)]


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
