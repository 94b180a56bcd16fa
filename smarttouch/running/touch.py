"""Operations of a program on an open board, open a level, show, put, wait, pause; and a program as
the source of a run."""

import asyncio
import math
import threading
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import LevelNotReachedError, SmartTouchError, require_within
from smarttouch.base.events import Note
from smarttouch.profile import Profile
from smarttouch.running.session_feed import Pattern, SessionFeed
from smarttouch.running.show_request import Level, Show
from smarttouch.sources.source_contract import Frame, Input

_PATIENCE_S = 10.0


@dataclass(frozen=True)
class Shown:
    """How a pattern was shown.

    Attributes
    ----------
    time_ns : int
        When its first sequence was sent, since the start of the session.
    clock_ns : int
        When its first pulse began, by the machine's clock, `time.monotonic_ns`; when it was sent,
        if the board does not report when it began.
    board_us : int or None, µs
        When its first pulse began, by the board's own clock; None if the board does not report it.
    sequences, pulses : int
        Sequences sent, and the slots of all of them.
    intensity : float, in [0, 1]
        The lowest of its sequences.
    current_ma : float, mA
        Strongest current of its last pulses, of either sign.
    ramped_s : float, s
        How long its level took to open before it; 0 where it was open.
    """

    time_ns: int
    clock_ns: int
    board_us: int | None
    sequences: int
    pulses: int
    intensity: float
    current_ma: float
    ramped_s: float


