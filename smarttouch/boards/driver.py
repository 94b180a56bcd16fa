"""Interface of drivers: what a board asks of the device that it drives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

from smarttouch.boards.reports import BoardReport, Capabilities
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.stimulation.scan_sequence import ScanTiming

if TYPE_CHECKING:
    from smarttouch.boards.line import Line
    from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
    from smarttouch.stimulation.scan_sequence import KernelTable

__all__ = ["Driver"]


class Driver(ABC):
    """Translator between a `Board` and one kind of device.

    The board owns the safety gate, ramp, clock, stop, sender thread and recovery. It calls the
    methods below, and everything that a driver sends goes through the `Line` that `open` receives.
    A driver reports what it finds out to the line. It needs no lock, no thread and no clock.

    Parameters of a driver that is opened by a URL are the text after the colon, the limits of the
    finger (a copy), the output section of the profile or None, and options by keyword.
    """

    default_profile: ClassVar[str] = DEFAULT_PROFILE
    """Name of the profile that goes with such a device."""
    takes_wiring: ClassVar[bool] = False
    """Whether the user wires the outputs, so that a profile may have ``output.wiring``."""
    keeps_kernels: ClassVar[bool] = False
    """Whether the device can store kernels, so that slots should be sums of them."""
    timing: ScanTiming = ScanTiming()
    """Scan timing fixed by the device; known before it is opened."""
    port: str | None = None
    """Name of the device's port, by which faults are recorded; None if it has none."""

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
        """Send a sequence to the device, by `Line.write` or within `Line.current`.

        Where the host times the passes (`Capabilities.host_timed`), this lasts as long as they do,
        and returns early once `Line.has_newer`. An error is raised by the next `Board.send` then.
        """

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

    def idle(self) -> float | None:
        """Send heartbeats and read answers between writes, in the board's sender thread.

        It is called once the device is open, and after each `write` of that thread.

        Returns
        -------
        float or None
            Seconds after which to call it again; None if not before the next write.
        """
        return None

    def store_kernels(self, table: KernelTable) -> None:  # noqa: B027, optional for drivers
        """Give the device the kernels of the sequences to come."""

    def status(self) -> BoardReport | None:
        """Return the device's own report of what it delivered; None to use the host's."""
        return None
