"""The line to an eTactileKit: commands, dialogues, recovery from lost bytes, and its scans' times.

On the wire (native USB, or TCP port 8080; little endian, no framing, no checksum)::

    FC u8   electrodes N        FB u8   0 monophasic, 1 biphasic, 2 impedance only
    FD u8   1 anodic 0 cathodic FA u16  pulse width µs
    F9 u8   sense height        F8 u8   sense width µs
    F7 u8   discharge µs        F6 u16  scans per second
    FE N×u16 heights in counts  FF      reply N×u16: ADC of each electrode's last slot
    F5      reply: chips        F4      reply: N, the only echo

So speaks the firmware of commit 71adee2 and later. Older ones know no F4, have one height for all
(FB), and FE N×u8 says which electrodes have it: they are put at zero and refused.

A byte lost inside FE would leave the board waiting, and the next byte sent would
complete a pattern shifted by eight bits: up to 41 mA. So every change is guarded:
all pulses are stopped before it (by a mode without any, or a height of zero), a query
follows it, and pulses come back only when that has been answered. A lost byte swallows the
query: no answer, no pulses, and the driver resets the board's parser. Numbers avoid bytes
that look like commands, and where one byte of a word may be lost, zeros that follow make it
smaller, never larger. Not guarded: a *doubled* byte (USB and TCP make none).
"""

import contextlib
import math
import threading
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError, OtherDeviceError, SilentBoardError
from smarttouch.base.wire.port import LINE_ERRORS, Port, reason
from smarttouch.boards.kits import current_scale
from smarttouch.boards.kits.current_scale import Scale, one_against_all
from smarttouch.boards.kits.watched_port import WatchedPort, require_watchdog
from smarttouch.boards.line import Line
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

LARGEST = 1000
"""Counts, about 10 mA: nothing above leaves this host, whatever the limits. Its firmware does not
cap 4095 counts, which are 41 mA."""
FIRST_COMMAND = 0xF4
SHORTEST_US = 7  # shortest pulse: switching on and off takes 6.6 µs


@dataclass(frozen=True)
class Settings:
    """Settings shared by all slots of a scan."""

    width_us: int
    discharge_us: int
    rate_hz: int
    anodic: bool

    @property
    def period_ns(self) -> int:
        """Period of its timer, in whole µs."""
        return 1_000_000 // self.rate_hz * 1000

    def scan_us(self, outputs: int, slot_extra_us: int = 10) -> int:
        return outputs * (self.width_us + self.discharge_us + slot_extra_us)


def settings_of(sequence: ScanSequence) -> Settings:
    """Return the settings of a sequence; raise BoardError if its slots need several polarities or
    widths, or a time that is out of reach."""
    _, current_ua = one_against_all(sequence)
    if len(np.unique(np.sign(current_ua))) > 1:
        raise BoardError(
            "some slots are anodic, some cathodic, and this board has one polarity for all: "
            "send them as two sequences"
        )
    if sequence.slots and np.ptp(sequence.width_us):
        raise BoardError(
            f"slots of {int(sequence.width_us.min())} to {int(sequence.width_us.max())} µs in "
            "one sequence, and this board has one pulse width for all"
        )
    width = int(sequence.width_us.max(initial=0))
    if sequence.slots and width < SHORTEST_US:
        raise BoardError(f"pulses of {width} µs are too short: at least {SHORTEST_US} µs")
    discharge = int(sequence.discharge_us.max(initial=0))
    if discharge >= FIRST_COMMAND:
        raise BoardError(f"a discharge of {discharge} µs is too long: at most {FIRST_COMMAND - 1}")
    rate_hz = max(1, round(1e6 / sequence.period_us))
    return Settings(width, discharge, rate_hz, bool((current_ua < 0).any()))


def payload(
    sequence: ScanSequence, wiring: NDArray[np.intp], scale: Scale, limits: SafetyLimits
) -> bytes:
    """Return the pattern of a sequence: the height of each output in counts, of which neither
    rounding nor a scale that is wrong passes the limits."""
    electrode, current_ua = one_against_all(sequence)
    most_counts = scale.most_counts(limits, sequence.width_us.max(initial=0))
    nearest = np.rint(np.abs(current_ua) / scale.measured_ua)
    counts = np.minimum(np.minimum(nearest, most_counts[electrode]), LARGEST).astype(np.uint16)
    # A byte that looks like a command would be one, if that before it were lost.
    low = counts & 0xFF
    counts -= np.where(low >= FIRST_COMMAND, low - (FIRST_COMMAND - 1), 0).astype(np.uint16)
    heights = np.zeros(wiring.max() + 1, "<u2")
    heights[wiring[electrode]] = counts
    return heights.tobytes()


