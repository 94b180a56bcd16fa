"""Source of a session: patterns as they are asked for, and silence in between."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SourceError
from smarttouch.base.stopping import StopRequest
from smarttouch.base.tactile_image import TactileImage
from smarttouch.imaging.tactile_mapper import TactileMapper
from smarttouch.profile import Profile
from smarttouch.running.inputs import Controls
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.step import StepResult
from smarttouch.sources.given_sources import checked_activation, gray_image
from smarttouch.sources.source_contract import Frame, Input, Source, Stimulus
from smarttouch.stimulation.intensity import force_gate

Pattern = NDArray[Any] | Frame | TactileImage
"""Activation (E,) or (3, E), an image (H, W), a frame, or a tactile image."""
STEADY = 0.98
"""Part of a level that counts as reached."""
FAINT = 0.01
"""Activation of pulses that open a level: those of threshold."""
IDLE_NS = 45_000_000
"""Longest time without a sequence while nothing is shown."""
SILENT_US = 20_000
"""Period of a silence that is asked for, and of pulses that open a level."""


Level = float | Callable[[float], float | None]
"""Part of an intensity, in [0, 1]; or a function of the seconds since a pattern began, which ends
it by None."""


@dataclass(eq=False)
class Show:
    """A pattern or a silence that is asked for, and what has become of it.

    Without seconds a pattern is its level alone, and a silence lasts until its level is None.
    """

    pattern: NDArray[np.float32] | Frame | None
    level: Level
    seconds: float | None
    opens: float | None = None
    """Level that must be open before it begins."""
    patience_s: float | None = None
    at_ns: int | None = None
    period_us: int | None = None
    exact: bool = False
    """Whether neither force nor the user's level may lower it."""
    least: float = STEADY
    """Part of what is asked below which its level is lost."""
    over: threading.Event = field(default_factory=threading.Event)
    fault: str = ""
    began: bool = False
    asked_ns: int | None = None
    time_ns: int = 0
    clock_ns: int = 0
    first: int | None = None
    """Number of its first sequence."""
    board_us: int | None = None
    ramped_ns: int = 0
    sequences: int = 0
    pulses: int = 0
    lowest: float | None = None
    current_ma: float = 0.0
    """Strongest of its last pulses."""
    faint: float = FAINT

    def level_at(self, since_ns: int) -> float | None:
        """Return its level a while after it began; None where that ends it."""
        return self.level(since_ns / 1e9) if callable(self.level) else self.level

    def is_past(self, time_ns: int, least_ns: int) -> bool:
        """Return whether it is over; no silence is shorter than ``least_ns``."""
        if not self.began or self.seconds is None:
            return bool(self.fault)
        left_ns = self.time_ns + round(1e9 * self.seconds) - time_ns
        return bool(self.fault) or left_ns < (least_ns if self.pattern is None else 1)


