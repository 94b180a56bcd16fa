"""The contract that every display board keeps."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from itertools import compress
from types import TracebackType
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.impedance import Impedance
from smarttouch.clock import MonotonicClock
from smarttouch.errors import BoardError, BoardRestartedError, LineLostError
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.profile.device import Output
from smarttouch.registry import find_opener
from smarttouch.scan.exposure import Dose
from smarttouch.scan.safety import Now, SafetyGate, SafetyLimits
from smarttouch.scan.sequence import ScanSequence
from smarttouch.scan.timing import ScanTiming

Polarity = Literal["anodic", "cathodic"]
BOTH: tuple[Polarity, ...] = ("anodic", "cathodic")


@dataclass(frozen=True)
class Capabilities:
    """What a board can do, and what it cannot."""

    electrodes: int
    output: Literal["weighted", "three-state", "one-against-all", "vibration"]
    max_current_ma: float
    max_slots: int
    time_to_zero_ms: float | None
    """Longest time from the host's silence to no current; None if it may go on for ever."""
    firmware: str
    polarities: tuple[Polarity, ...] = BOTH
    clock: Literal["board", "host"] = "board"
    """Whose clock the pulses leave on."""
    acknowledges: bool = True
    measures: bool = False
    """Whether it tells the voltage that a slot needed."""
    force: bool = False
    """Whether it tells how hard the finger presses."""
    compliance_v: float | None = None
    """The most its source can give, if it is known."""
    vibrates: bool = False
    """Whether mechanical vibrators are part of it."""
    recharges: bool = False
    """Whether it can end a scan with a recharge phase."""
    kept_ms: float | None = None
    """Longest time from the end of this program to zero, where a process beside it sees to that."""

    def describe(self) -> list[tuple[str, str]]:
        """Return what there is to tell a user, as names and values."""
        silence = "goes on with its last pattern for ever: lift the finger before you unplug it"
        if self.time_to_zero_ms is not None:
            silence = f"no current {self.time_to_zero_ms:g} ms after the host falls silent"
        if self.kept_ms is not None:
            silence = (
                f"zero {self.kept_ms:g} ms after the program ends or hangs; by itself {silence}"
            )
        names = ("acknowledgments", "voltages", "finger force")
        told = compress(names, (self.acknowledges, self.measures, self.force))
        return [
            ("firmware", self.firmware),
            ("electrodes", f"{self.electrodes}, {self.output}, {' or '.join(self.polarities)}"),
            ("current", f"at most {self.max_current_ma:.1f} mA"),
            ("clock", f"the {self.clock}'s"),
            ("host lost", silence),
            ("while it scans", "tells of " + (", ".join(told) or "nothing")),
        ]


@dataclass(frozen=True)
class BoardReport:
    """Account of what a board delivered since it was opened."""

    sequences: int
    slots: int
    pulses: int
    """Electrode pulses: one for each electrode that carried current in a slot."""
    violations: int
    max_current_ma: float
    max_charge_uc: float
    max_net_charge_uc: float
    """Most charge left on an electrode: after a discharge; by the host's books, of all pulses."""
    refused_packets: int = 0
    """Old packets, and those of other sessions, that reached the board."""
    by: Literal["board", "host"] = "board"
    """Whose account it is; a host's is of what was scanned, as far as it can know."""
    most_pulses: int | None = None
    """By a host that knows only a range; pulses and slots are then the least."""


LONGEST_REPEAT = 0xFFFF
SLOW_ANSWER_S = 0.008
"""FTDI chips keep what comes back for 16 ms unless told otherwise."""