VOLTS_PER_COUNT = 0.0893
DUMMY_KOHM = 66.0  # load fitted in parallel with the skin; it takes V / 66 kΩ of the current
COMPLIANCE_V = 300.0  # limit of its switches (HV513), the largest voltage of a reading
ZEROS = bytes(2 * 255 + 4)  # padding longer than the rest of any command
PING, CHIPS, READINGS = b"\xf4", b"\xf5", b"\xff"
NO_SENSE = b"\xf9\0\0\xf8\0\0"
_END = bytes(3)  # end of any command that has lost a byte
AT_REST = (
    b"\xfc\0" + _END, NO_SENSE, b"\xfb\0\0" + _END, b"\xfa\x01\0" + _END,
    b"\xf7\0" + _END, b"\xf6\x0a\0" + _END,
)  # fmt: skip
"""Puts every published firmware at zero: no electrodes, no sense pulses, no height (or mode 0), the
shortest pulses, ten scans a second. No other known board takes a byte of it for a query or a
pattern."""


QUIET = b"\xfb\x02\xfb\x02"  # stops all pulses from the next scan on
LOAD = b"\xfb\x02\xfe"  # before a pattern, which is loaded while nothing flows
GO = b"\xfb\0"  # starts its pulses from the next scan on


def zero_anywhere(outputs: int) -> bytes:
    """Return the bytes that put a board at zero in any state of its parser: no sense pulses, no
    pulses at all, and a pattern of zeros.

    Zeros first: they complete any half command as a smaller one, with no pulses meanwhile, and a
    lost byte costs a spare one, never the next command.
    """
    return bytes(2 * outputs + 4) + NO_SENSE + b"\xfb\x02\x02\x02\xfe" + bytes(2 * outputs)


def settings_commands(settings: Settings, between_hz: int) -> bytes:
    """Return the commands of the settings, twice, each followed by zeros: were a word's first
    byte lost, they would make it zero, not a longer pulse. At ``between_hz`` scans of the old and
    of the new pulses fit."""
    once = (
        QUIET + _END + b"\xf9\0" + _END + b"\xf8\0" + _END
        + b"\xf6" + between_hz.to_bytes(2, "little") + _END
        + bytes([0xFD, settings.anodic]) + _END
        + b"\xfa" + settings.width_us.to_bytes(2, "little") + _END
        + bytes([0xF7, settings.discharge_us]) + _END
    )  # fmt: skip
    return once * 2 + (b"\xf6" + settings.rate_hz.to_bytes(2, "little") + _END) * 2


TOLERANCE = 200e-6  # of the ratio of two free-running clocks, each within 100 ppm
WIDEST = 0.25  # part of a period: a scan's start with a larger uncertainty counts as unknown


@dataclass(frozen=True)
class Span:
    """Earliest and latest possible time of an event, ns."""

    early: int
    late: int


