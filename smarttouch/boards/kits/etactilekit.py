"""Driver of the eTactileKit, which scans on its own clock; the host loads its patterns.

Its bytes, and what guards them, are in `etactilekit_line`.

A scan is fixed when it starts, so a pattern is scanned only if it is there at that moment. The host
loads a pattern while nothing flows, enables its pulses for a period for each pass, and stops them
again. The board does not report its scans: each pattern is scanned once, or twice where a second
scan starts before the pulses are stopped, and the report has that range. Scans that start while the
next pattern is loaded have no pulses.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    BoardStoppedError,
    LineLostError,
    SequenceLateError,
)
from smarttouch.boards.driver import Driver
from smarttouch.boards.kits import Scale, one_against_all, require_kit
from smarttouch.boards.kits.etactilekit_line import (
    COMPLIANCE_V,
    DUMMY_KOHM,
    END,
    FIRST_COMMAND,
    GO,
    KEPT_MS,
    LOAD,
    QUIET,
    VOLTS_PER_COUNT,
    ETactileKitLine,
    Readings,
    Span,
)
from smarttouch.boards.line import Line
from smarttouch.boards.reports import Capabilities
from smarttouch.profile.device import Output
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

IDLE_S = 0.1  # time without a sequence after which the pattern on the board becomes zeros
OPEN_SHARE = 0.95  # of the voltage without a finger: if all slots reach it, it is lifted
LARGEST = 1000
"""Counts, about 10 mA: nothing above leaves this host, whatever the limits. Its firmware does not
cap 4095 counts, which are 41 mA."""
SHORTEST_US = 7  # shortest pulse: switching on and off takes 6.6 µs
TOLERANCE = 200e-6  # of the ratio of two free-running clocks, each within 100 ppm
LOW, HIGH = 4, 12  # readings below 4 had no pulse, from 12 on they had one: .3 and 1 V
MARGIN_NS = 100_000
KEEP_NS = 100_000_000  # longest silence to the newest firmware


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


def settings_commands(settings: Settings, between_hz: int) -> bytes:
    """Return the commands of the settings, twice, each followed by zeros: were a word's first
    byte lost, they would make it zero, not a longer pulse. At ``between_hz`` scans of the old and
    of the new pulses fit."""
    once = (
        QUIET + END + b"\xf9\0" + END + b"\xf8\0" + END
        + b"\xf6" + between_hz.to_bytes(2, "little") + END
        + bytes([0xFD, settings.anodic]) + END
        + b"\xfa" + settings.width_us.to_bytes(2, "little") + END
        + bytes([0xF7, settings.discharge_us]) + END
    )  # fmt: skip
    return once * 2 + (b"\xf6" + settings.rate_hz.to_bytes(2, "little") + END) * 2


def payload(
    sequence: ScanSequence, wiring: NDArray[np.intp], scale: Scale, limits: SafetyLimits
) -> bytes:
    """Return the pattern of a sequence: the height of each output in counts, of which neither
    rounding nor a scale that is wrong passes the limits."""
    electrode, current_ua = one_against_all(sequence)
    most = scale.most_counts(limits, sequence.width_us.max(initial=0))
    nearest = np.rint(np.abs(current_ua) / scale.measured_ua)
    counts = np.minimum(np.minimum(nearest, most[electrode]), LARGEST).astype(np.uint16)
    # A byte that looks like a command would be one, if that before it were lost.
    low = counts & 0xFF
    counts -= np.where(low >= FIRST_COMMAND, low - (FIRST_COMMAND - 1), 0).astype(np.uint16)
    heights = np.zeros(wiring.max() + 1, "<u2")
    heights[wiring[electrode]] = counts
    return heights.tobytes()


class ETactileKitDriver(Driver):
    """The eTactileKit: ``etactilekit:PORT`` or ``etactilekit:tcp://HOST:8080``.

    No query tells which firmware it has: nothing is taken for granted that only one of them does.
    """

    default_profile: ClassVar[str] = "etactilekit-32"
    takes_wiring: ClassVar[bool] = True
    queued: ClassVar[bool] = True
    reports_delivery: ClassVar[bool] = True
    waits_s: ClassVar[float] = 0.5
    idle_s: ClassVar[float] = IDLE_S
    timing: ScanTiming = ScanTiming(
        slot_extra_us=10, every_electrode=True, own_widths=False, whole_hz=True, load=0.9
    )
    _kit: ETactileKitLine

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        self._scale = require_kit("etactilekit", port, output, self.default_profile)
        self.port = port
        self.ua_per_count = self._scale.measured_ua
        wiring = None if output is None else output.wiring
        self._wiring = np.arange(limits.electrodes) if wiring is None else np.asarray(wiring)
        self._outputs = int(self._wiring.max()) + 1
        if self._outputs > 253:
            raise BoardError(
                f"output {self._outputs - 1} is out of reach: an eTactileKit counts to 253 outputs"
            )
        self._limits = limits
        self._nothing = bytes(2 * self._outputs)
        self._opening = self._away = False
        self._begin()

    def _begin(self) -> None:
        """Start without knowledge of the board."""
        self._on_board = b""  # pattern of the board; empty if not certain
        self._settings: Settings | None = None  # what it pulses with; None if not certain
        self._shown: ProvedSequence | None = None  # its pulses are enabled
        self._since = Span(0, 0)  # when that was
        self._before = np.zeros(self._outputs, np.uint16)  # readings at that time
        self._earlier = np.array([], np.intp)  # outputs of the pattern before
        self._free_ns = 0  # when the last sequence was done

    # -- opening and closing -----------------------------------------------

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._limits = limits
        # A board that is away goes on by itself, unless the watchdog has put it at zero.
        self._opening, self._away = True, line.reopened and not self._kit.is_at_zero
        try:
            if not line.reopened:
                self._kit = ETactileKitLine(line, self._outputs)
            capacity = self._kit.connect(str(self.port))
            if self._shown is not None:
                # It may have scanned until it came back at zero.
                self._report_scans(self._shown, Span(self._since.late, line.now_ns()), [])
            self._begin()
            self._put_at_zero()
            self._away = False
        except BoardStoppedError:
            # It is not at zero, whatever has stopped it.
            if self._away:
                raise line.lost("is not back") from None
            raise
        finally:
            self._opening = False
        return Capabilities(
            electrodes=self._limits.electrodes,
            output="one-against-all",
            max_current_ma=LARGEST * self._scale.measured_ua / 1000,
            max_slots=self._limits.electrodes,
            time_to_zero_ms=None,
            kept_ms=KEPT_MS,
            firmware=f"eTactileKit, {capacity} outputs",
            measures=True,
            compliance_v=COMPLIANCE_V,
            load_kohm=DUMMY_KOHM,
        )

    def zero(self) -> None:
        if self._away:
            raise self._kit.line.lost("is not back")
        if not self._opening:
            with self._kit.lock:
                try:
                    self._put_at_zero()
                except LineLostError:
                    if not self._kit.is_at_zero:
                        raise

    def _put_at_zero(self) -> None:
        self._stop_pulses()
        if not (self._load(self._nothing) or self._load(self._nothing)):
            raise self._kit.line.lost("does not confirm a pattern of zeros")

    def aftermath(self) -> str:
        if self._kit.is_at_zero:
            return ""
        return "; the board goes on with its last pattern: lift the finger, then switch it off"

    # -- sequences ---------------------------------------------------------

    def check(self, proved: ProvedSequence) -> None:
        self.encode(proved.sequence)

    def encode(self, sequence: ScanSequence) -> bytes:
        """Return the bytes of a sequence; raise BoardError if the board cannot make it."""
        settings = settings_of(sequence)
        busy_us = settings.scan_us(self._outputs)
        if sequence.slots and 1000 * busy_us > 0.97 * settings.period_ns:
            # Its parser would never run again.
            raise BoardError(
                f"a scan of {self._outputs} outputs takes {busy_us} µs, which does not fit "
                f"{settings.period_ns // 1000} µs: lower pulse.discharge_us or the rate"
            )
        return payload(sequence, self._wiring, self._scale, self._limits)

    def write(self, proved: ProvedSequence) -> None:
        line = self._kit.line
        # A sequence that waited for its turn is not late.
        proved = line.later(proved, max(proved.due_ns, self._free_ns))
        try:
            if line.now_ns() > proved.write_before_ns:
                raise line.late()
            self._perform(proved)
        except SequenceLateError:
            self.zero()
            raise
        self._free_ns = line.now_ns()

    def idle(self) -> float | None:
        """Load a pattern of zeros while no sequence comes."""
        self.zero()
        return None

    def _perform(self, proved: ProvedSequence) -> None:
        """Scan a sequence as often as requested, or until a newer one waits."""
        line, sequence = self._kit.line, proved.sequence
        pattern = self.encode(sequence)
        if not sequence.slots or pattern == self._nothing:
            line.events.delivered(proved, 0)
            for _ in range(proved.times):
                self._wait(line.now_ns() + 1000 * sequence.period_us)
                if line.has_newer():
                    return
            return
        with self._kit.lock:
            if not self._show(proved, pattern):
                line.events.refused()
                return
        line.events.delivered(proved, 0)
        self._hold(proved)

    def _show(self, proved: ProvedSequence, pattern: bytes) -> bool:
        """Enable a sequence's pulses; return whether the board has done so."""
        line, settings = self._kit.line, settings_of(proved.sequence)
        if settings != self._settings and not self._set(settings):
            return False
        if pattern != self._on_board and not self._load(pattern):
            return False
        # Settings decide when it can begin.
        answer = self._kit.exchange(GO, ask=True, drives=line.later(proved, line.now_ns()))
        if answer is None:
            self._on_board = b""
            return False
        self._since, self._before = answer
        self._shown = proved
        return True

    def _set(self, settings: Settings) -> bool:
        """Set pulse and rate while nothing flows; return whether the board has done so."""
        longest = max(
            each.scan_us(self._outputs, 20) for each in (settings, self._settings) if each
        )
        before_hz = 10 if self._settings is None else self._settings.rate_hz
        between_hz = max(1, min(settings.rate_hz, before_hz, 800_000 // longest))
        self._on_board, self._settings = b"", None
        for commands in (LOAD + self._nothing, settings_commands(settings, between_hz)):
            if self._kit.exchange(commands) is None:
                return False
        if settings.rate_hz != before_hz:
            # The newest firmware finishes the current period.
            self._wait(self._kit.line.now_ns() + 10**9 // before_hz + MARGIN_NS)
        self._settings = settings
        return True

    def _load(self, pattern: bytes) -> bool:
        """Load a pattern while nothing flows; return whether the board has it."""
        self._on_board = b""
        if self._kit.exchange(LOAD + pattern) is not None:
            self._on_board = pattern
        return self._on_board == pattern

    # -- the scans of the board -----------------------------------------------

    def _hold(self, proved: ProvedSequence) -> None:
        """Wait until the requested number of scans has begun, then stop the pulses."""
        line = self._kit.line
        period_ns = settings_of(proved.sequence).period_ns * 1001 // 1000
        while True:
            times = 1 if line.has_newer() else proved.times
            over_ns, now_ns = self._since.late + times * period_ns, line.now_ns()
            self._wait(min(over_ns, now_ns + min(period_ns, KEEP_NS)))
            asked_ns = line.now_ns()
            with self._kit.lock:
                # From another thread, zero may have ended it.
                if self._shown is not proved:
                    return
                # What is not answered has stopped the pulses.
                if asked_ns >= over_ns or self._kit.exchange(b"") is None:
                    self._stop_pulses(asked_ns)
                    return

    def _stop_pulses(self, ended_ns: int | None = None) -> None:
        """Stop all pulses, and report the scans of the shown sequence; its pulses cannot have ended
        before a time, which is now if not given."""
        line, kit = self._kit.line, self._kit
        proved, self._shown = self._shown, None
        ended_ns = line.now_ns() if ended_ns is None else ended_ns
        end, readings = None, list[Readings]()
        try:
            if answer := kit.exchange(QUIET, ask=proved is not None):
                end = Span(ended_ns, answer[0].late)
                readings.append(answer[1])
            if proved is not None and answer and not line.has_newer():
                # A scan that had begun goes on; then all its readings are there.
                scan_us = settings_of(proved.sequence).scan_us(self._outputs)
                self._wait(line.now_ns() + 1000 * scan_us + MARGIN_NS)
                if answer := kit.exchange(b"", ask=True):
                    readings.append(answer[1])
        finally:
            if proved is not None:
                self._report_scans(proved, end or Span(ended_ns, line.now_ns()), readings)

    def _report_scans(self, proved: ProvedSequence, end: Span, readings: list[Readings]) -> None:
        """Report the scans of a sequence and its voltages; latch the board if others pulsed."""
        sequence, events = proved.sequence, self._kit.line.events
        period_ns = settings_of(sequence).period_ns
        least = int(max(0, end.early - self._since.late) / period_ns * (1 - TOLERANCE))
        most = int(max(0, end.late - self._since.early) / period_ns * (1 + TOLERANCE)) + 1
        events.delivered(proved, least, most=most)
        if not readings:
            return
        now, outputs = np.max(readings, axis=0), self._wiring[sequence.site]
        if least and (len(readings) > 1 or (now[outputs] >= LOW).all()):
            self._report_volts(sequence, now[outputs])
        beside = (self._before < LOW) & (now >= HIGH)
        # The scan before may have gone on when this one's pulses were enabled.
        beside[outputs], beside[self._earlier], self._earlier = False, False, outputs
        if beside.any():
            raise events.fault(
                f"output {beside.argmax()} pulsed, and its pattern has no pulse there"
            )

    def _report_volts(self, sequence: ScanSequence, readings: Readings) -> None:
        events, volts = self._kit.line.events, (readings * VOLTS_PER_COUNT).astype(np.float32)
        events.volts(sequence, volts)
        if volts.any():
            # Without a finger all current takes the load beside the skin.
            _, current_ua = one_against_all(sequence)
            alone_v = np.minimum(np.abs(current_ua) / 1000 * DUMMY_KOHM, COMPLIANCE_V)
            events.lift(bool((volts >= OPEN_SHARE * alone_v).all()))

    def _wait(self, until_ns: int) -> None:
        if until_ns > self._kit.line.now_ns():
            self._kit.line.wait_until(until_ns)
