"""Interface of drivers: what a board's device is told, and what the driver reports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError, BoardFaultError
from smarttouch.boards.reports import BoardReport, Capabilities, SequenceStart
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.stimulation.scan_sequence import ScanTiming

if TYPE_CHECKING:
    from smarttouch.boards.board import Board
    from smarttouch.boards.line import Line
    from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
    from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence

__all__ = ["Driver", "Events"]

_MOST_STARTS = 256


class Driver(ABC):
    """Translator between a `Board` and one kind of device.

    The board owns the safety gate, ramp, clock, stop, sender thread and recovery. It calls the
    methods below, and everything that a driver sends goes through the `Line` that `open` receives.
    A driver needs no lock, no thread and no clock.

    Parameters of a driver that is opened by a URL are the text after the colon, the limits of the
    finger (a copy), the output section of the profile or None, and options by keyword.
    """

    default_profile: ClassVar[str] = DEFAULT_PROFILE
    """Name of the profile that goes with such a device."""
    takes_wiring: ClassVar[bool] = False
    """Whether the user wires the outputs, so that a profile may have ``output.wiring``."""
    keeps_kernels: ClassVar[bool] = False
    """Whether the device can store kernels, so that slots should be sums of them."""
    queued: ClassVar[bool] = False
    """Whether `write` lasts as long as the scan. The board's sender thread then calls it, and a
    newer sequence replaces one that waits."""
    waits_s: ClassVar[float] = 0.0
    """Time for which a sequence waits in the queue, beside four of its periods, before it replaces
    the one before it; 0 if it replaces it at once."""
    idle_s: ClassVar[float] = 0.0
    """Time after a write at which the sender thread calls `idle`; 0 if it never does."""
    reports_delivery: ClassVar[bool] = False
    """Whether the driver calls `Events.started` or `Events.delivered`. Otherwise a sequence counts
    as delivered once it is written."""
    reports_starts: ClassVar[bool] = False
    """Whether the driver calls `Events.started`."""
    simulated_time: ClassVar[bool] = False
    """Whether time passes only as sequences state it (built-in boards without a finger)."""
    timing: ScanTiming = ScanTiming()
    """Scan timing fixed by the device; known before it is opened."""
    port: str | None = None
    """Name of the device's port, by which faults are recorded; None if it has none."""
    ua_per_count: float | None = None
    """Current scale of the device, µA, if it can be calibrated."""

    @abstractmethod
    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        """Connect, check that it is the right device, and put all electrodes at zero.

        It is called again after the connection was lost, with ``line.reopened`` set.

        Parameters
        ----------
        line : Line
            The way to the device; keep it.
        limits : SafetyLimits
            A copy, for the device's firmware and for bounds of counts.

        Raises
        ------
        BoardError
            If it is not this device, or does not answer.
        """

    @abstractmethod
    def write(self, proved: ProvedSequence) -> None:
        """Send a sequence to the device, by `Line.write` or within `Line.current`."""

    @abstractmethod
    def zero(self) -> None:
        """Put all electrodes at zero, from any thread and at any instant, also within `write`.

        Raises
        ------
        BoardError
            If it is not certain that all electrodes are at zero.
        """

    def close(self) -> None:  # noqa: B027, optional for drivers
        """Release what `open` took, also where `open` has failed; the board closes the line."""

    def check(self, proved: ProvedSequence) -> None:  # noqa: B027, optional for drivers
        """Raise BoardError if the device cannot make a sequence; called before it is queued."""

    def idle(self) -> float | None:
        """Send heartbeats and read answers between writes.

        Returns
        -------
        float or None
            Seconds after which to call it again; None for `idle_s` after the next write.
        """
        return None

    def is_busy(self) -> bool:
        """Return whether the device still has sequences to deliver."""
        return False

    def store_kernels(self, table: KernelTable) -> None:  # noqa: B027, optional for drivers
        """Give the device the kernels of the sequences to come."""

    def status(self) -> BoardReport | None:
        """Return the device's own report of what it delivered; None to use the host's."""
        return None

    def aftermath(self) -> str:
        """Return the end of messages about a lost connection: what the electrodes do then."""
        return ""

    @property
    def refused_packets(self) -> int:
        """Number of packets from the device that were old, of another session, or not requested."""
        return 0


class Events:
    """What a driver reports to its board, from any thread: ``line.events``."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def note(self, text: str) -> None:
        """Tell the user something at the end of the run."""
        self._board.notes.append(text)

    def force(self, force_n: float) -> None:
        """Report the force of the finger, N."""
        self._board.force_n = force_n

    def lift(self, lifted: bool) -> None:
        """Report whether nothing touches the electrodes."""
        self._board.lifted = lifted

    def volts(self, sequence: ScanSequence, volts: NDArray[np.float32]) -> None:
        """Report the voltage that each slot of a delivered sequence needed, (S,) V."""
        self._board._volts.append((sequence, volts))

    def started(self, start: SequenceStart) -> None:
        """Report when a sequence began on the device."""
        starts = self._board._starts
        starts[start.number] = start
        self._board.acknowledged += 1
        if len(starts) > _MOST_STARTS:
            del starts[next(iter(starts))]

    def delivered(self, proved: ProvedSequence, scans: int, most: int | None = None) -> None:
        """Report that so many more passes were made, or at least that and at most ``most``."""
        self._board._count(proved, scans, most)

    def refused(self) -> None:
        """Report that the device refused a sequence."""
        self._board.refused += 1

    def replaced(self) -> None:
        """Report that `Driver.write` gave up a sequence before its first pass, for a newer one."""
        self._board.replaced += 1

    def fail(self, error: BoardError) -> None:
        """Report an error that the next call of the board raises; LineLostError reconnects."""
        self._board._fail(error)

    def fault(self, reason: str) -> BoardFaultError:
        """Put the board at zero for good, record its fault, and return the error to raise."""
        return self._board._latch(reason)
