"""Programs: sources that show one pattern after another, or repeat the latest pattern."""

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import (
    LevelNotReachedError,
    SmartTouchError,
    SourceError,
    require_within,
)
from smarttouch.base.events import Note
from smarttouch.base.stopping import uninterrupted
from smarttouch.base.tactile_image import TactileImage
from smarttouch.imaging.tactile_mapper import TactileMapper
from smarttouch.profile import Profile
from smarttouch.running.loop import Controls, ControlState, Loop
from smarttouch.running.step_records import Listener, RunContext, StepResult
from smarttouch.sources.source_contract import (
    Frame,
    Input,
    Source,
    Stimulus,
    checked_activation,
    gray_image,
)
from smarttouch.stimulation.scheduler import force_gate

STEADY = 0.98  # a level counts as reached at this share of the level
SILENT_US = 20_000  # period of sequences without current, and of weak pulses while the ramp rises
_FAINT = 0.01  # activation of the first pulses of a ramp, near the detection threshold
_POLL_S = 0.01  # interval at which a waiting thread checks whether it was canceled
_IDLE_S = 0.045  # longest time between sequences of `put` while its pattern is empty or stale

Pattern = NDArray[Any] | Frame | TactileImage
"""Activation (E,) or (3, E), an image (H, W), a frame, or a tactile image."""
Level = float | Callable[[float], float | None]
"""Share of the session's intensity, in [0, 1], or a function that returns this share. The function
takes the seconds since the pattern began, and returns None to end the pattern."""
CANCELED: ContextVar[threading.Event | None] = ContextVar("canceled", default=None)
"""Event that cancels the pattern that the calling thread or task shows."""


@dataclass(frozen=True)
class Shown:
    """Result of showing a pattern.

    Attributes
    ----------
    time_ns : int
        Time of the first sequence, since the start of the session.
    clock_ns : int
        Start of the first pulse by `time.monotonic_ns`; time of sending if the board does not
        report starts.
    board_us : int or None, µs
        Start of the first pulse by the board's clock; None if the board does not report it.
    sequences, pulses : int
        Number of sequences, and number of pulses, one for each slot.
    intensity : float, in [0, 1]
        Lowest intensity of all sequences.
    current_ma : float, mA
        Strongest current in the last sequence with pulses, magnitude.
    ramped_s : float, s
        Time that the ramp needed to rise to the pattern's level; 0 if it was high enough before.
    """

    time_ns: int
    clock_ns: int
    board_us: int | None
    sequences: int
    pulses: int
    intensity: float
    current_ma: float
    ramped_s: float


