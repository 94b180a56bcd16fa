"""Source of a session: patterns as they are asked for, and silence in between."""

import math
import threading
import time
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


@dataclass(eq=False)
class Show:
    """A pattern that is asked for, and what has become of it; without seconds, its level alone."""

    pattern: NDArray[np.float32] | Frame
    level: float
    seconds: float
    patience_s: float
    at_ns: int | None = None
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
    faint: float = FAINT


class _Watch(Listener):
    """Tells the feed how its patterns were sent."""

    def __init__(self, feed: "SessionFeed") -> None:
        super().__init__()
        self._feed = feed

    def start(self, run: RunContext) -> None:
        self._feed.start(run)

    def step(self, result: StepResult) -> None:
        self._feed.note(result)


class SessionFeed(Source):
    """Source that gives the pattern that is shown or put, and silence otherwise."""

    knows_force = True
    ended = "the session is over"

    def __init__(self, profile: Profile, simulated: bool, stop: StopRequest) -> None:
        super().__init__("session")
        self.news: threading.Event = threading.Event()
        self.began, self.is_over = threading.Event(), False
        self.controls: Controls
        self.watch = _Watch(self)
        self._profile, self._simulated, self._stop = profile, simulated, stop
        self._press_n = profile.force.full_n
        self._least_us = math.ceil(1e6 / profile.limits.rate_hz)
        self._usual_ns = round(1e9 / profile.pulse.rate_hz)
        self._nothing = np.zeros((len(Afferent), len(profile.electrodes)), np.float32)
        self._lock = threading.Lock()
        self._show: Show | None = None
        self._put: tuple[NDArray[np.float32] | Frame, int, int] | None = None
        self._put_sent_ns: int | None = None
        self._gate = self._level = 0.0
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
        """Show something next."""
        with self._lock:
            if self.is_over:
                show.fault = "the session has ended"
                show.over.set()
                return
            self._show = show
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

    def close_for_good(self) -> None:
        """Let nobody wait any longer."""
        with self._lock:
            self.is_over = True
            show, self._show = self._show, None
        if show is not None:
            show.fault = "the session ended meanwhile"
            show.over.set()
        self.began.set()

    # -- from the loop's thread -----------------------------------------------

    def start(self, run: RunContext) -> None:
        """Begin: the board is open."""
        self._run, self.controls = run, run.controls
        self._mapper = TactileMapper(run.profile, run.config.light_on_dark, run.config.tone)
        self.began.set()

    def patience_ns(self, time_ns: int) -> int:
        """Return how long the next read may wait for news."""
        now_ns = time.monotonic_ns()
        with self._lock:
            self.news.clear()
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

    def read(self, time_ns: int) -> Input | None:
        """Return what is shown now."""
        while self._simulated and self._is_idle():
            # Simulated time passes only while something is shown.
            self.news.wait(0.1)
            self.news.clear()
            if self._stop.event.is_set():
                return None
        state = self.controls.state(time_ns)
        seen, self._seen = self._seen, (state.mode, state.paused)
        with self._lock:
            if self.is_over:
                return None
            if seen != self._seen:
                # Intensity begins at zero with this step.
                return self._silent(time_ns)
            if self._show is not None and (given := self._of_show(self._show, time_ns)) is not None:
                return given
            if self._put is not None:
                return self._of_put(self._put, time_ns)
        return self._silent(time_ns)

    def _is_idle(self) -> bool:
        with self._lock:
            put = self._put is not None and self._put_sent_ns is None
            return not (self.is_over or self._show is not None or put)

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
        """Return a pattern as an input; frames are mapped here, but those of natural mode."""
        if isinstance(pattern, Frame):
            force_n = self._press_n if math.isnan(pattern.force_n) else pattern.force_n
            mode = self.controls.state(time_ns).mode
            frame = replace(pattern, time_ns=time_ns, force_n=force_n, number=number)
            if mode is Mode.NATURAL:
                return frame
            pattern = self._mapper.map(frame, mode).activation
        return Stimulus(pattern, time_ns, self._press_n, period_us, level, number=number)

    def _of_show(self, show: Show, time_ns: int) -> Input | None:
        """Return a pattern, or the pulses that open its level; None if it is over or must wait."""
        if show.asked_ns is None:
            show.asked_ns = time_ns
        if not show.began:
            if not self._is_open(show, time_ns):
                return self._opening(show, time_ns)
            if show.at_ns is not None and time.monotonic_ns() < show.at_ns:
                return None
            show.began, show.time_ns, show.clock_ns = True, time_ns, time.monotonic_ns()
            self.frames += 1
        # As many periods as begin within, half a period more or less.
        if show.fault or time_ns - show.time_ns >= 1e9 * show.seconds:
            self._note_start(show)
            self._show = None
            show.over.set()
            return None
        color = self.controls.state(time_ns).mode is Mode.COLOR
        period_us = self._usual_ns // 1000 if color else None
        return self._input(show.pattern, time_ns, self.frames, period_us, show.level)

    def _opening(self, show: Show, time_ns: int) -> Input | None:
        """Return weak pulses that open the level of a pattern; None once patience is over."""
        assert show.asked_ns is not None
        waited_s = (time_ns - show.asked_ns) / 1e9
        if waited_s > show.patience_s:
            why = "no finger presses" if not self._gate else "the board or the user allows less"
            show.fault = f"level {show.level:g} was not reached within {show.patience_s:g} s: {why}"
            self._show = None
            show.over.set()
            return None
        if isinstance(show.pattern, Frame):
            frame = replace(show.pattern, time_ns=time_ns, force_n=self._press_n)
            shape = self._mapper.map(frame, Mode.RA).activation[Afferent.RA]
            active = self._nothing.copy()
            active[list(self.controls.state(time_ns).mode.afferents)] = shape > 0
        else:
            active = np.asarray(show.pattern > 0, np.float32)
        if not active.any():
            active[self.controls.state(time_ns).mode.afferents[0], self._middle()] = 1
        show.ramped_ns = time_ns - show.asked_ns + 1000 * self._least_us
        faint = np.asarray(np.float32(show.faint) * active, np.float32)
        return Stimulus(faint, time_ns, self._press_n, 20_000, show.level, number=self.frames)

    def _is_open(self, show: Show, time_ns: int) -> bool:
        asked = show.level * self._gate * self._level
        return 0 < STEADY * asked <= self._run.open_level(time_ns)

    def note(self, result: StepResult) -> None:
        """Take note of how the last input was sent."""
        step, sequence = result.step, result.step.sequence
        self._gate = force_gate(step.input.force_n, self._profile.force)
        self._level = 0.0 if self.controls.state(0).paused else step.level
        with self._lock:
            show = self._show
            if show is None or show.asked_ns is None:
                return
            asked = show.level * self._gate * self._level
            reached = asked > 0 and sequence.intensity >= STEADY * asked
            if not show.began:
                if sequence.slots and reached:
                    # Claimed in full, and not open: pulses this weak do not open that much.
                    show.faint = min(1.0, 2 * show.faint)
                return
            show.first = result.number if show.first is None else show.first
            show.sequences += 1
            show.pulses += sequence.slots
            show.lowest = min(sequence.intensity, math.inf if show.lowest is None else show.lowest)
            if result.number is None or step.restarted or not reached:
                show.fault = (
                    f"level {show.level:g} was lost after {show.sequences} sequences: the finger "
                    "was lifted, the session paused, or the board lost"
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

    def _silent(self, time_ns: int) -> Stimulus:
        return Stimulus(self._nothing, time_ns, self._press_n, self._least_us)

    def _middle(self) -> int:
        """Return the electrode nearest to the middle of those that are driven."""
        place_mm, driven = self._profile.electrodes.position_mm, self._profile.driven
        away_mm = np.hypot(*(place_mm[driven] - place_mm.mean(axis=0)).T)
        return int(driven[away_mm.argmin()])