class Board(ABC):
    """A display board.

    A driver implements the underscored methods. `send` cannot be reached
    around: it proves every sequence safe, on the board's own clock, and the
    driver sees nothing but the frozen copy that was proved.

    Parameters
    ----------
    limits : SafetyLimits
        From the profile of the finger on the board.
    output : Output, optional
        What the profile says of the board: kind, scale, wiring.
    """

    usual_profile: ClassVar[str] = DEFAULT_PROFILE
    """The shipped profile of such a board."""
    takes_wiring: ClassVar[bool] = False
    waits_for_nothing: ClassVar[bool] = False
    """Whether its time is a simulated one, that need not be waited for."""
    ua_per_count: float | None = None
    """Its current scale, if it has one that can be measured."""
    timing: ScanTiming = ScanTiming()
    """What it fixes about the time of a scan; known before it is opened."""
    capabilities: Capabilities
    acknowledged: int = 0
    """Sequences the board has begun to deliver."""
    refused: int = 0
    """Sequences the board has declined or dropped."""
    replaced: int = 0
    """Sequences that a newer one overtook before they were sent."""
    force_n: float | None = None
    """How hard the finger presses, if the board can tell."""
    lifted: bool = False
    """Whether by the voltages of the last scan nothing touches the electrodes."""

    def __init__(self, limits: SafetyLimits, output: Output | None = None) -> None:
        if output is not None and output.wiring is not None and not self.takes_wiring:
            raise BoardError(
                "output.wiring is for boards whose outputs are wired by the user (etactilekit:): "
                "remove it from the profile of this one"
            )
        self.notes: list[str] = []
        self._output = output
        self._gate = SafetyGate(limits, self._time())
        self._stopped = threading.Event()
        self._opened = False

    def open(self) -> None:
        """Connect, shake hands, and put all electrodes at zero."""
        if self._opened:
            raise BoardError("the board is open already: close it first")
        # A new run starts from zero intensity, and its time may start anew.
        self._gate.begin_session()
        self._stopped.clear()
        self._open()
        self._opened = True

    def send(self, sequence: ScanSequence, times: int = 1) -> int:
        """Prove a sequence safe, then send it.

        It is delivered ``times`` times, one period after another, unless a newer one comes.

        Returns
        -------
        int
            The number under which the board will know it.

        Raises
        ------
        SafetyError
            If it breaks a limit; nothing is sent.
        BoardRestartedError
            If the board was lost and is back: begin again at intensity 0.
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
        if sequence.vibration is not None and not self.capabilities.vibrates:
            raise BoardError(
                "the sequence asks for mechanical vibration, and this board has no vibrators: "
                "give --vibrators"
            )
        if sequence.recharge_ua is not None and not self.capabilities.recharges:
            raise BoardError(
                "the sequence ends with a recharge phase, and this board makes none: leave it out"
            )
        if not 1 <= times <= LONGEST_REPEAT:
            raise BoardError(f"{times} repetitions are not possible: from 1 to {LONGEST_REPEAT}")
        proved = self._gate.prove(sequence, times)
        try:
            return self._send(proved, times)
        except LineLostError as lost:
            self._recover(lost)
            # The skin has felt nothing for a while: what comes next begins at zero.
            self._gate.restart()
            self.notes.append(f"{lost}: started anew")
            raise BoardRestartedError(f"{lost}, and was started anew") from None

    @property
    def dose(self) -> Dose:
        """Current that the skin has had since the board was opened."""
        return self._gate.dose

    def _time(self) -> Now | None:
        """Return the clock that the gate goes by: the machine's.

        Only a board that no finger can be on has another, or none: then time is what
        sequences claim.
        """
        return MonotonicClock()

    @property
    def refused_packets(self) -> int:
        """Packets from the board that were old, of another session, or answered nothing asked."""
        return 0

    def take_volts(self) -> list[tuple[ScanSequence, NDArray[np.float32]]]:
        """Return what was measured since the last call.

        Returns
        -------
        list of (ScanSequence, ndarray)
            A sequence that was delivered, and the voltage its source needed at
            the end of each slot, (S,) V.
        """
        return []

    def measure(self) -> Impedance:
        """Measure the impedance of every electrode, with small currents.

        Raises
        ------
        SafetyError
            If the board's measuring pulse is above the profile's limits.
        BoardError
            If the board cannot measure, or its answer makes no sense.
        """
        if not self._opened:
            raise BoardError("the board is not open: open it before measuring")
        self._gate.restart()
        try:
            return self._measure()
        finally:
            # What comes next begins at zero, and its time may start anew.
            self._gate.restart()

    def _note_round_trip(self, ask: Callable[[], object]) -> None:
        """Time a question; note it if the line keeps answers back."""
        times_s = []
        for _ in range(3):
            start = time.perf_counter()
            ask()
            times_s.append(time.perf_counter() - start)
        if min(times_s) > SLOW_ANSWER_S:
            self.notes.append(
                f"the board answers after {1000 * min(times_s):.0f} ms: if its USB chip is an "
                "FTDI, set the port's latency timer to 1 ms"
            )

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
    def _send(self, sequence: ScanSequence, times: int) -> int:
        """Hand a proven sequence on; raise LineLostError where starting anew may help."""

    def _recover(self, lost: LineLostError) -> None:
        """Start a lost board anew, at zero; raise if it cannot be."""
        raise lost

    def _measure(self) -> Impedance:
        raise BoardError("this board does not measure: use a multimeter")

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


def make_board(
    url: str, limits: SafetyLimits, output: Output | None = None, **options: Any
) -> Board:
    """Make the driver for a board's URL; it is not opened yet.

    Raises
    ------
    BoardError
        If no driver has that name.
    """
    opener, rest = find_opener("smarttouch.boards", url, BoardError)
    board: Board = opener(rest, limits, output, **options)
    return board


def usual_profile(url: str) -> str:
    """Return the name of the shipped profile that goes with a board's URL."""
    opener, _ = find_opener("smarttouch.boards", url, BoardError)
    return str(getattr(opener, "usual_profile", DEFAULT_PROFILE))
