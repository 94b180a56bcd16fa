"""Listeners: whatever follows a run, such as screens, recorders and pictures."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from smarttouch.base.errors import SmartTouchError, kind_in_words
from smarttouch.base.events import Event
from smarttouch.running.step import StepResult

if TYPE_CHECKING:
    from smarttouch.boards.board import Board
    from smarttouch.kernels.bank import KernelBank
    from smarttouch.profile import Profile
    from smarttouch.running.config import RunConfig
    from smarttouch.running.inputs import Controls
    from smarttouch.running.run_statistics import RunStatistics
    from smarttouch.sources.source_contract import Source


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


def as_listeners(given: Iterable[Listener | Callable[[StepResult], object]]) -> list[Listener]:
    """Return listeners; plain functions are called with each step.

    Raises a SmartTouchError for what is neither.
    """
    listeners = []
    for each in given:
        if isinstance(each, type) or not (isinstance(each, Listener) or callable(each)):
            what = f"the class {each.__name__}" if isinstance(each, type) else kind_in_words(each)
            raise SmartTouchError(
                f"{what} is no listener: give an object of a subclass of Listener, or a function "
                "of a StepResult"
            )
        listeners.append(each if isinstance(each, Listener) else OnStep(each))
    return listeners
