"""A run streamed to other programs by the Lab Streaming Layer (LSL).

Programs that record brain waves, gaze or an experiment can record streams of LSL with them, on
one clock: see https://labstreaminglayer.org.
"""

import contextlib
import os
import platform
import time
from collections import deque
from typing import Any

import numpy as np

from smarttouch.base.errors import MarkersError
from smarttouch.base.events import Event
from smarttouch.base.lazy_names import import_extra
from smarttouch.profile import Profile
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult

PULSES = (
    ("number", "count"),
    ("slots", "count"),
    ("strongest", "mA"),
    ("intensity", "1"),
    ("period", "us"),
)
FRAMES = (("number", "count"), ("x", "mm"), ("y", "mm"), ("force", "N"))
_LINGER_S = 0.1  # time for the last sample to reach its listeners
_STEPS = 16
_MOVED_S = 0.001  # delay of successive steps after which the loop's schedule counts as moved


class Markers(Listener):
    """Three outlets: ``smarttouch-pulses``, ``smarttouch-frames`` and ``smarttouch-events``.

    Pulses get a sample for each sequence (the board's number, or -1 where it was lost with the
    board; slots; the strongest electrode's current; intensity; period), frames one for each frame
    (number, place on the page, force), events a string for every event of a run. Times are those of
    the run on LSL's clock: of a sequence or frame, when it was due. Failing later than at the start
    ends nothing; it is noted. ``source`` distinguishes this run on the network; host and process if
    not given.
    """

    def __init__(self, source: str | None = None) -> None:
        super().__init__()
        self._begin_s: float | None = None
        self._late_s: deque[float] = deque(maxlen=_STEPS)
        self._source = source or f"{platform.node()}-{os.getpid()}"
        self._pulses = self._frames = self._events = None

    def prepare(self, run: RunContext) -> None:
        """Create the outlets."""
        self._lsl, profile, source = _import_pylsl(), run.profile, self._source
        try:
            self._pulses = self._outlet("pulses", "Stimulation", PULSES, profile, source)
            self._frames = self._outlet("frames", "Position", FRAMES, profile, source)
            self._events = self._outlet("events", "Markers", (("event", ""),), profile, source)
        except (RuntimeError, OSError) as error:
            raise MarkersError(
                f"the Lab Streaming Layer makes no outlet: {error}; check the network, or leave "
                "the markers out",
                about="markers",
            ) from None

    def step(self, result: StepResult) -> None:
        """Send a sample of the sequence and one of the frame."""
        if self._pulses is None:
            return
        sequence, frame = result.step.sequence, result.step.input
        stamp_s = self._stamp_s(frame.time_ns, result.latency_us / 1e6)
        strongest_ua = int(np.abs(sequence.current_ua).max()) if sequence.slots else 0
        self._push(
            self._pulses,
            [
                -1 if result.number is None else result.number,
                sequence.slots,
                strongest_ua / 1000,
                sequence.intensity,
                sequence.period_us,
            ],
            stamp_s,
        )
        pose = frame.pose
        self._push(self._frames, [frame.number, pose.x_mm, pose.y_mm, frame.force_n], stamp_s)

    def event(self, event: Event) -> None:
        """Send an event as a string."""
        if self._events is None:
            return
        if self._begin_s is None:
            self._stamp_s(event.time_ns, 0.0)
        self._push(self._events, [str(event)], self._at_s(event.time_ns))

    def close(self) -> None:
        """End the streams; a second call does nothing."""
        if self._pulses is not None:
            time.sleep(_LINGER_S)
        self._pulses = self._frames = self._events = None

    def _stamp_s(self, time_ns: int, ago_s: float) -> float:
        """Return the time of a moment of the run on LSL's clock, by its age."""
        now_s = float(self._lsl.local_clock()) - ago_s
        if self._begin_s is None:
            self._begin_s = now_s - time_ns / 1e9
        self._late_s.append(now_s - self._at_s(time_ns))
        if len(self._late_s) == _STEPS and min(self._late_s) > _MOVED_S:
            self._begin_s += min(self._late_s)
            self._late_s.clear()
        return self._at_s(time_ns)

    def _at_s(self, time_ns: int) -> float:
        return (self._begin_s or 0.0) + time_ns / 1e9

    def _push(self, outlet: Any, sample: list[Any], stamp_s: float) -> None:
        if outlet is None:
            return
        try:
            outlet.push_sample(sample, stamp_s)
        except Exception as error:
            # Any exception: a finger's run does not end because a marker cannot be sent.
            self.notes.append(f"markers ended before the run, the Lab Streaming Layer: {error}")
            self._pulses = self._frames = self._events = None

    def _outlet(
        self,
        name: str,
        kind: str,
        channels: tuple[tuple[str, str], ...],
        profile: Profile,
        source: str,
    ) -> Any:
        lsl = self._lsl
        form = lsl.cf_string if kind == "Markers" else lsl.cf_double64
        info = lsl.StreamInfo(
            f"smarttouch-{name}", kind, len(channels), lsl.IRREGULAR_RATE, form,
            f"smarttouch-{name}-{source}",
        )  # fmt: skip
        about = info.desc()
        about.append_child_value("manufacturer", "SmartTouch")
        about.append_child_value("profile", profile.name or profile.title)
        listed = about.append_child("channels")
        for label, unit in channels:
            channel = listed.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("unit", unit)
        return lsl.StreamOutlet(info)


def _import_pylsl() -> Any:
    try:
        pylsl = import_extra("pylsl", "a stream of markers", "lsl", MarkersError)
    except RuntimeError:
        raise MarkersError(
            "markers need liblsl, which pylsl has not found: install it (https://labstreaminglayer.org)"
            ", or leave the markers out",
            about="liblsl",
            remedy="https://labstreaminglayer.org",
        ) from None
    # Its library otherwise writes over the screen; older ones cannot be silenced.
    with contextlib.suppress(AttributeError, RuntimeError):
        pylsl.set_config_content("[log]\nlevel = -3\n")
    return pylsl