class ScanLock:
    """Bounds on the start of each scan of a board, learned from brackets.

    A bracket says that a scan started after one moment and before another. Both are certain,
    however late the host woke up. So are the bounds on the scans after it, as the board's period
    is known within the tolerance of two clocks.

    Attributes
    ----------
    period_ns : int
        Period of the scans.
    last : Span or None
        Start of the scan of the last bracket, which has number 0; None if it is not known.
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns: int = period_ns
        self.last: Span | None = None

    def scan(self, number: int) -> Span:
        """Return when a scan starts; ``last`` must be known."""
        assert self.last is not None
        away_ns = number * self.period_ns
        unsure_ns = math.ceil(abs(away_ns) * TOLERANCE)
        return Span(self.last.early + away_ns - unsure_ns, self.last.late + away_ns + unsure_ns)

    def first_after(self, time_ns: int) -> int:
        """Return the number of the first scan that certainly starts after a moment."""
        number = self._near(time_ns) - 1
        while self.scan(number).early <= time_ns:
            number += 1
        return number

    def starts(self, begin: Span, end: Span) -> tuple[int, int]:
        """Return the least and the largest number of scans that started between two events."""
        if self.last is None:
            least = max(0, end.early - begin.late) / self.period_ns * (1 - TOLERANCE)
            possible = max(0, end.late - begin.early) / self.period_ns * (1 + TOLERANCE)
            return math.floor(least), math.floor(possible) + 1
        first, last = self._near(begin.early) - 1, self._near(end.late) + 1
        scans = [self.scan(number) for number in range(first, last + 1)]
        return (
            sum(scan.early >= begin.late and scan.late <= end.early for scan in scans),
            sum(scan.late > begin.early and scan.early < end.late for scan in scans),
        )

    def learn(self, bracket: Span) -> None:
        """Take a bracket in which a scan started; one that is too wide is ignored."""
        if self.last is None:
            if bracket.late - bracket.early <= WIDEST * self.period_ns:
                self.last = bracket
            return
        near = self._near((bracket.early + bracket.late) // 2)
        scans = [self.scan(number) for number in (near - 1, near, near + 1)]
        spans = [Span(max(s.early, bracket.early), min(s.late, bracket.late)) for s in scans]
        possible = [span for span in spans if span.early <= span.late]
        if not possible:
            # It contradicts the bounds: the board was restarted, or stood still.
            self.last = None
        elif len(possible) == 1:
            self.last = possible[0]

    def check(self, time_ns: int) -> None:
        """Forget the scans if their starts have become too uncertain by now."""
        if self.last is not None:
            scan = self.scan(self._near(time_ns))
            if scan.late - scan.early > WIDEST * self.period_ns:
                self.last = None

    def _near(self, time_ns: int) -> int:
        assert self.last is not None
        return round((time_ns - (self.last.early + self.last.late) / 2) / self.period_ns)


ECHO_S = 0.1
CHIPS_S = 0.5  # longest time to an answer
MORE_S = 0.03  # wait for more than the answer: USB chips keep bytes for 16 ms
FORGETS_S = 2.15  # silence after which a partial command is dropped
MOST_LOSSES = 4  # lost commands in a row after which the firmware cannot be driven safely
LOOKS = 5  # answers in a row without an echo after which the firmware has none


class ETactileKitLine:
    """Dialogues with an eTactileKit.

    The board repeats its last pattern without a host: a watchdog is armed before anything that can
    become a current. ``lock`` is held for a dialogue, so that zero does not come between a command
    and its answer.
    """

    def __init__(self, line: Line, outputs: int) -> None:
        self.line: Line = line
        self.outputs: int = outputs
        self.zero: bytes = zero_anywhere(outputs)
        self.lock: AbstractContextManager[bool] = threading.RLock()
        self._echo = bytes([outputs])
        self._losses = self._chips = 0
        self._watched: WatchedPort | None = None

    def connect(self, name: str) -> int:
        """Open the port, put any firmware at zero, and return its number of outputs. Another device
        than before gets nothing but a question."""
        line, is_known = self.line, self._is_known
        require_watchdog()
        line.connect(name, self._watch)
        if line.reopened and not is_known:
            self._recognize()
            self._arm()
            line.write(self.zero)
        else:
            # Only a reset takes the time to boot.
            line.pause(current_scale.BOOT_S)
        capacity = self._identify()
        self._arm()
        return capacity

    @property
    def is_at_zero(self) -> bool:
        """Whether the watchdog has put the board at zero."""
        return self._watched is not None and self._watched.at_zero

    @property
    def _is_known(self) -> bool:
        """Whether it is the same board as before, by its USB numbers."""
        return self.line.reopened and self.line.identity is not None

    def _watch(self, port: Port) -> Port:
        """Return the port, shared with a watchdog; the same board, which is back, gets zero."""
        if self._is_known:
            with contextlib.suppress(*LINE_ERRORS):
                port.write(self.zero)
        self._watched = WatchedPort(port, self.zero)
        if self._is_known:
            self._arm()
        return self._watched

    def _arm(self) -> None:
        assert self._watched is not None
        try:
            self._watched.arm()
        except LINE_ERRORS as error:
            raise self.line.lost(f"has vanished ({reason(error)})") from None

    # -- detection -----------------------------------------------------------

    def _identify(self) -> int:
        chips = self._chips = self._wake()
        capacity = 8 * chips
        if self.outputs > capacity:
            raise BoardError(
                f"the eTactileKit at {self.line.name} has {capacity} outputs, the profile needs "
                f"{self.outputs}: use the profile of this board"
            )
        self._require_echo(chips)
        # No sense pulses: the guard of every change relies on that.
        self.line.write(QUIET + NO_SENSE + bytes([0xFC, self.outputs]) + PING)
        if self.line.read(1, ECHO_S) != self._echo:
            raise self.line.lost("does not echo its number of electrodes")
        return capacity

    def _wake(self) -> int:
        """Put the board at zero and its parser at the start of a command; return its number of
        chips."""
        for pause_s in (0.01, FORGETS_S):
            # An earlier host may have left half a pattern, which any byte but zero would complete
            # as a current. What zeros do not end, a silence does.
            self.line.write(ZEROS)
            self.line.pause(pause_s)
            for command in AT_REST:
                self.line.write(command)
            self.line.discard_input()
            self.line.write(CHIPS)
            if answer := self.line.read(1, CHIPS_S):
                return answer[0]
        raise SilentBoardError(
            f"the board at {self.line.name} does not answer as an eTactileKit does: check that "
            "it is on, and switch it off and on"
        )

    def _require_echo(self, chips: int) -> None:
        """Raise unless the firmware echoes; its number of electrodes is zero meanwhile."""
        for _ in range(LOOKS):
            self.line.discard_input()
            # The answer to the second byte shows whether the first was a query.
            self.line.write(PING + CHIPS)
            if self.line.read(1, CHIPS_S) == b"\0" and self.line.read(1, CHIPS_S) == bytes([chips]):
                return
        for command in AT_REST:
            self.line.write(command)
        raise BoardError(
            f"the eTactileKit at {self.line.name} does not echo: its firmware is older than commit "
            "71adee2, or damaged: flash the newest one of the kit's repository, "
            "aid-lab-org/eTactileKit"
        )

    def _recognize(self) -> None:
        """Ask a device that has come back whether it is the same board, where USB does not tell."""
        # No zeros before the query: another device might act on them.
        for pause_s in (0.0, FORGETS_S):
            self.line.pause(pause_s)
            self.line.discard_input()
            self.line.write(CHIPS)
            if received := self.line.read(1, CHIPS_S):
                # A longer answer is another device's; zero waits only briefly for that.
                received += self.line.read(1, MORE_S)
                break
        if received != bytes([self._chips]):
            raise OtherDeviceError(
                f"what is at {self.line.name} now does not answer as that board did: nothing but "
                "this question was sent"
            )

    # -- queries -------------------------------------------------------------

    def exchange(
        self, body: bytes, *, ask: bool = False, drives: ProvedSequence | None = None
    ) -> tuple[Span, NDArray[np.uint16] | None] | None:
        """Send commands and wait until they are executed; return the span in which that was and, if
        asked for, the readings (N,) before them in the board's order. If the answer is wrong, lead
        the parser to the start of a command and return None. Commands that start the pulses of a
        sequence come with it, in ``drives``."""
        data = READINGS * ask + body + PING
        expected = 2 * self.outputs * ask + 1
        # A late answer must not be taken for this one's.
        self.line.discard_input()
        begun_ns = self.line.now_ns()
        self.line.write(data, drives)
        answer = self.line.read(expected, ECHO_S)
        span = Span(begun_ns, self.line.now_ns())
        if len(answer) != expected or answer[-1:] != self._echo:
            self._resync()
            return None
        self._losses = 0
        return span, np.frombuffer(answer[:-1], "<u2") if ask else None

    def _resync(self) -> None:
        """Resynchronize the board's parser to the start of a command; nothing flows meanwhile."""
        self._losses += 1
        if self._losses > MOST_LOSSES:
            raise BoardError(
                f"{self._losses} commands in a row were lost on the way to the eTactileKit at "
                f"{self.line.name}, so it cannot be driven safely: use another cable and port, or "
                "flash the newest firmware of the kit's repository, aid-lab-org/eTactileKit"
            )
        # Zeros complete any half pattern, and are no commands; if not, silence does.
        for zeros, pause_s in ((ZEROS, 0.01), (b"", FORGETS_S)):
            self.line.write(zeros)
            self.line.pause(pause_s)
            self.line.discard_input()
            self.line.write(QUIET + bytes(4) + PING)
            # The answer may only be late, and a silence would cost far more.
            if self.line.read(1, CHIPS_S) == self._echo:
                return
        raise self.line.lost("does not answer any more")