class SessionFeed(Source, Listener):
    """Source that gives the pattern that is shown or put, and silence otherwise.

    In simulated time it waits in `read`, so that time passes only while something is shown.
    """

    knows_force = True
    ended = "the session is over"

    def __init__(
        self, profile: Profile, simulated: bool, stop: StopRequest | None = None, title: str = ""
    ) -> None:
        super().__init__(title or "session")
        self.news: threading.Event = threading.Event()
        self.began, self.is_over = threading.Event(), False
        self.controls: Controls
        self.gate = self.user_level = 0.0
        """What force and the user let flow of a level, in [0, 1]."""
        self.now_ns = 0
        """Time of the last read, since the start of the run."""
        self._read_at_ns = (0, 0)
        self._profile, self._simulated, self._stop = profile, simulated, stop or StopRequest()
        self._press_n = profile.force.full_n
        self._least_us = math.ceil(1e6 / profile.limits.rate_hz)
        self._silent_us = max(SILENT_US, self._least_us)
        self._usual_ns = round(1e9 / profile.pulse.rate_hz)
        self._nothing = np.zeros((len(Afferent), len(profile.electrodes)), np.float32)
        self._lock = threading.Lock()
        self._show: Show | None = None
        self._put: tuple[NDArray[np.float32] | Frame, int, int] | None = None
        self._put_sent_ns: int | None = None
        self._seen: tuple[Mode, bool] | None = None
        self._run: RunContext
        self._mapper: TactileMapper

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
        if array.ndim == 1:
            if len(mode.afferents) != 1:
                raise SourceError(
                    f"mode {mode} drives several classes: give activation (3, {electrodes})",
                    about="pattern",
                )
            made = np.zeros((len(Afferent), len(array)))
            made[mode.afferents[0]] = array
            array = made
        if array.ndim == 2 and array.shape != self._nothing.shape and array.dtype.kind in "ub":
            return Frame(gray_image(array, "the program"), 0)
        # Nobody writes into it later.
        return checked_activation(array, "the program", electrodes).copy()

    def begin(self, show: Show) -> None:
        """Show something next, unless it has been canceled."""
        with self._lock:
            if self.is_over:
                _end(show, "the session has ended")
            elif not show.over.is_set():
                self._show = show
        self.news.set()

    def cancel(self, show: Show) -> None:
        """End something that is shown, or is to be; nothing if it is over."""
        with self._lock:
            if self._show is show:
                self._show = None
            if not show.over.is_set():
                _end(show, "it was canceled")
        self.news.set()

    def put(self, pattern: NDArray[np.float32] | Frame, stale_ns: int) -> None:
        """Show a pattern until another, or until it is stale."""
        with self._lock:
            self.frames += 1
            self._put = pattern, time.monotonic_ns() + stale_ns, self.frames
            self._put_sent_ns = None
        self.news.set()

    def end(self) -> None:
        """End the source at its next read; what is being shown is cut off."""
        with self._lock:
            self.is_over = True
        self.news.set()

    def close(self) -> None:
        """Let nobody wait any longer."""
        with self._lock:
            self.is_over = True
            show, self._show = self._show, None
        if show is not None:
            _end(show, "the session ended meanwhile")
        self.began.set()
        self.news.set()

    # -- from the loop's thread -----------------------------------------------

    def start(self, run: RunContext) -> None:
        """Begin: the board is open."""
        self._run, self.controls = run, run.controls
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
                return max(0, min(IDLE_NS, show.at_ns - now_ns))
            if self._put is not None and now_ns < self._put[1]:
                if self._put_sent_ns is None:
                    return 0
                return max(0, self._put_sent_ns + self._usual_ns - time_ns)
        return IDLE_NS

    def time_ns(self) -> int:
        """Return the time since the start of the run; in simulated time that of the last read."""
        read_ns, clock_ns = self._read_at_ns
        return read_ns + (0 if self._simulated else time.monotonic_ns() - clock_ns)

    def read(self, time_ns: int) -> Input | None:
        """Return what is shown now."""
        self.now_ns, self._read_at_ns = time_ns, (time_ns, time.monotonic_ns())
        while True:
            with self._lock:
                given = None if self.is_over else self._shown_now(time_ns)
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
        if seen != self._seen:
            # Intensity begins at zero with this step.
            return self._silent(time_ns)
        if self._show is not None:
            given = self._of_show(self._show, time_ns)
            if given is not None or (self._simulated and self._show is None):
                return given
        if self._put is not None:
            return self._of_put(self._put, time_ns)
        return self._silent(time_ns)

    def _of_put(self, put: tuple[NDArray[np.float32] | Frame, int, int], time_ns: int) -> Input:
        pattern, stale_ns, number = put
        if time.monotonic_ns() >= stale_ns:
            self._put = None
            return replace(self._silent(time_ns), stale=True)
        self._put_sent_ns = time_ns
        return self._input(pattern, time_ns, number, self._least_us)

    def _input(
        self,
        pattern: NDArray[np.float32] | Frame,
        time_ns: int,
        number: int,
        period_us: int | None,
        level: float = 1.0,
    ) -> Input:
        """Return a pattern as an input; frames are mapped here."""
        force_n, image = self._press_n, None
        if isinstance(pattern, Frame):
            force_n = force_n if math.isnan(pattern.force_n) else pattern.force_n
            mode, image = self.controls.state(time_ns).mode, pattern.image
            if mode is Mode.NATURAL:
                period_us = None
            frame = replace(pattern, time_ns=time_ns, force_n=force_n)
            pattern = self._mapper.map(frame, mode).activation
        return Stimulus(pattern, time_ns, force_n, period_us, level, number=number, image=image)

    def _of_show(self, show: Show, time_ns: int) -> Input | None:
        """Return a pattern, or the pulses that open its level; None if it is over or must wait."""
        if show.asked_ns is None:
            show.asked_ns = time_ns
        if not show.began:
            if show.opens is not None and not self._is_open(show, time_ns):
                return self._opening(show, time_ns)
            waits = show.at_ns is not None and not self._simulated
            if waits and show.at_ns is not None and time.monotonic_ns() < show.at_ns:
                return None
            show.began, show.time_ns, show.clock_ns = True, time_ns, time.monotonic_ns()
            self.frames += show.pattern is not None
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
            return self._silent(time_ns, self._silence_us(show, time_ns))
        period_us = show.period_us
        if period_us is None and self.controls.state(time_ns).mode is Mode.COLOR:
            period_us = self._usual_ns // 1000
        return self._input(show.pattern, time_ns, self.frames, period_us, level)

    def _silence_us(self, show: Show, time_ns: int) -> int:
        """Return the next part of a silence, which ends at its end to the microsecond."""
        if show.seconds is None:
            return self._silent_us
        left_us = (show.time_ns + round(1e9 * show.seconds) - time_ns) // 1000
        return left_us if left_us <= self._silent_us + self._least_us else self._silent_us

    def _end_if_past(self, time_ns: int) -> None:
        show = self._show
        if show is not None and show.is_past(time_ns, 1000 * self._least_us):
            self._end_show(show)

    def _end_show(self, show: Show) -> None:
        self._note_start(show)
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
            faint, time_ns, self._press_n, self._silent_us, show.opens, number=self.frames
        )

    def note_opening(self) -> None:
        """Take note that a level is being opened; for sources that say so."""

    def _scale(self, show: Show) -> float:
        """Return how much of a level is to flow."""
        return 1.0 if show.exact else self.gate * self.user_level

    def _is_open(self, show: Show, time_ns: int) -> bool:
        asked = (show.opens or 0.0) * self._scale(show)
        return 0 < STEADY * asked <= self._run.open_level(time_ns)

    def step(self, result: StepResult) -> None:
        """Take note of how the last input was sent."""
        step, sequence = result.step, result.step.sequence
        self.gate = force_gate(step.input.force_n, self._profile.force)
        self.user_level = 0.0 if self.controls.state(0).paused else step.level
        with self._lock:
            show = self._show
            if show is None or show.asked_ns is None or show.pattern is None:
                return
            asked = step.tactile.level * self._scale(show)
            if not show.began:
                if 0 < STEADY * asked <= sequence.intensity:
                    # Claimed in full, and not open: pulses this weak do not open that much, and
                    # where the strongest are none, there is nothing to open.
                    if show.faint == 1 and not sequence.slots:
                        show.opens = None
                    show.faint = min(1.0, 2 * show.faint)
                return
            show.first = result.number if show.first is None else show.first
            show.sequences += 1
            show.pulses += sequence.slots
            show.lowest = min(sequence.intensity, math.inf if show.lowest is None else show.lowest)
            if sequence.slots:
                show.current_ma = float(np.abs(sequence.current_ua).max()) / 1000
            lost = result.number is None or step.restarted or (asked == 0 and not show.exact)
            if lost or sequence.intensity < show.least * asked:
                show.fault = (
                    f"its level was lost after {show.sequences} sequences: the finger was lifted, "
                    "the session paused, or the board lost"
                )

    def _note_start(self, show: Show) -> None:
        """Note when the first pulse of a pattern began, if the board says so."""
        board = self._run.board
        start = None if show.first is None else board.start_of(show.first)
        if start is not None:
            show.board_us = start.board_us
            if not board.simulated_time:
                # The board's clock may run while the machine sleeps, the program's does not.
                show.clock_ns = time.monotonic_ns() - (board.clock.now_ns() - start.time_ns)

    def _silent(self, time_ns: int, period_us: int | None = None) -> Stimulus:
        return Stimulus(self._nothing, time_ns, self._press_n, period_us or self._least_us)

    @property
    def most_hz(self) -> float:
        """Most sequences a second."""
        return self._profile.limits.rate_hz

    def _middle(self) -> int:
        """Return the electrode nearest to the middle of those that are driven."""
        place_mm, driven = self._profile.electrodes.position_mm, self._profile.driven
        away_mm = np.hypot(*(place_mm[driven] - place_mm.mean(axis=0)).T)
        return int(driven[away_mm.argmin()])


def _end(show: Show, why: str) -> None:
    show.fault = why
    show.over.set()
