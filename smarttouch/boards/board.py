"""Interface and safety gate of every display board."""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterator
from types import TracebackType
from typing import Any, ClassVar, Self, final

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardClosedError,
    BoardError,
    BoardFaultError,
    BoardRestartedError,
    BoardStoppedError,
    LineLostError,
    SequenceLateError,
)
from smarttouch.boards.faults import latch, refuse_latched
from smarttouch.boards.reports import (
    BOTH,
    BoardReport,
    Capabilities,
    HostStatistics,
    Impedance,
    Polarity,
    SequenceStart,
)
from smarttouch.boards.seal import TimedBoard, make_gate, seal_fault
from smarttouch.boards.stoppable import enter, leave
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.profile.device import Output
from smarttouch.stimulation.exposure import Dose
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import NanosecondClock, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence

__all__ = ["BOTH", "Board", "BoardReport", "Capabilities", "Polarity"]


FARTHEST_NS = 10_000_000_000  # planned starts farther ahead than this are of another clock


class Board(TimedBoard, ABC):
    """Base class of display boards.

    A driver implements the underscored methods. `send` cannot be bypassed: it proves every
    sequence safe, by the board's own clock, and the driver gets only the frozen copy that was
    proved. Final methods cannot be replaced in a class or an object, and a board whose gate, limits
    or clock were exchanged is put at zero.

    Parameters
    ----------
    limits : SafetyLimits
        From the profile of the finger on the board.
    output : Output, optional
        Output section of the profile: kind, scale, wiring.
    **capabilities
        Fields of `Capabilities`, if they are known before the board is opened; ``electrodes``
        and ``output`` are the profile's if not given.
    """

    default_profile: ClassVar[str] = DEFAULT_PROFILE
    """Name of the default profile of such a board."""
    takes_wiring: ClassVar[bool] = False
    keeps_kernels: ClassVar[bool] = False
    """Whether such boards can store kernels, so that slots should be sums of them."""
    on_a_finger: ClassVar[bool] = True
    """Whether a finger may be on it."""
    drives_in_send: ClassVar[bool] = True
    """Whether `_send` itself writes, at once: it is then called within `_driving`. A driver whose
    `_send` waits, or that writes from a thread of its own, sets this to False and makes each
    write that causes current within ``with self._driving():``."""
    ua_per_count: float | None = None
    """Current scale of the board, if it can be measured."""
    timing: ScanTiming = ScanTiming()
    """Scan timing fixed by the board; known before it is opened."""
    capabilities: Capabilities
    acknowledged: int = 0
    """Number of sequences that the board has begun to deliver."""
    refused: int = 0
    """Number of sequences that the board has refused or dropped."""
    replaced: int = 0
    """Number of sequences replaced by a newer one before they were sent."""
    force_n: float | None = None
    """Finger force, if the board measures it."""
    lifted: bool = False
    """Whether nothing touches the electrodes, by the voltages of the last scan."""

    def __init__(
        self, limits: SafetyLimits, output: Output | None = None, **capabilities: Any
    ) -> None:
        if output is not None and output.wiring is not None and not self.takes_wiring:
            raise BoardError(
                "output.wiring is for boards whose outputs are wired by the user (etactilekit:): "
                "remove it from the profile of this one"
            )
        super().__init__()
        self.notes: list[str] = []
        self._output = output
        if capabilities:
            kind = "weighted" if output is None else output.kind
            known = {"electrodes": limits.electrodes, "output": kind}
            self.capabilities = Capabilities(**(known | capabilities))
        self._gate = make_gate(self, limits.on(output), self._time())
        self._opened = False
        self._openings = 0

    @final
    def open(self) -> None:
        """Connect, shake hands, and put all electrodes at zero.

        From before this begins, other processes can stop a board that a finger may be on. It waits
        up to a second where earlier sequences leave too little room for net current.

        Raises
        ------
        BoardStoppedError
            If the board, or this program, was stopped for good.
        BoardError
            If the displays of this user could drive more current together than
            `CEILING_USER_MA`, and whatever keeps the board from opening.
        """
        if self._opened:
            raise BoardError("the board is open already: close it first")
        self._require_seal()
        refuse_latched(self.device)
        enter(self)
        try:
            self._open_announced()
        except BaseException:
            # Ctrl-C may come when it is open already; and only whoever closes it withdraws it.
            if self._opened:
                self.close()
            else:
                leave(self)
            raise

    @final
    def _open_announced(self) -> None:
        # A new run starts from zero intensity, and its time may start again.
        self._openings += 1
        self._gate.begin_session()
        self._begin_unless_halted()
        if self._stopped.wait(self._gate.net_rest_ns() / 1e9):
            self._go_on_unless_stopped()
        self._host_statistics = HostStatistics(self._gate.limits.electrodes)
        self._open()
        self._opened = True
        self._require_seal()
        if not isinstance(getattr(self, "capabilities", None), Capabilities):
            raise BoardError(
                f"{type(self).__name__} does not set capabilities: do so in __init__, or at the "
                "latest in _open"
            )
        self._go_on_unless_stopped()

    def __repr__(self) -> str:
        electrodes, state = self._gate.limits.electrodes, "open" if self._opened else "closed"
        return f"{type(self).__name__}({electrodes} electrodes, {state})"

    @final
    def send(self, sequence: ScanSequence, times: int = 1, due_ns: int | None = None) -> int:
        """Validate a sequence by the safety gate, then send it.

        It is delivered ``times`` times, one period after another, unless a newer one comes.

        Parameters
        ----------
        sequence : ScanSequence
        times : int
        due_ns : int, optional
            When it was planned to start, by the board's clock; now if not given.

        Returns
        -------
        int
            The number of the sequence on the board.

        Raises
        ------
        SafetyError
            If it breaks a limit; nothing is sent.
        BoardRestartedError
            If the board was lost and is back: begin again at intensity 0.
        SequenceLateError
            If it, or one before it, was too late to be sent: begin again at intensity 0. By the
            time that sequences state, none is late.
        BoardStoppedError
            If the board was stopped.
        BoardError
            If the board is closed, of another size, or gone.
        """
        now_ns, opening = self._clock.now_ns(), self._openings
        self._due_ns = now_ns if due_ns is None else due_ns
        if not self._opened or self._stopped.is_set():
            self._require_open("sending")
            self._go_on_unless_stopped()
        self._require_seal()
        timed = self._time() is not None or self.on_a_finger
        if timed:
            _require_same_clock(self._due_ns, now_ns)
        # By the class: a driver cannot replace it.
        Capabilities.require(self.capabilities, sequence, times)
        times = int(times)
        proved = self._gate.prove(sequence, times)
        try:
            if timed:
                self._refuse_late(self._due_ns)
            with self._driving() if self.drives_in_send else contextlib.nullcontext():
                if opening != self._openings:
                    raise BoardStoppedError(
                        "the board was closed before this was sent: begin at zero"
                    )
                number = self._send(proved, times)
                # Within: by the time that a stop returns, the report includes it.
                if type(self).report is Board.report:
                    self._host_statistics.add(proved, times)
        except SequenceLateError:
            # Nothing was delivered for a while: what comes next begins at zero.
            self._gate.restart()
            raise
        except LineLostError as lost:
            self._go_on_unless_stopped()
            self._recover(lost)
            # Nothing was delivered for a while: what comes next begins at zero.
            self._gate.restart()
            self.notes.append(f"{lost}: restarted")
            raise BoardRestartedError(f"{lost}, and was restarted") from None
        except BoardError:
            # On a stopped board any failure is due to the stop.
            self._go_on_unless_stopped()
            raise
        return number

    @final
    def close_level(self) -> None:
        """Close the intensity level: what comes next begins at zero, as after a lifted finger."""
        self._gate.restart()

    @property
    @final
    def net_charge_pc(self) -> NDArray[np.int64]:
        """Net charge of each electrode since the board was opened, (E,) pC, positive cathodic."""
        return self._gate.net_pc

    @property
    @final
    def dose(self) -> Dose:
        """Dose of current in the skin since the board was opened."""
        return self._gate.dose

    def _time(self) -> NanosecondClock | None:
        """Return the clock of the safety gate: the machine's.

        Only a board that no finger can be on has another, or None: the time that sequences state.
        """
        return self.clock

    @property
    def device(self) -> str | None:
        """Identity that its faults are recorded by: USB serial number, else port; or None."""
        return None

    @final
    def _latch(self, reason: str) -> BoardFaultError:
        """Put the board at zero for good and record its fault; return the error to raise."""
        self._fault_found = BoardFaultError(
            f"{reason}: the board is at zero and latched; have it checked, then clear it with "
            "smarttouch devices clear"
        )
        with contextlib.suppress(BoardError):
            self.halt()
        if self.device is not None:
            latch(self.device, reason)
        return self._fault_found

    @property
    def refused_packets(self) -> int:
        """Number of packets from the board that were old, of another session, or unrequested."""
        return 0

    def start_of(self, number: int) -> SequenceStart | None:
        """Return when a sequence began, by the number that `send` returned.

        None before the board has reported it, some seconds later, and for boards that never do.
        """
        return None

    def take_volts(self) -> list[tuple[ScanSequence, NDArray[np.float32]]]:
        """Return the voltages measured since the last call.

        Returns
        -------
        list of (ScanSequence, ndarray)
            A sequence that was delivered, and the voltage its source needed at
            the end of each slot, (S,) V.
        """
        return []

    @final
    def measure(self) -> Impedance:
        """Measure the impedance of every electrode, with small currents.

        Raises
        ------
        SafetyError
            If the board's measuring pulse is above the profile's limits.
        BoardStoppedError
            If the board was stopped, before or meanwhile: all electrodes are at zero.
        BoardError
            If the board is closed, cannot measure, or gives an invalid answer.
        """
        self._require_open("measuring")
        self._go_on_unless_stopped()
        self._require_seal()
        self._gate.restart()
        try:
            found = self._measure()
        except BoardError as error:
            # A board whose line is lost is at zero only if the stop has reached it.
            if self._zeroed or not isinstance(error, LineLostError):
                self._go_on_unless_stopped()
            raise
        finally:
            # What comes next begins at zero, and its time may start again.
            self._gate.restart()
        self._go_on_unless_stopped()
        return found

    @final
    @contextlib.contextmanager
    def _measuring(self, scan: ScanSequence, times: int = 1) -> Iterator[None]:
        """Prove a scan that the firmware fixes, for the write within, as in `_driving`.

        Parameters
        ----------
        scan : ScanSequence
        times : int
            Most times that the board repeats it.
        """
        with self._driving():
            for _ in range(times):
                self._gate.prove_measurement(scan)
            yield

    @final
    def _require_open(self, what: str) -> None:
        if not self._opened:
            raise BoardClosedError(f"the board is not open: open it before {what}")

    @final
    def _require_seal(self) -> None:
        """Raise, with the board closed, if its driver has replaced a part of the safety gate."""
        fault = seal_fault(self)
        if fault is not None:
            try:
                # By the class: the driver may have replaced them.
                Board.halt(self)
            finally:
                try:
                    Board.close(self)
                finally:
                    raise fault

    @final
    def stop(self) -> None:
        """Put all electrodes at zero now, from any thread; nothing is sent or measured after."""
        try:
            self._bar()
        finally:
            self._stop()
        self._zeroed = True

    @final
    def halt(self) -> None:
        """Stop for good, from any thread; a board that is being opened fails to open."""
        self._halted = True
        try:
            self._bar()
        finally:
            self._halt()
        self._zeroed = True

    @final
    def close(self) -> None:
        """Put all electrodes at zero and close the board."""
        if self._opened:
            self._opened = False
            try:
                self.stop()
            finally:
                try:
                    self._close()
                finally:
                    leave(self, at_zero=self._zeroed)
            if self._fault_found is not None:
                raise self._fault_found

    @property
    @final
    def announced(self) -> bool:
        """Whether ``smarttouch stop`` must reach it while it is open."""
        return self.on_a_finger or (self._time() is not None and not self.simulated_time)

    @property
    @final
    def budget_ua(self) -> int:
        """Its share of the current that all displays of a user may drive together, µA."""
        return self._gate.limits.total_ua if self.on_a_finger else 0

    def keep_kernels(self, table: KernelTable) -> None:
        """Give the board the kernels of the sequences to come, if it keeps any.

        Raises
        ------
        BoardError
            If it is closed, stopped or gone.
        """

    def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until all sequences have been delivered, or the time is over.

        This one returns at once, for boards whose `_send` returns when all is delivered.
        """

    def report(self) -> BoardReport:
        """Return the report of what was delivered.

        This one reports what was sent; a board that measures more overrides it.
        """
        return self._host_statistics.report()

    def _open(self) -> None:
        """Connect, and put all electrodes at zero; nothing where there is no line."""

    @abstractmethod
    def _send(self, sequence: ScanSequence, times: int) -> int:
        """Send a validated sequence; raise LineLostError if a restart may help."""

    def _recover(self, lost: LineLostError) -> None:
        """Restart a lost board, at zero; raise if that fails."""
        raise lost

    def _measure(self) -> Impedance:
        raise BoardError("this board does not measure: use a multimeter")

    def _close(self) -> None:
        """Close the line, if there is one; all electrodes are at zero already."""

    def _halt(self) -> None:
        """Put all electrodes at zero, for good."""
        self._stop()

    @final
    def __enter__(self) -> Self:
        self.open()
        return self

    @final
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except BoardError:
            # The first fault is the one to report.
            if error is None:
                raise


def _require_same_clock(due_ns: int, now_ns: int) -> None:
    """Raise if a planned start is too far ahead to be by the board's clock."""
    away_ns = due_ns - now_ns
    if away_ns > FARTHEST_NS:
        raise BoardError(
            f"due_ns is {away_ns / 1e9:.3g} s from now, and at most {FARTHEST_NS / 1e9:g} s are "
            "possible: give a time of the board's clock (board.clock.now_ns())"
        )