class Program(Source, Listener):
    """Base class of `Session` and of sources with a `program` that shows patterns.

    Methods may be called from any thread. Patterns are shown one after another. The thread that
    shows a pattern also executes the loop of the run.
    """

    frames: int
    dropped_frames: int
    knows_force = True
    ended = "the program has ended"
    patience_s: float = 10.0
    """Longest time for the ramp to reach a level, s."""

    def __init__(self, profile: Profile, title: str = "session") -> None:
        super().__init__(title)
        self.controls: Controls = Controls(ControlState(Mode.RA))
        self.now_ns: int = 0  # time of the run, updated after each sequence
        self._profile = profile
        self._press_n = profile.force.full_n
        self._least_us = math.ceil(1e6 / profile.limits.rate_hz)
        self._silent_us = max(SILENT_US, self._least_us)
        self._nothing = np.zeros((len(Afferent), len(profile.electrodes)), np.float32)
        self._loop: Loop | None = None  # loop of the current run
        self._context: RunContext
        self._mapper: TactileMapper
        self._outside = "use the session in a `with` block"
        self._failed: BaseException | None = None
        self._input: Input | None = None
        self._result: StepResult
        self._count = 0  # number of shown patterns
        self._last_number: int | None = None
        # Threads share the attributes below. `_waiting` has one entry for each waiting thread.
        self._turns, self._waiting = threading.Lock(), deque[object]()
        self._news, self._put_lock = threading.Event(), threading.Lock()
        self._put: tuple[NDArray[np.float32] | Frame, int, int] = (self._nothing, 0, 0)
        """Latest pattern of `put`, time of the call, and time from which the pattern is stale.
        Times are by `time.monotonic_ns`."""
        self._is_new = False  # whether the latest pattern of `put` has not been sent
        self._put_count = 0  # number of the latest pattern of `put`
        self._missed = 0  # number of patterns of `put` that were replaced before they were sent
        self._putter: threading.Thread | None = None

    def program(self) -> None:
        """Show all patterns; the run ends when this returns. Exceptions end the run, too."""

    def perform(self, loop: Loop) -> None:
        """Execute the program with the loop of a run."""
        self._loop = loop
        try:
            self.program()
        except SmartTouchError:
            # After a stop, each attempt to show a pattern raises an error. Ignore this error.
            if self._failed is not None or not loop.stop.event.is_set():
                raise
        finally:
            self._leave()
        if self._failed is not None:
            raise self._failed
        loop.end()

    def _leave(self) -> None:
        """Accept no more patterns; wait until no other thread shows one."""
        self._loop = None
        self._news.set()
        with self._turns:
            pass
        if self._putter is not None:
            self._putter.join()

    def start(self, run: RunContext) -> None:
        self._context, self.controls = run, run.controls
        self._mapper = TactileMapper(run.profile, run.config.light_on_dark, run.config.tone)

    def step(self, result: StepResult) -> None:
        self._result = result
        if result.input.number != self._last_number:
            self.frames += 1
            self._last_number = result.input.number

    def read(self, time_ns: int) -> Input | None:
        """Return the stimulus to send next."""
        return self._input

    def rise(
        self, level: float = 1.0, pattern: Pattern | None = None, exact: bool = False
    ) -> float:
        """Raise the ramp to a level, with pulses near the threshold; return the duration, s.

        Parameters
        ----------
        level : float, in [0, 1]
            Share of the session's intensity.
        pattern : ndarray or Frame, optional
            Pattern (see `show`) whose electrodes carry the pulses; by default the middle electrode.
        exact : bool
            If false, force and the user's level lower the level that the ramp must reach.

        Raises
        ------
        LevelNotReachedError
            If the level cannot be reached, for example without a pressing finger.
        """
        checked = self.checked(pattern)
        with self._turn():
            return self._rise(level, checked, exact)

    def show(
        self,
        pattern: Pattern,
        seconds: float,
        level: Level = 1.0,
        *,
        rate_hz: float | None = None,
        opens: float | None = None,
        least: float = STEADY,
        exact: bool = False,
    ) -> Shown:
        """Show a pattern for some time, and return at the end of the pattern.

        If the ramp is below the level ``opens``, this method first raises the ramp, as `rise` does.

        Parameters
        ----------
        pattern : ndarray or Frame
            Activation of the mode's class, (E,), or of each class, (3, E), in [0, 1]; or an image,
            (H, W) uint8.
        seconds : float, s
            Duration, without the time for the ramp. Give infinity if ``level`` ends the pattern.
        level : float, in [0, 1], or callable
            Share of the session's intensity, or a function that returns this share for the next
            sequence. It takes the seconds since the start, and returns None to end the pattern.
        rate_hz : float, Hz, optional
            Sequences per second; by default the rate of the mode.
        opens : float, in [0, 1], optional
            Level that the ramp must reach before the pattern; by default the pattern's first level.
            With 0, the pattern begins at once.
        least : float, in [0, 1]
            Share of the requested intensity below which the pattern ends with an error.
        exact : bool
            If true, any decrease of force or the user's level ends the pattern; else only to zero.

        Raises
        ------
        LevelNotReachedError
            If the level cannot be reached, or is lost.
        SmartTouchError
            If the pattern is invalid, or the session has ended.
        """
        require_within(SmartTouchError, "seconds", seconds, 0, math.inf, above=True)
        if rate_hz is not None:
            most_hz = self._profile.limits.rate_hz
            require_within(SmartTouchError, "rate_hz", rate_hz, 0, most_hz, above=True)
        elif self.mode is Mode.COLOR:
            rate_hz = self._profile.pulse.rate_hz
        period_us = None if rate_hz is None else round(1e6 / rate_hz)
        checked = self.checked(pattern)
        if opens is None:
            opens = (level(0.0) or 0.0) if callable(level) else level
            require_within(SmartTouchError, "level", opens, 0, 1, above=True)
        with self._turn():
            ramped_s = self._rise(opens, checked, exact) if opens else 0.0
            if ramped_s:
                self.emit(Note(self.now_ns, f"a pattern waited {ramped_s:.2f} s for the ramp"))
            shown = self._play(checked, seconds, level, period_us, least, exact)
        return replace(shown, ramped_s=ramped_s)

    def _play(
        self,
        pattern: NDArray[np.float32] | Frame,
        seconds: float,
        level: Level,
        period_us: int | None,
        least: float,
        exact: bool,
    ) -> Shown:
        """Send a pattern for ``seconds``, or until ``level`` returns None."""
        self._count += 1
        begun_ns, clock_ns, first = self.now_ns, time.monotonic_ns(), None
        sequences, pulses, intensity, current_ma = 0, 0, 1.0, 0.0
        while (since_s := (self.now_ns - begun_ns) / 1e9) < seconds:
            part = level(since_s) if callable(level) else level
            if part is None:
                break
            require_within(SmartTouchError, "level", part, 0, 1)
            result = self._send(self._stimulus(pattern, period_us, part))
            first, sequence = result.number if first is None else first, result.sequence
            sequences, pulses = sequences + 1, pulses + sequence.slots
            intensity = min(intensity, sequence.intensity)
            if sequence.slots:
                current_ma = float(np.abs(sequence.current_ua).max()) / 1000
            asked = self._requested(exact)
            lost = result.number is None or result.step.restarted or (asked == 0 and not exact)
            if lost or sequence.intensity < least * asked:
                raise LevelNotReachedError(
                    f"sequence {sequences} of the pattern was too weak or lost: check the finger, "
                    "the user's level, pauses, the computer's load, and the board's connection"
                )
        board, board_us = self._context.board, None
        if first is not None and (start := board.start_of(first)) is not None:
            board_us = start[1]
            if not board.simulated_time:
                # Use the present offset of the two clocks: it changes if the computer is suspended.
                clock_ns = time.monotonic_ns() - (board.clock.now_ns() - start[0])
        return Shown(begun_ns, clock_ns, board_us, sequences, pulses, intensity, current_ma, 0.0)

    def wait(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Wait without current. During the wait, patterns of `put` are not shown.

        Parameters
        ----------
        seconds : float, s, in the time of the run
        until : callable, optional
            Function that returns true to end the wait; called 50 times a second.
        """
        require_within(SmartTouchError, "seconds", seconds, 0, math.inf, above=True)
        with self._turn():
            end_ns = self.now_ns + (math.inf if seconds == math.inf else round(1e9 * seconds))
            # Lengthen the last sequence if the rest of the wait is too short for another one.
            while (left_us := (end_ns - self.now_ns) / 1000) >= self._least_us:
                if until is not None and until():
                    return
                last = left_us <= self._silent_us + self._least_us
                self._send(self._stimulus(self._nothing, int(left_us) if last else self._silent_us))

    async def show_async(
        self, pattern: Pattern, seconds: float, level: Level = 1.0, rate_hz: float | None = None
    ) -> Shown:
        """Show a pattern like `show` while other tasks run; canceling the task ends the pattern."""
        import asyncio

        call = partial(self.show, pattern, seconds, level, rate_hz=rate_hz)
        canceled = threading.Event()
        token = CANCELED.set(canceled)
        running = asyncio.ensure_future(asyncio.to_thread(call))
        CANCELED.reset(token)
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            canceled.set()
            await asyncio.wait([running])
            running.exception()
            raise

    def put(self, pattern: Pattern, stale_s: float = 0.5) -> None:
        """Show a pattern until the next call of `put`, and return at once.

        The pattern begins when the sequence on the board has ended. Once the pattern is stale, no
        current flows. In simulated time, `put` instead sends one sequence and then returns.

        Parameters
        ----------
        pattern : ndarray or Frame
            See `show`.
        stale_s : float, s
            Time from this call until the pattern is stale.
        """
        loop = self._require_loop()
        checked, now_ns = self.checked(pattern), time.monotonic_ns()
        with self._put_lock:
            self._put = checked, now_ns, now_ns + round(1e9 * stale_s)
            self._missed += self._is_new
            self._is_new = True
            if self._putter is None and not loop.is_simulated:
                self._putter = threading.Thread(target=self._follow, name="put", daemon=True)
                self._putter.start()
        self._news.set()
        if loop.is_simulated:
            with self._turn():
                self._send(self._newest())

    def _follow(self) -> None:
        """Send the latest pattern of `put` repeatedly while no thread shows another pattern."""
        try:
            while True:
                while self._waiting:
                    time.sleep(_POLL_S)
                with self._turn(waits=False) as loop:
                    while not self._waiting:
                        self._news.clear()
                        begun_ns, newest = self.now_ns, self._newest()
                        self._send(newest)
                        silent = newest.stale or not newest.activation.any()
                        # In natural mode each sequence lasts until the next pulses are due.
                        again_s = (
                            0 if self.mode is Mode.NATURAL else 1 / self._profile.pulse.rate_hz
                        )
                        left_s = (_IDLE_S if silent else again_s) - (self.now_ns - begun_ns) / 1e9
                        if left_s > 0:
                            self._news.wait(left_s)
                            loop.resume()
                            self.now_ns = loop.elapsed_ns
        except Exception as error:
            # Store the error for the next call from the program. Ignore errors after the run.
            if self._loop is not None and not self._loop.stop.event.is_set():
                self._failed = self._failed or error
                with contextlib.suppress(SmartTouchError):
                    self._context.board.stop()

    def _newest(self) -> Stimulus:
        """Return the latest pattern of `put`. The pattern gets a new number if it is new, or if it
        is shown again after another pattern."""
        with self._put_lock:
            pattern, came_ns, stale_ns = self._put
            if self._is_new or self._count != self._put_count:
                self._count += 1 + self._missed
                self.frames += self._missed
                self.dropped_frames += self._missed
                self._is_new, self._missed, self._put_count = False, 0, self._count
        now_ns = time.monotonic_ns()
        if now_ns >= stale_ns:
            return replace(self._stimulus(self._nothing, self._least_us), stale=True)
        period_us = None if self.mode is Mode.NATURAL else self._least_us
        return replace(self._stimulus(pattern, period_us), age_ns=now_ns - came_ns)

    @contextmanager
    def _turn(self, waits: bool = True) -> Iterator[Loop]:
        """Wait until no other thread shows a pattern, set the next deadline to now, and yield the
        loop. If ``waits`` is true, the thread of `put` lets the calling thread begin."""
        waiting = [object()] * waits
        self._waiting.extend(waiting)
        self._news.set()
        try:
            while not self._turns.acquire(timeout=_POLL_S):
                self._require_loop()
        finally:
            for turn in waiting:
                self._waiting.remove(turn)
        try:
            loop = self._require_loop()
            with loop.steady():
                self.now_ns = loop.elapsed_ns
                yield loop
        finally:
            self._turns.release()

    def _send(self, stimulus: Stimulus) -> StepResult:
        """Send the sequence of a stimulus, wait until it is over, and return the result."""
        loop = self._require_loop()
        self._input = stimulus
        try:
            # Ctrl-C takes effect between two sequences.
            with uninterrupted():
                loop.deliver() and loop.wait()
        except Exception as error:
            self._failed = error
            raise
        self._require_loop()
        self.now_ns = loop.elapsed_ns
        return self._result

    def _require_loop(self) -> Loop:
        """Return the loop. Raises the error that ended the run or canceled the pattern."""
        if self._failed is not None:
            raise self._failed
        loop = self._loop
        if loop is None or loop.stop.event.is_set():
            why = self._outside if loop is None else loop.stop.reason
            raise SmartTouchError(f"the session is not running: {why}")
        if (canceled := CANCELED.get()) is not None and canceled.is_set():
            raise SmartTouchError("the pattern was canceled")
        return loop

    def _rise(self, level: float, pattern: NDArray[np.float32] | Frame, exact: bool) -> float:
        """Send weak pulses until the ramp has reached a level; return the time that it took, s."""
        require_within(SmartTouchError, "level", level, 0, 1, above=True)
        begun_ns, faint, active = self.now_ns, _FAINT, self._active_electrodes(pattern)
        while not self._is_open(level, exact):
            if self.now_ns - begun_ns > 1e9 * self.patience_s:
                why = "the user's level or the ramp is low" if self.gate else "no finger presses"
                raise LevelNotReachedError(
                    f"level {level:g} was not reached within {self.patience_s:g} s: {why}"
                )
            self.note_opening()
            weak = np.asarray(np.float32(faint) * active, np.float32)
            sequence = self._send(self._stimulus(weak, self._silent_us, level)).sequence
            if 0 < STEADY * self._requested(exact) <= sequence.intensity:
                # These pulses were too weak to raise the ramp: double their activation. If full
                # activation gives no pulses, no current can flow, and no ramp is needed.
                if faint == 1 and not sequence.slots:
                    return 0.0
                faint = min(1.0, 2 * faint)
        return (self.now_ns - begun_ns) / 1e9

    def note_opening(self) -> None:
        """Report that the ramp is rising, before each weak pulse. Does nothing by default."""

    def _is_open(self, level: float, exact: bool) -> bool:
        asked = level * (1.0 if exact else self.gate * self.user_level)
        is_open = 0 < STEADY * asked <= self._context.board.ramp.open_level(self.now_ns)
        return is_open and self._loop is not None and not self._loop.begins_at_zero()

    def _requested(self, exact: bool) -> float:
        """Return the requested intensity of the latest step."""
        step = self._result.step
        share = force_gate(step.input.force_n, self._profile.force) * step.level
        return step.tactile.level * (1.0 if exact else share)

    def _stimulus(
        self, pattern: NDArray[np.float32] | Frame, period_us: int | None, level: float = 1.0
    ) -> Stimulus:
        """Convert a pattern to a stimulus. For a frame, compute the activation first."""
        force_n, image = self._press_n, None
        if isinstance(pattern, Frame):
            force_n = force_n if math.isnan(pattern.force_n) else pattern.force_n
            image = pattern.image
            frame = replace(pattern, time_ns=self.now_ns, force_n=force_n)
            pattern = self._mapper.map(frame, self.mode).activation
        return Stimulus(
            pattern, self.now_ns, force_n, period_us, level, number=self._count, image=image
        )

    def _active_electrodes(self, pattern: NDArray[np.float32] | Frame) -> NDArray[np.float32]:
        """Return 1 for each active electrode of a pattern, otherwise 0, (3, E). In an empty pattern
        the middle electrode counts as active."""
        mode = self.mode
        if isinstance(pattern, Frame):
            frame = replace(pattern, time_ns=self.now_ns, force_n=self._press_n)
            active = self._nothing.copy()
            shape = self._mapper.map(frame, Mode.RA).activation[Afferent.RA]
            active[list(mode.afferents)] = shape > 0
        else:
            active = np.asarray(pattern > 0, np.float32)
        if not active.any():
            place_mm, driven = self._profile.electrodes.position_mm, self._profile.driven
            away_mm = np.hypot(*(place_mm[driven] - place_mm.mean(axis=0)).T)
            active[mode.afferents[0], driven[away_mm.argmin()]] = 1
        return active

    def checked(self, pattern: Pattern | None) -> NDArray[np.float32] | Frame:
        """Convert a pattern to activation, (3, E), or a frame. Raises SourceError if impossible."""
        electrodes, mode = self._nothing.shape[1], self.mode
        if pattern is None:
            return self._nothing
        if isinstance(pattern, TactileImage):
            pattern = pattern.activation
        if isinstance(pattern, Frame):
            return replace(pattern, image=gray_image(pattern.image, "the program"))
        array = np.asarray(pattern)
        if array.shape == (electrodes,):
            if len(mode.afferents) != 1:
                raise SourceError(
                    f"mode {mode} drives several classes: give activation as (3, {electrodes})"
                )
            activation = np.zeros(self._nothing.shape)
            activation[mode.afferents[0]] = array
            array = activation
        elif array.shape != self._nothing.shape and array.dtype.kind in "fbiu":
            if array.ndim == 2 and array.dtype.kind in "ub":
                return Frame(gray_image(array, "the program"), 0)
            raise SourceError(
                f"{array.dtype} {array.shape} is not a pattern for this array: give activation "
                f"({electrodes},) or (3, {electrodes}), in [0, 1], or an image (H, W), uint8"
            )
        # Copy, so that later changes by the caller have no effect.
        return checked_activation(array, "the program", electrodes).copy()

    def time_ns(self) -> int:
        """Return the time since the start of the run, ns; after the run, the latest `now_ns`."""
        return self.now_ns if self._loop is None else self._loop.time_ns()

    @property
    def gate(self) -> float:
        """Factor for intensity that follows from the present force of the finger, in [0, 1]."""
        if self._loop is None:
            return 0.0
        force_n = self._loop.inputs.force_n(
            self._stimulus(self._nothing, self._silent_us), self.now_ns
        )
        return force_gate(force_n, self._profile.force)

    @property
    def user_level(self) -> float:
        """Factor for intensity that the user has set, in [0, 1]; 0 while paused."""
        return self.controls.state(self.now_ns).current_level

    @property
    def mode(self) -> Mode:
        """Mode of the run at this time."""
        return self.controls.state(self.now_ns).mode
