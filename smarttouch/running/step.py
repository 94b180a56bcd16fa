"""Steps of a run, from an input to the sequence sent, and whatever listens to them."""

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
"""A sequence that was delivered, and what its source needed in each slot, (S,) V."""


@dataclass(frozen=True, eq=False)
class Step:
    """One input's way to a sequence, and all that it depended on.

    ``input`` has the force that counted, ``sequence`` is as sent, ``level`` what the user asked
    for, [0, 1]; ``restarted`` says that intensity began at zero here, ``asked_us`` the period that
    was wanted, ``observed`` what the board had measured until then, ``allowed`` the strength that
    its ramp allowed, None without a board.
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
        The board's number of the sequence.
    latency_us : float, µs
        From the taking of its image to its first pulse.
    waited_us : float, µs
        From its last byte written to its first pulse.
    """

    number: int
    latency_us: float
    waited_us: float


@dataclass(frozen=True, eq=False)
class StepResult:
    """One step, and how it was sent.

    Attributes
    ----------
    step : Step
    number : int or None
        The board's number of its sequence; None if the board was lost with it.
    latency_us : float
        From the input in hand to the last byte written.
    work_us : float
        Processor time that it took the loop.
    acknowledged, refused : int
        Sequences that the board had begun to deliver, or declined, until then.
    clock_ns : int
        Real time since the start at which the loop began the step: later than that of its input by
        all delays of the computer until then. -1 if unknown.
    first_pulse : FirstPulse or None
        Of the newest sequence whose start the board has reported since the step before: one or two
        before this. None for boards that never report it.

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
        """Frame or stimulus that the step began with."""
        return self.step.input

    @property
    def tactile(self) -> TactileImage:
        """Activation of each class at each electrode."""
        return self.step.tactile

    @property
    def sequence(self) -> ScanSequence:
        """Sequence that was sent."""
        return self.step.sequence

    @property
    def delivered_ma(self) -> NDArray[np.float32]:
        """Current at each point that is stimulated, (E,) mA; 0 where none is."""
        sequence = self.step.sequence
        delivered_ma = np.zeros(sequence.electrodes, np.float32)
        current_ma = np.abs(sequence.current_ua.astype(np.float32)) / 1000
        delivered_ma[sequence.site] = current_ma.max(axis=1, initial=0)
        if sequence.points > sequence.slots:
            # Several share a slot.
            points = np.flatnonzero(self.step.tactile.activation.any(axis=0))
            delivered_ma[points] = current_ma.max(axis=0)[points]
        return delivered_ma


@dataclass
class RunContext:
    """Parts of a run that its listeners may look at, and must not change.

    ``settings`` is all that sequences depend on and where it came from, ready for JSON.
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
    """Follows a run; each method does nothing unless it is overridden.

    An exception in any of them ends the run, with the board at zero.

    Attributes
    ----------
    notes : list of str
        Sentences for the user after the run.
    vibrates_pc : bool
        Whether PC gets vibration from it, and so no current.

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
        """Do all that takes long: the board is not open yet."""

    def start(self, run: RunContext) -> None:
        """Begin: the board is open, at zero."""

    def step(self, result: StepResult) -> None:
        """Process a step; called by the loop, so it must be quick."""

    def event(self, event: Event) -> None:
        """Process an event, also before the start; from any thread."""

    def finish(self, run: RunContext) -> None:
        """Complete what only a run without a fault has: the board is closed."""

    def close(self) -> None:
        """Release everything, whatever has happened; a second call does nothing."""


class OnStep(Listener):
    """Calls a function with each `StepResult`."""

    def __init__(self, function: Callable[[StepResult], object]) -> None:
        super().__init__()
        self.function: Callable[[StepResult], object] = function

    def step(self, result: StepResult) -> None:
        self.function(result)


class OnEvent(Listener):
    """Calls a function with each `Event`."""

    def __init__(self, function: Callable[[Event], object]) -> None:
        super().__init__()
        self._function = function

    def event(self, event: Event) -> None:
        self._function(event)


def as_listeners(followers: Iterable[Listener | Callable[[StepResult], object]]) -> list[Listener]:
    """Return listeners; plain functions are called with each step.

    Raises a SmartTouchError for what is neither.
    """
    listeners = list(followers)
    for listener in listeners:
        if isinstance(listener, type) or not (isinstance(listener, Listener) or callable(listener)):
            raise SmartTouchError(
                f"{getattr(listener, '__name__', kind_in_words(listener))} is not a listener: give "
                "an object of a subclass of Listener, or a function of a StepResult"
            )
    return [entry if isinstance(entry, Listener) else OnStep(entry) for entry in listeners]
