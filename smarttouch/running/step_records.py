"""Steps of a run: inputs with the scan sequences made from them. Base class of listeners."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import SmartTouchError, kind_in_words
from smarttouch.base.events import Event
from smarttouch.base.tactile_image import TactileImage, one_line
from smarttouch.sources.source_contract import Input
from smarttouch.stimulation.scan_sequence import ScanSequence

if TYPE_CHECKING:
    from smarttouch.boards.board import Board
    from smarttouch.kernels.bank import KernelBank
    from smarttouch.profile import Profile
    from smarttouch.running.config import RunConfig
    from smarttouch.running.loop import Controls
    from smarttouch.running.run_statistics import RunStatistics
    from smarttouch.sources.source_contract import Source

Measured = tuple[ScanSequence, NDArray[np.float32]]
"""Delivered sequence, with the voltage of the board's current source in each slot, (S,) V."""


@dataclass(frozen=True, eq=False)
class Step:
    """Input, the scan sequence made from it, and everything that the sequence depended on.

    The force of ``input`` is the effective force. ``level``, in [0, 1], is the user's intensity.
    ``restarted`` is true if intensity restarted at zero. ``asked_us`` is the requested period.
    ``observed`` contains the voltages that the board measured since the previous step. ``allowed``
    is the largest strength that the board's ramp allowed; it is None without a board.
    """

    __repr__ = one_line

    input: Input
    tactile: TactileImage
    sequence: ScanSequence
    mode: Mode
    level: float = 1.0
    restarted: bool = False
    asked_us: int = 0
    observed: tuple[Measured, ...] = ()
    allowed: float | None = None


@dataclass(frozen=True)
class FirstPulse:
    """Start of the first pulse of a sequence.

    Attributes
    ----------
    number : int
        Number of the sequence on its board.
    latency_us : float, µs
        Time from the capture of the image to the first pulse.
    waited_us : float, µs
        Time from writing the last byte of the sequence to its first pulse.
    """

    number: int
    latency_us: float
    waited_us: float


@dataclass(frozen=True, eq=False)
class StepResult:
    """Step, and the result of sending its sequence.

    Attributes
    ----------
    step : Step
    number : int or None
        Number of the sequence on its board; None if the sequence was late, or was lost.
    latency_us : float
        Time from reading the input to writing the last byte of the sequence.
    work_us : float
        Processor time of the loop for this step.
    acknowledged, refused : int
        Number of sequences that the board had begun to deliver, and number that it had refused.
    clock_ns : int
        Real time from the start of the run to the start of the step, including all delays; -1 if
        unknown.
    first_pulse : FirstPulse or None
        First pulse of a sequence, reported by the board since the previous step. If the board
        reported several, the newest. If it reported none, None.

    Examples
    --------
    >>> import smarttouch as st
    >>> results, display = [], st.open_display("simulated:")
    >>> source = st.open_source("text:a", display.profile)
    >>> statistics = st.run(source, display, seconds=0.1, listeners=[results.append])
    >>> [result.number for result in results]
    [1, 2, 3, 4, 5]
    """

    __repr__ = one_line

    step: Step
    number: int | None
    latency_us: float
    work_us: float = 0.0
    acknowledged: int = 0
    refused: int = 0
    first_pulse: FirstPulse | None = None
    clock_ns: int = -1

    @property
    def input(self) -> Input:
        """Frame or stimulus of the step."""
        return self.step.input

    @property
    def tactile(self) -> TactileImage:
        """Activation of each class at each electrode."""
        return self.step.tactile

    @property
    def sequence(self) -> ScanSequence:
        """Scan sequence of the step."""
        return self.step.sequence

    @property
    def delivered_ma(self) -> NDArray[np.float32]:
        """Current at each stimulated electrode, (E,) mA, magnitude; 0 at all other electrodes."""
        sequence = self.step.sequence
        delivered_ma = np.zeros(sequence.electrodes, np.float32)
        current_ma = np.abs(sequence.current_ua.astype(np.float32)) / 1000
        delivered_ma[sequence.site] = current_ma.max(axis=1, initial=0)
        if sequence.points > sequence.slots:
            # In a shared slot, `site` names only the first of several points.
            points = np.flatnonzero(self.step.tactile.activation.any(axis=0))
            delivered_ma[points] = current_ma.max(axis=0)[points]
        return delivered_ma


@dataclass
class RunContext:
    """Objects of a run that listeners may read, but must not change.

    ``settings`` contains the run's settings as a recording stores them, in JSON.
    """

    source: "Source"
    board: "Board"
    profile: "Profile"
    bank: "KernelBank"
    config: "RunConfig"
    controls: "Controls"
    statistics: "RunStatistics"
    settings: dict[str, Any]


class Listener:
    """Base class of listeners, which receive the steps and events of a run.

    Methods do nothing by default. An exception in any method ends the run, with the board at zero.

    Attributes
    ----------
    notes : list of str
        Sentences for the user after the run.
    vibrates_pc : bool
        Whether this listener drives a mechanical vibrator for PC. PC then gets no current.

    Examples
    --------
    >>> import smarttouch as st
    >>> class Strongest(st.Listener):
    ...     most_ua = 0
    ...     def step(self, result):
    ...         self.most_ua = max(self.most_ua, abs(result.sequence.current_ua).max(initial=0))
    >>> strongest, display = Strongest(), st.open_display("simulated:")
    >>> source = st.open_source("text:a", display.profile)
    >>> statistics = st.run(source, display, seconds=1, listeners=[strongest])
    >>> bool(0 < strongest.most_ua <= 1000 * display.profile.limits.current_ma)
    True
    """

    notes: list[str]
    vibrates_pc: bool = False

    def __init__(self) -> None:
        self.notes = []

    def prepare(self, run: RunContext) -> None:
        """Do slow preparations, before the board is opened."""

    def start(self, run: RunContext) -> None:
        """Begin to follow the run. The board is open and at zero."""

    def step(self, result: StepResult) -> None:
        """Process a step, quickly, because the loop waits for the end of this call."""

    def event(self, event: Event) -> None:
        """Process an event. Any thread may call this, even before `start`."""

    def finish(self, run: RunContext) -> None:
        """Complete the results. Called after a run without a fault, when the board is closed."""

    def close(self) -> None:
        """Release resources, also after a fault; a second call does nothing."""


class OnStep(Listener):
    """Listener that calls a function with each `StepResult`."""

    def __init__(self, function: Callable[[StepResult], object]) -> None:
        super().__init__()
        self.function: Callable[[StepResult], object] = function

    def step(self, result: StepResult) -> None:
        self.function(result)


class OnEvent(Listener):
    """Listener that calls a function with each `Event`."""

    def __init__(self, function: Callable[[Event], object]) -> None:
        super().__init__()
        self._function = function

    def event(self, event: Event) -> None:
        self._function(event)


def as_listeners(followers: Iterable[Listener | Callable[[StepResult], object]]) -> list[Listener]:
    """Return a list of listeners, with each plain function wrapped in `OnStep`.

    Raises SmartTouchError for an object that is neither a listener nor a function.
    """
    listeners = list(followers)
    for listener in listeners:
        if isinstance(listener, type) or not (isinstance(listener, Listener) or callable(listener)):
            raise SmartTouchError(
                f"{getattr(listener, '__name__', kind_in_words(listener))} is not a listener: give "
                "an instance of a subclass of Listener, or a function that takes a StepResult"
            )
    return [entry if isinstance(entry, Listener) else OnStep(entry) for entry in listeners]
