"""Source of a session: patterns as they are asked for, and silence in between."""

import math
import threading
import time
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SourceError
from smarttouch.base.stopping import StopRequest
from smarttouch.base.tactile_image import TactileImage
from smarttouch.imaging.tactile_mapper import TactileMapper
from smarttouch.profile import Profile
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.show_request import SILENT_US, STEADY, Show
from smarttouch.running.step import StepResult
from smarttouch.sources.given_sources import checked_activation, gray_image
from smarttouch.sources.source_contract import IDLE_NS, Frame, Input, Source, Stimulus
from smarttouch.stimulation.intensity import force_gate

AHEAD_NS = 6_000_000  # time before a planned start in which its first sequence is made
Pattern = NDArray[Any] | Frame | TactileImage
"""Activation (E,) or (3, E), an image (H, W), a frame, or a tactile image."""


class SessionFeed(Source, Listener):
    """Source that gives the pattern that is shown or put, and silence otherwise.

    In simulated time it waits in `read`, so that time passes only while something is shown.
    """

    frames: int
    dropped_frames: int
    knows_force = True
    ended = "the session is over"

    stands_still: ClassVar[bool] = True
    """Whether simulated time passes only while something is shown."""

    def __init__(
        self, profile: Profile, title: str = "session", stop: StopRequest | None = None
    ) -> None:
        super().__init__(title)
        self.news: threading.Event = threading.Event()
        self.began: threading.Event = threading.Event()
        self.is_over: bool = False
        self.controls: Controls = Controls(ControlState(Mode.RA))
        self.gate: float = 0.0  # what force lets flow of a level, in [0, 1]
        self.user_level: float = 0.0  # what the user lets flow of a level, in [0, 1]
        self.now_ns: int = 0  # time of the last read, since the start of the run
        self._read_at_ns = (0, 0)
        self._profile, self._simulated, self._stop = profile, False, stop or StopRequest()
        self._press_n = profile.force.full_n
        self._least_us = math.ceil(1e6 / profile.limits.rate_hz)
        self._silent_us = max(SILENT_US, self._least_us)
        self._usual_ns = round(1e9 / profile.pulse.rate_hz)
        self._nothing = np.zeros((len(Afferent), len(profile.electrodes)), np.float32)
        self._lock = threading.Lock()
        self._show: Show | None = None
        self._put: tuple[NDArray[np.float32] | Frame, int, int] | None = None
        """Pattern that was put, when it came and when it is stale, by `time.monotonic_ns`."""
        self._put_sent_ns: int | None = None
        self._count = self._missed = 0
        """Number of what is shown, and patterns that were put and replaced before it."""
        self._read_number: int | None = None
        self._seen: tuple[Mode, bool] | None = None
        self._context: RunContext | None = None
        self._mapper = TactileMapper(profile)

    # -- from the program's threads -------------------------------------------

    def checked(self, pattern: Pattern | None, mode: Mode) -> NDArray[np.float32] | Frame:
        """Return activation (3, E) or a frame; raises a SourceError for anything else."""
        electrodes = self._nothing.shape[1]
        if pattern is None:
            middle = self._nothing.copy()
            middle[mode.afferents[0], self._middle()] = 1
            return middle
        if isinstance(pattern, TactileImage):
            pattern = pattern.activation
        if isinstance(pattern, Frame):
            return replace(pattern, image=gray_image(pattern.image, "the program"))
        array = np.asarray(pattern)
        if array.shape == (electrodes,):
            if len(mode.afferents) != 1:
                raise SourceError(
                    f"mode {mode} drives several classes: give activation (3, {electrodes})"
                )
            made = np.zeros(self._nothing.shape)
            made[mode.afferents[0]] = array
            array = made
        elif array.shape != self._nothing.shape and array.dtype.kind in "fbiu":
            if array.ndim == 2 and array.dtype.kind in "ub":
                return Frame(gray_image(array, "the program"), 0)
            raise SourceError(
                f"{array.dtype} {array.shape} is no pattern for this array: give activation "
                f"({electrodes},) or (3, {electrodes}), in [0, 1], or an image (H, W), uint8"
            )
        # Nobody writes into it later.
        return checked_activation(array, "the program", electrodes).copy()

    def begin(self, show: Show) -> None:
        """Show something next, unless it has been canceled."""
        with self._lock:
            if self.is_over:
                show.end("the session has ended")
            elif not show.over.is_set():
                self._show = show
        self.news.set()

    def cancel(self, show: Show) -> None:
        """End something that is shown, or is to be; nothing if it is over."""
        with self._lock:
            if self._show is show:
                self._show = None
            if not show.over.is_set():
                show.end("it was canceled")
        self.news.set()

    def put(self, pattern: NDArray[np.float32] | Frame, stale_ns: int) -> None:
        """Show a pattern until another, or until it is stale."""
        with self._lock:
            self._missed += self._put is not None and self._put_sent_ns is None
            now_ns = time.monotonic_ns()
            self._put, self._put_sent_ns = (pattern, now_ns, now_ns + stale_ns), None
        self.news.set()

    def end(self) -> None:
        """End the source at its next read; what is being shown is cut off."""
        with self._lock:
            self.is_over = True
        self.news.set()

    def close(self) -> None:
        """Wake all threads that wait for the feed."""
        with self._lock:
            self.is_over = True
            show, self._show = self._show, None
        if show is not None:
            show.end("the session ended meanwhile")
        self.began.set()
        self.news.set()

    # -- from the loop's thread -----------------------------------------------

    def start(self, run: RunContext) -> None:
        """Begin: the board is open."""
        self._context, self.controls = run, run.controls
        self._simulated |= self.stands_still and run.board.simulated_time and not run.config.paced
        self._mapper = TactileMapper(run.profile, run.config.light_on_dark, run.config.tone)
        self.began.set()

    def patience_ns(self, time_ns: int) -> int:
        """Return how long the next read may wait for news."""
        if self._simulated:
            return 0
        now_ns = time.monotonic_ns()
        with self._lock:
            self.news.clear()
            # Before the read: what a program asks for next follows without a gap.
            self._end_if_past(time_ns)
            show = self._show
            if self.is_over:
                return 0
            if show is not None:
                if show.began or show.at_ns is None or not self._is_open(show, time_ns):
                    return 0
                return max(0, min(IDLE_NS, show.at_ns - AHEAD_NS - now_ns))
            if self._put is not None and now_ns < self._put[2]:
                if self._put_sent_ns is None:
                    return 0
                if not isinstance(self._put[0], np.ndarray) or self._put[0].any():
                    repeats_ns = self._put_sent_ns + self._usual_ns - time_ns
                    return max(0, repeats_ns) if self.follows else 0
        return IDLE_NS

    def time_ns(self) -> int:
        """Return the time since the start of the run; in simulated time that of the last read."""
        read_ns, clock_ns = self._read_at_ns
        return read_ns + (0 if self._simulated else time.monotonic_ns() - clock_ns)

    def read(self, time_ns: int) -> Input | None:
        """Return what is shown now."""
        self.now_ns, self._read_at_ns = time_ns, (time_ns, time.monotonic_ns())
        self.send_at_ns = None
        while True:
            with self._lock:
                given = None if self.is_over else self._shown_now(time_ns)
                if given is not None:
                    self._account(given.number)
                if given is not None or self.is_over:
                    return given
            self.news.wait(0.1)
            self.news.clear()
            if self._stop.event.is_set():
                return None

    def _shown_now(self, time_ns: int) -> Input | None:
        """Return what is shown, or silence; None where simulated time must not pass."""
        self._end_if_past(time_ns)
        if (
            self._simulated
            and self._show is None
            and (self._put is None or self._put_sent_ns is not None)
        ):
            return None
        state = self.controls.state(time_ns)
        seen, self._seen = self._seen, (state.mode, state.paused)
        if seen is not None and seen != self._seen:
            # Intensity begins at zero with this step.
            return self._silent(time_ns)
        if self._show is not None:
            given = self._of_show(self._show, time_ns)
            if given is not None or (self._simulated and self._show is None):
                return given
        if self._put is not None:
            return self._of_put(self._put, time_ns)
        return self._silent(time_ns)

    def _account(self, number: int) -> None:
        """Count what is read, and what was replaced before."""
        if number != self._read_number:
            before = min(number - 1, 0) if self._read_number is None else self._read_number
            self.frames += number - before
            self.dropped_frames += number - before - 1
            self._read_number = number

    def _of_put(self, put: tuple[NDArray[np.float32] | Frame, int, int], time_ns: int) -> Input:
        pattern, came_ns, stale_ns = put
        now_ns = time.monotonic_ns()
        if now_ns >= stale_ns:
            return replace(self._silent(time_ns), stale=True)
        if self._put_sent_ns is None:
            self._count += 1 + self._missed
            self._missed = 0
        self._put_sent_ns = time_ns
        given = self._input(pattern, time_ns, self._least_us if self.follows else None)
        return replace(given, age_ns=now_ns - came_ns)

    def _input(
        self,
        pattern: NDArray[np.float32] | Frame,
        time_ns: int,
        period_us: int | None,
        level: float = 1.0,
    ) -> Stimulus:
        """Return a pattern as an input; frames are mapped here."""
        force_n, image = self._press_n, None
        if isinstance(pattern, Frame):
            force_n = force_n if math.isnan(pattern.force_n) else pattern.force_n
            mode, image = self.controls.state(time_ns).mode, pattern.image
            frame = replace(pattern, time_ns=time_ns, force_n=force_n)
            pattern = self._mapper.map(frame, mode).activation
        return Stimulus(
            pattern, time_ns, force_n, period_us, level, number=self._count, image=image
        )

    def _of_show(self, show: Show, time_ns: int) -> Input | None:
        """Return a pattern, or the pulses that open its level; None if it is over or must wait."""
        if show.asked_ns is None:
            show.asked_ns = time_ns
        if not show.began:
            if show.opens is not None and not self._is_open(show, time_ns):
                return self._opening(show, time_ns)
            now_ns, at_ns = time.monotonic_ns(), None if self._simulated else show.at_ns
            if at_ns is not None and now_ns < at_ns - AHEAD_NS:
                return None
            self.send_at_ns = at_ns
            show.began, show.time_ns, show.clock_ns = True, time_ns, max(now_ns, at_ns or 0)
            self._count += show.pattern is not None
            # An earlier pattern returns afterwards, unless it is stale by then.
            self._put_sent_ns = None
            if self._put is not None and time.monotonic_ns() >= self._put[2]:
                self._put = None
            self._end_if_past(time_ns)
            if self._show is None:
                return None
        level = show.level_at(time_ns - show.time_ns)
        if level is None or not 0 <= level <= 1:
            if level is not None:
                show.fault = f"level {level:g} must be from 0 to 1"
            self._end_show(show)
            return None
        if show.pattern is None:
            return self._silent(time_ns, show.silence_us(time_ns, self._silent_us, self._least_us))
        period_us = show.period_us
        if period_us is None and self.controls.state(time_ns).mode is Mode.COLOR:
            period_us = self._usual_ns // 1000
        return self._input(show.pattern, time_ns, period_us, level)

    def _end_if_past(self, time_ns: int) -> None:
        show = self._show
        if show is not None and show.is_past(time_ns, 1000 * self._least_us):
            self._end_show(show)

    def _end_show(self, show: Show) -> None:
        if self._context is not None:
            show.note_start(self._context.board)
        self._show = None
        show.over.set()

    def _opening(self, show: Show, time_ns: int) -> Input | None:
        """Return weak pulses that open the level of a pattern; None once patience is over."""
        assert show.asked_ns is not None
        assert show.opens is not None
        waited_s = (time_ns - show.asked_ns) / 1e9
        if show.patience_s is not None and waited_s > show.patience_s:
            why = "no finger presses" if not self.gate else "the board or the user allows less"
            show.fault = f"level {show.opens:g} was not reached within {show.patience_s:g} s: {why}"
            self._end_show(show)
            return None
        self.note_opening()
        mode = self.controls.state(time_ns).mode
        if isinstance(show.pattern, Frame):
            frame = replace(show.pattern, time_ns=time_ns, force_n=self._press_n)
            shape = self._mapper.map(frame, Mode.RA).activation[Afferent.RA]
            active = self._nothing.copy()
            active[list(mode.afferents)] = shape > 0
        else:
            assert show.pattern is not None
            active = np.asarray(show.pattern > 0, np.float32)
        if not active.any():
            active[mode.afferents[0], self._middle()] = 1
        show.ramped_ns = time_ns - show.asked_ns + 1000 * self._least_us
        faint = np.asarray(np.float32(show.faint) * active, np.float32)
        return Stimulus(
            faint, time_ns, self._press_n, self._silent_us, show.opens, number=self._count
        )

    def note_opening(self) -> None:
        """Note that a level is being opened; for sources that report it."""

    def _scale(self, show: Show) -> float:
        """Return the share of a level that flows."""
        return 1.0 if show.exact else self.gate * self.user_level

    def _is_open(self, show: Show, time_ns: int) -> bool:
        asked = (show.opens or 0.0) * self._scale(show)
        return self._context is not None and 0 < STEADY * asked <= self._context.open_level(time_ns)

    def step(self, result: StepResult) -> None:
        """Note how the last input was sent."""
        step = result.step
        self.gate = force_gate(step.input.force_n, self._profile.force)
        self.user_level = 0.0 if self.controls.state(0).paused else step.level
        with self._lock:
            show = self._show
            if show is None or show.asked_ns is None or show.pattern is None:
                return
            asked = step.tactile.level * self._scale(show)
            show.note(result, asked)

    def _silent(self, time_ns: int, period_us: int | None = None) -> Stimulus:
        period_us = period_us or self._least_us
        return Stimulus(self._nothing, time_ns, self._press_n, period_us, number=self._count)

    @property
    def follows(self) -> bool:
        """Whether what is put begins at once, as one pulse of each class; else with the next
        sequence, at the rates of its classes."""
        return self.controls.state(self.now_ns).mode is not Mode.NATURAL

    @property
    def most_hz(self) -> float:
        """Most sequences a second."""
        return self._profile.limits.rate_hz

    def _middle(self) -> int:
        """Return the electrode nearest to the middle of those that are driven."""
        place_mm, driven = self._profile.electrodes.position_mm, self._profile.driven
        away_mm = np.hypot(*(place_mm[driven] - place_mm.mean(axis=0)).T)
        return int(driven[away_mm.argmin()])
