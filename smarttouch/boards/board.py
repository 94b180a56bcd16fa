"""The contract that every display board keeps."""

import threading
from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self

from smarttouch.errors import BoardError
from smarttouch.registry import find_opener
from smarttouch.scan.safety import SafetyGate, SafetyLimits
from smarttouch.scan.sequence import ScanSequence


@dataclass(frozen=True)
class Capabilities:
    """What a board says it can do."""

    electrodes: int
    output: Literal["weighted", "three-state", "one-against-all"]
    max_current_ma: float
    max_slots: int
    time_to_zero_ms: float
    """Longest time from the host's silence to all electrodes shorted."""
    firmware: str


@dataclass(frozen=True)
class BoardReport:
    """The board's own account of what it delivered since it was opened."""

    sequences: int
    slots: int
    pulses: int
    """Electrode pulses: one for each electrode that carried current in a slot."""
    violations: int
    max_current_ma: float
    max_charge_uc: float
    max_net_charge_uc: float
    """Worst electrode's charge left after a slot's discharge."""


class Board(ABC):
    """A display board.

    A driver implements the four underscored methods. `send` cannot be reached
    around: it proves every sequence safe before the driver sees it.

    Parameters
    ----------
    limits : SafetyLimits
        From the profile of the finger on the board.
    """

    capabilities: Capabilities
    acknowledged: int = 0
    """Sequences the board has begun to deliver."""
    refused: int = 0
    """Sequences the board has declined or dropped."""

    def __init__(self, limits: SafetyLimits) -> None:
        self._gate = SafetyGate(limits)
        self._stopped = threading.Event()
        self._opened = False

    def open(self) -> None:
        """Connect, shake hands, and put all electrodes at zero."""
        if self._opened:
            raise BoardError("the board is open already: close it first")
        # A new run starts from zero intensity, and its time may start anew.
        self._gate = SafetyGate(self._gate.limits)
        self._stopped.clear()
        self._open()
        self._opened = True

    def send(self, sequence: ScanSequence) -> int:
        """Prove a sequence safe, then send it.

        Returns
        -------
        int
            The number under which the board will know it.

        Raises
        ------
        SafetyError
            If it breaks a limit; nothing is sent.
        BoardError
            If the board is closed, stopped, of another size, or gone.
        """
        if not self._opened:
            raise BoardError("the board is not open: open it before sending")
        if self._stopped.is_set():
            raise BoardError("the board was stopped: open it again before sending")
        if sequence.electrodes != self.capabilities.electrodes:
            raise BoardError(
                f"the sequence is for {sequence.electrodes} electrodes, the board has "
                f"{self.capabilities.electrodes}: use the profile of this board"
            )
        self._gate.prove(sequence)
        return self._send(sequence)

    def stop(self) -> None:
        """Put all electrodes at zero now, from any thread; nothing can be sent after."""
        self._stopped.set()
        self._stop()

    def close(self) -> None:
        """Put all electrodes at zero and let go of the board."""
        if self._opened:
            self._opened = False
            try:
                self.stop()
            finally:
                self._close()

    @abstractmethod
    def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until everything sent has been delivered, or the time is over."""

    @abstractmethod
    def report(self) -> BoardReport:
        """Return the board's own account."""

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _send(self, sequence: ScanSequence) -> int: ...

    @abstractmethod
    def _stop(self) -> None: ...

    @abstractmethod
    def _close(self) -> None: ...

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except BoardError:
            # What went wrong first is what the user must hear of.
            if error is None:
                raise


def make_board(url: str, limits: SafetyLimits, **options: Any) -> Board:
    """Make the driver for a board's URL; it is not opened yet.

    Raises
    ------
    BoardError
        If no driver has that name.
    """
    opener, rest = find_opener("smarttouch.boards", url, BoardError)
    board: Board = opener(rest, limits, **options)
    return board