class Touch:
    """Patterns of a program on an open board: base of `Session`.

    Its methods may be called from any thread; what is shown comes one after another.
    """

    def __init__(self, feed: SessionFeed) -> None:
        self._feed = feed
        self._turn = threading.Lock()

    # -- what is shown ------------------------------------------------------

    def rise(self, level: float = 1.0, pattern: Pattern | None = None) -> float:
        """Open a level by its ramp, with pulses of threshold; return how long it took, s.

        Parameters
        ----------
        level : float, in [0, 1]
            Part of the session's intensity.
        pattern : ndarray or Frame, optional
            Where these pulses are, see `show`; in the middle of the array if not given.

        Raises
        ------
        LevelNotReachedError
            If it cannot be opened, as where no finger presses.
        """
        return self.result(self.present(self._rising(level, pattern))).ramped_s

    def show(
        self,
        pattern: Pattern,
        seconds: float,
        level: Level = 1.0,
        *,
        rate_hz: float | None = None,
        at_ns: int | None = None,
    ) -> Shown:
        """Show a pattern for some time, and return when it is over.

        Where its level is not open, pulses of threshold open it first.

        Parameters
        ----------
        pattern : ndarray or Frame
            Activation of the mode's class, (E,), or of each class, (3, E), in [0, 1]; or an image,
            (H, W) uint8.
        seconds : float, s
        level : float, in [0, 1], or callable
            Part of the session's intensity; or a function of the seconds since it began that
            returns it for each sequence, and None to end.
        rate_hz : float, Hz, optional
            Sequences a second; those of the mode if not given.
        at_ns : int, optional
            When it is to begin, by `time.monotonic_ns`; as soon as may be if not given, and in
            simulated time.

        Raises
        ------
        LevelNotReachedError
            If the level cannot be opened, or was lost meanwhile.
        SmartTouchError
            If the pattern is none, or the session has ended.
        """
        return self.result(self.present(self._showing(pattern, seconds, level, rate_hz, at_ns)))

    def wait(self, seconds: float) -> None:
        """Let no current flow for some time, simulated where the board's is; what is put waits."""
        _require_time(seconds)
        self.result(self.present(Show(None, 1.0, seconds)))

    async def show_async(
        self,
        pattern: Pattern,
        seconds: float,
        level: Level = 1.0,
        *,
        rate_hz: float | None = None,
        at_ns: int | None = None,
    ) -> Shown:
        """Show a pattern as `show` does, while other tasks go on; ends with its task."""
        return await self._awaited(self._showing(pattern, seconds, level, rate_hz, at_ns))

    async def rise_async(self, level: float = 1.0, pattern: Pattern | None = None) -> float:
        """Open a level as `rise` does, while other tasks go on; ends with its task."""
        return (await self._awaited(self._rising(level, pattern))).ramped_s

    def put(self, pattern: Pattern, stale_s: float = 0.5) -> None:
        """Show a pattern from now on, until the next one or until it is stale; return at once.

        The newest wins, and begins as soon as what is under way has ended. A stale one makes no
        current.

        Parameters
        ----------
        pattern : ndarray or Frame
            See `show`.
        stale_s : float, s
        """
        self._feed.put(self._checked(pattern), round(1e9 * stale_s))

    def present(self, show: Show) -> Show:
        """Carry out a request; its fault describes what went wrong."""
        with self.begun(show):
            show.over.wait()
        self._require_life()
        return show

    @contextmanager
    def begun(self, show: Show) -> Iterator[None]:
        """Begin a request; it is canceled if the block does not wait for its end."""
        with self._turn:
            self._require_life()
            self._feed.begin(show)
            try:
                yield
            finally:
                self._feed.cancel(show)

    def _rising(self, level: float, pattern: Pattern | None) -> Show:
        _require_level(level)
        return Show(self._checked(pattern), level, 0.0, opens=level, patience_s=_PATIENCE_S)

    def _showing(
        self,
        pattern: Pattern,
        seconds: float,
        level: Level,
        rate_hz: float | None = None,
        at_ns: int | None = None,
    ) -> Show:
        _require_time(seconds)
        opens = level(0.0) if callable(level) else level
        _require_level(opens)
        most_hz = self._feed.most_hz
        if rate_hz is not None:
            require_within(SmartTouchError, "rate_hz", rate_hz, 0, most_hz, above=True)
        return Show(
            self._checked(pattern), level, seconds, opens, _PATIENCE_S, at_ns,
            None if rate_hz is None else round(1e6 / rate_hz),
        )  # fmt: skip

    async def _awaited(self, show: Show) -> Shown:
        try:
            return self.result(await asyncio.to_thread(self.present, show))
        except asyncio.CancelledError:
            self._feed.cancel(show)
            raise

    def _checked(self, pattern: Pattern | None) -> NDArray[np.float32] | Frame:
        self._require_life()
        return self._feed.checked(pattern, self.mode)

    def result(self, show: Show) -> Shown:
        """Return how something was shown; raises a LevelNotReachedError if it was not."""
        self._require_life()
        if show.fault:
            raise LevelNotReachedError(show.fault)
        if show.ramped_ns and show.seconds:
            self._feed.emit(
                Note(show.time_ns, f"a pattern waited {show.ramped_ns / 1e9:.2f} s for its level")
            )
        return Shown(
            show.time_ns, show.clock_ns, show.board_us, show.sequences, show.pulses,
            0.0 if show.lowest is None else show.lowest, show.current_ma, show.ramped_ns / 1e9,
        )  # fmt: skip

    def _require_life(self) -> None:
        if self._feed.is_over:
            raise SmartTouchError(f"the session has ended: {self._ended()}")

    def _ended(self) -> str:
        return self._feed.ended

    # -- the user's controls --------------------------------------------------

    @property
    def level(self) -> float:
        """Part of the strongest comfortable current that flows at level 1; changed at any time."""
        return self._feed.controls.state(0).level

    @level.setter
    def level(self, level: float) -> None:
        self._feed.controls.change_level(level - self.level)

    @property
    def mode(self) -> Mode:
        """Afferents that are driven."""
        return self._feed.controls.state(0).mode

    @mode.setter
    def mode(self, mode: Mode | str) -> None:
        offered = self._feed.controls.modes
        chosen = next((each for each in offered if each == mode), None)
        if chosen is None:
            names = ", ".join(str(each) for each in offered)
            raise SmartTouchError(f"mode {mode} is not offered here: choose {names}")
        self._feed.controls.choose_mode(chosen)

    def pause(self) -> None:
        """Let no current flow until `resume`."""
        self._feed.controls.pause()

    def resume(self) -> None:
        """Go on; intensity begins at zero."""
        self._feed.controls.resume()


def _require_time(seconds: float) -> None:
    if not 0 < seconds < math.inf:
        raise SmartTouchError(f"seconds {seconds:g} must be above 0")


def _require_level(level: float | None) -> None:
    if level is None or not 0 < level <= 1:
        raise SmartTouchError(f"level {level} must be above 0 and at most 1")


class ProgramSource(SessionFeed):
    """Source whose `program` is a user of a session, as programs of `Display.session` are.

    The run ends with it, and raises what it raises.
    """

    fixed_mode = True
    ended = "the program has ended"

    def __init__(self, title: str, profile: Profile) -> None:
        super().__init__(profile, title)
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._go, name="program", daemon=True)

    @abstractmethod
    def program(self, touch: Touch) -> None:
        """Show what there is to show."""

    def read(self, time_ns: int) -> Input | None:
        """Return what the program shows now, from the first read on; None once it has ended."""
        if self._thread.ident is None and not self.is_over:
            self._thread.start()
        given = super().read(time_ns)
        if given is None and self._failed is not None:
            raise self._failed
        return given

    def close(self) -> None:
        """End the program at what it shows next."""
        super().close()
        if self._thread.is_alive():
            self._thread.join()

    def _go(self) -> None:
        try:
            self.program(Touch(self))
        except BaseException as error:
            # What is shown when a run is over raises.
            if not self.is_over:
                self._failed = error
        finally:
            self.end()
