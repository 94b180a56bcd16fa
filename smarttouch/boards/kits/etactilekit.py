"""Driver of the eTactileKit, which scans by its own clock; the host loads patterns.

The wire format and safe dialogues are in `etactilekit_protocol`.

The board reads its pattern when a scan starts. The driver loads a pattern, enables pulses for the
requested number of scans, and stops pulses. The board does not report scans, but each scan changes
its readings. If two queries return different readings, a scan has started between them. `ScanLock`
computes the times of all other scans from this. While these times are unknown, and on a slow line,
pulses stay enabled for longer than the requested scans. More scans may then have pulses, so reports
state the smallest and largest possible number of scans.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    BoardStoppedError,
    LineLostError,
    SequenceLateError,
    choice_of,
)
from smarttouch.boards.driver import Driver, Line
from smarttouch.boards.kits import etactilekit_protocol as wire
from smarttouch.boards.kits import one_against_all, require_kit, steps_of
from smarttouch.boards.kits.etactilekit_protocol import ETactileKitLine, Readings, Settings, Span
from smarttouch.boards.reports import Capabilities
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence, ScanTiming

FIRMWARES = ("71adee2", "newest")  # known firmware versions, by commit
NEWEST_ZERO_MS = 520.0  # newest firmware: at zero this long after the host's last byte
IDLE_S = 0.1  # time without a sequence after which zeros are loaded
VOLTS_PER_COUNT = 0.0893
DUMMY_KOHM = 66.0  # load in parallel with the skin, kΩ
COMPLIANCE_V = 300.0  # voltage limit of the switches (HV513), so no reading is larger
LONGEST_LOAD = 0.97  # largest share of a period that a scan may take
OPEN_SHARE = 0.95  # the finger is lifted if all slots reach this share of the no-finger voltage

LOW, HIGH = 4, 12  # a reading below 4 (0.3 V) means no pulse; 12 (1 V) or more means a pulse
POLL_NS, MARGIN_NS = 1_000_000, 100_000
WIDE_NS = 1_000_000  # if the start of a scan is more uncertain than this, a query narrows it down
KEEP_NS = 100_000_000  # longest pause between queries: the newest firmware stops after 500 ms
TOLERANCE = 200e-6  # largest relative difference between the clocks of host and board, 100 ppm each
WIDEST = 0.25  # a scan start that is uncertain by more than this share of a period is unknown


class ScanLock:
    """Earliest and latest start of each scan, calculated from brackets.

    A bracket is a pair of times. A scan has certainly started between them, even if the host was
    delayed. The starts of all other scans follow from the period, with a tolerance for the clocks.

    Attributes
    ----------
    period_ns : int
        Period of the scans.
    last : Span or None
        Earliest and latest start of scan 0; None if unknown. `learn` chooses scan 0.
    """

    def __init__(self, period_ns: int) -> None:
        self.period_ns: int = period_ns
        self.last: Span | None = None

    def scan(self, number: int) -> Span:
        """Return the earliest and latest possible start of scan ``number``; `last` must be set."""
        assert self.last is not None
        away_ns = number * self.period_ns
        unsure_ns = math.ceil(abs(away_ns) * TOLERANCE)
        return Span(self.last.early + away_ns - unsure_ns, self.last.late + away_ns + unsure_ns)

    def first_after(self, time_ns: int) -> int:
        """Return the number of the first scan that certainly starts after a time."""
        number = self._near(time_ns) - 1
        while self.scan(number).early <= time_ns:
            number += 1
        return number

    def starts(self, begin: Span, end: Span) -> tuple[int, int]:
        """Return the smallest and largest possible number of scans that started between two
        events."""
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
        """Update `last` from an interval that contains the start of one scan; ignore others."""
        if self.last is None:
            if bracket.late - bracket.early <= WIDEST * self.period_ns:
                self.last = bracket
            return
        near = self._near((bracket.early + bracket.late) // 2)
        scans = [self.scan(number) for number in (near - 1, near, near + 1)]
        spans = [Span(max(s.early, bracket.early), min(s.late, bracket.late)) for s in scans]
        possible = [span for span in spans if span.early <= span.late]
        if len(possible) <= 1:
            # If no expected scan fits this interval, the board was restarted or paused.
            self.last = possible[0] if possible else None

    def check(self, time_ns: int) -> None:
        """Forget the starts of scans if they have become too uncertain."""
        if self.last is not None:
            scan = self.scan(self._near(time_ns))
            if scan.late - scan.early > WIDEST * self.period_ns:
                self.last = None

    def _near(self, time_ns: int) -> int:
        assert self.last is not None
        return round((time_ns - (self.last.early + self.last.late) / 2) / self.period_ns)


@dataclass
class ShownPattern:
    """Pattern on the board, and the time when its pulses were enabled."""

    proved: ProvedSequence
    since: Span
    before: Readings  # readings before the pulses were enabled
    is_seen: bool = False  # whether readings have shown the pattern's pulses

    def pulsed(self, readings: Readings) -> NDArray[np.bool_]:
        """Return which outputs have certainly pulsed, (N,): their reading has risen to `HIGH`."""
        return (self.before < LOW) & (readings >= HIGH)


class ETactileKitDriver(Driver):
    """Driver of the eTactileKit: ``etactilekit:PORT`` or ``etactilekit:tcp://HOST:8080``.

    ``?firmware=71adee2`` or ``newest`` states the firmware, which cannot be queried. Without
    this option, the driver relies only on behavior common to both versions.
    """

    default_profile: ClassVar[str] = "etactilekit-32"
    takes_wiring: ClassVar[bool] = True
    timing: ScanTiming = ScanTiming(
        slot_extra_us=10, every_electrode=True, own_widths=False, whole_hz=True, load=0.9
    )
    _kit: ETactileKitLine

    def __init__(
        self,
        port: str,
        limits: SafetyLimits,
        output: Output | None = None,
        *,
        firmware: str | None = None,
    ) -> None:
        if firmware is not None:
            firmware = choice_of("?firmware", firmware, FIRMWARES, BoardError)
        self._firmware = firmware
        self.ua_per_count: float = require_kit("etactilekit", port, output, self.default_profile)
        self.port = port
        wiring = None if output is None else output.wiring
        self._wiring = np.arange(limits.electrodes) if wiring is None else np.asarray(wiring)
        self._outputs = int(self._wiring.max()) + 1
        if self._outputs > 253:
            raise BoardError(
                f"output {self._outputs - 1} does not exist: an eTactileKit has outputs 0 to 252"
            )
        self._limits = limits
        self._nothing = bytes(2 * self._outputs)
        self._opening = self._away = False
        self._begin()

    def _begin(self) -> None:
        """Forget what is known about the board's scans and settings."""
        self._on_board = b""  # pattern on the board; empty if uncertain
        self._settings: Settings | None = None  # settings on the board; None if uncertain
        self._scan_ns = 0  # duration of a scan
        self._lock = ScanLock(1)
        self._shown: ShownPattern | None = None
        # time of the last query, and its readings
        self._before: tuple[int, Readings] | None = None
        self._answer_ns = 0  # shortest time from a recent query to its answer
        self._stopped_ns = self._free_ns = 0
        self._seen_ua = 10**6  # smallest current that has changed readings so far

    # -- opening and closing -----------------------------------------------

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._limits = limits
        # A disconnected board continues its pattern, unless the watchdog has set it to zero.
        self._opening, self._away = True, line.reopened and not self._kit.watched.at_zero
        try:
            if not line.reopened:
                self._kit = ETactileKitLine(line, self._outputs)
            capacity = self._kit.connect(str(self.port))
            shown, self._before = self._shown, None
            if shown is not None:
                # Report scans that may have run before the lost board returned to zero.
                self._report_scans(shown, Span(shown.since.late, line.now_ns()))
            self._begin()
            self._put_at_zero()
            self._away = False
        except BoardStoppedError:
            # The board is still disconnected, so the stop has not set it to zero.
            if self._away:
                raise line.lost("is not back") from None
            raise
        finally:
            self._opening = False
        named = f"eTactileKit {self._firmware}" if self._firmware else "eTactileKit"
        return Capabilities(
            electrodes=self._limits.electrodes,
            output="one-against-all",
            max_current_ma=wire.LARGEST * self.ua_per_count / 1000,
            max_slots=self._limits.electrodes,
            time_to_zero_ms=NEWEST_ZERO_MS if self._firmware == "newest" else None,
            kept_ms=math.ceil(wire.KEPT_MS + len(self._kit.zero) / wire.BYTES_PER_MS),
            firmware=f"{named}, {capacity} outputs",
            measures=True,
            host_timed=True,
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
                    if not self._kit.watched.at_zero:
                        raise

    def _put_at_zero(self) -> None:
        self._stop_pulses()
        if not (self._load(self._nothing) or self._load(self._nothing)):
            raise self._kit.line.lost("does not confirm a pattern of zeros")

    # -- sequences ---------------------------------------------------------

    def encode(self, sequence: ScanSequence) -> tuple[Settings, bytes]:
        """Return settings and pattern of a sequence. The pattern is the pulse height of each output
        in counts. Raises BoardError if the board cannot deliver the sequence."""
        electrode, current_ua = one_against_all(sequence)
        for what, values in (
            ("polarities", np.sign(current_ua)), ("pulse widths", sequence.width_us)
        ):  # fmt: skip
            if len(set(values.tolist())) > 1:
                raise BoardError(
                    f"slots have different {what} ({min(values)} and {max(values)}), but "
                    "this board has one value for all: send them as two sequences"
                )
        width_us = int(sequence.width_us.max(initial=0))
        rest_us = int(sequence.discharge_us.max(initial=0))
        if rest_us >= wire.FIRST_COMMAND or (sequence.slots and width_us < wire.SHORTEST_US):
            raise BoardError(
                f"this board cannot make pulses of {width_us} µs with {rest_us} µs of discharge: "
                f"set pulses of at least {wire.SHORTEST_US} µs, and at most "
                f"{wire.FIRST_COMMAND - 1} µs of discharge"
            )
        rate_hz = max(1, round(1e6 / sequence.period_us))
        settings = Settings(width_us, rest_us, rate_hz, bool((current_ua < 0).any()))
        busy_us = settings.scan_us(self._outputs)
        if sequence.slots and 1000 * busy_us > LONGEST_LOAD * settings.period_ns:
            # With a longer scan the parser of the board would never run again.
            raise BoardError(
                f"a scan of {self._outputs} outputs takes {busy_us} µs, which does not fit "
                f"{settings.period_ns // 1000} µs: lower pulse.discharge_us or the rate"
            )
        level_ua = np.abs(current_ua)
        steps = steps_of(
            "etactilekit", self.ua_per_count, self._limits, width_us, level_ua, electrode
        )
        counts = np.minimum(steps, wire.LARGEST)
        # No data byte may equal a command: after a lost byte, the board may read it as a command.
        low = counts & 0xFF
        counts -= np.where(low >= wire.FIRST_COMMAND, low - (wire.FIRST_COMMAND - 1), 0)
        heights = np.zeros(self._outputs, "<u2")
        heights[self._wiring[electrode]] = counts
        return settings, heights.tobytes()

    def write(self, proved: ProvedSequence) -> None:
        line = self._kit.line
        # A sequence is not late if it had to wait for an earlier one.
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
        """Load a pattern of zeros after `IDLE_S` without sequences."""
        left_s = IDLE_S - (self._kit.line.now_ns() - self._free_ns) / 1e9
        if left_s > 0:
            return left_s
        self.zero()
        return None

    def _perform(self, proved: ProvedSequence) -> None:
        """Scan a sequence as often as requested, or until a newer one is waiting."""
        line, sequence = self._kit.line, proved.sequence
        settings, pattern = self.encode(sequence)
        if not sequence.slots or pattern == self._nothing:
            line.delivered(proved, 0)
            for _ in range(proved.times):
                line.wait_until(line.now_ns() + 1000 * sequence.period_us)
                if line.has_newer():
                    return
            return
        with self._kit.lock:
            if not self._show(proved, settings, pattern):
                line.board.refused += 1
                return
        line.delivered(proved, 0)
        self._hold(proved)
        with self._kit.lock:
            if self._shown is not None:
                self._stop_pulses()

    def _show(self, proved: ProvedSequence, settings: Settings, pattern: bytes) -> bool:
        """Load a sequence and enable its pulses; return whether the board confirmed all steps."""
        line = self._kit.line
        if settings != self._settings and not self._set(settings):
            return False
        if pattern != self._on_board and not self._load(pattern):
            return False
        # Compute the start only now: it depends on the new settings and on the board's scans.
        begin_ns = self._between_scans(line.now_ns())
        line.wait_until(begin_ns)
        if (span := self._ask(wire.GO, drives=line.later(proved, begin_ns))) is None:
            self._on_board = b""
            return False
        assert self._before is not None
        self._shown = ShownPattern(proved, span, self._before[1])
        return True

    def _set(self, settings: Settings) -> bool:
        """Set pulse shape and rate with pulses off; return whether the board confirmed both."""
        longest = max(
            chosen.scan_us(self._outputs, 20) for chosen in (settings, self._settings) if chosen
        )
        before_hz = 10 if self._settings is None else self._settings.rate_hz
        between_hz = max(1, min(settings.rate_hz, before_hz, 800_000 // longest))
        self._on_board, self._settings, self._before = b"", None, None
        self._lock = ScanLock(settings.period_ns)
        for commands in (wire.LOAD + self._nothing, settings.commands(between_hz)):
            if self._kit.exchange(commands) is None:
                return False
        if settings.rate_hz != before_hz:
            # The newest firmware applies a new rate only after the current period.
            self._kit.line.wait_until(self._kit.line.now_ns() + 10**9 // before_hz + MARGIN_NS)
        self._settings, self._scan_ns = settings, 1000 * settings.scan_us(self._outputs)
        return True

    def _load(self, pattern: bytes) -> bool:
        """Stop pulses, then load a pattern; return whether the board confirmed both."""
        self._on_board = b""
        if self._kit.exchange(wire.LOAD + pattern) is not None:
            self._on_board = pattern
        return self._on_board == pattern

    # -- the scans of the board -----------------------------------------------

    def _ask(self, body: bytes, *, drives: ProvedSequence | None = None) -> Span | None:
        """Send commands. Return the earliest and latest time of execution; None after an error.
        Update `_lock` if the readings show a scan since the last query."""
        before, settings, self._before = self._before, self._settings, None
        if (answer := self._kit.exchange(body, ask=True, drives=drives)) is None:
            return None
        span, now = answer
        self._before = span.early, now
        # Answers to queries during a scan are delayed: keep the shortest answer time.
        took_ns = span.late - span.early
        self._answer_ns = min(took_ns, self._answer_ns * 9 // 8 or took_ns)
        if before is None or settings is None:
            return span
        asked_ns, then = before
        rises, falls = (then < LOW) & (now >= HIGH), (then >= HIGH) & (now < LOW)
        if (rises | falls).any():
            # Assume the shortest slot: no pulse, and a discharge `SHORTEST_US` below the setting.
            rest_us = max(0, settings.discharge_us - wire.SHORTEST_US)
            if self._firmware == "71adee2":
                # This firmware answers only between scans. It has answered, so the scan is over.
                slots, early_ns = self._outputs, asked_ns
                rest_us += settings.width_us if rises.any() else wire.SHORTEST_US
            else:
                # A reading changed, so its slot was between the two queries. The scan started
                # ``slots`` slots before this slot.
                slots = int((rises | falls).argmax())
                early_ns = asked_ns - 1000 * slots * settings.scan_us(1, 25)
            self._lock.learn(Span(early_ns, span.late - 1000 * slots * rest_us))
        return span

    def _between_scans(self, now_ns: int) -> int:
        """Return the next time at which a query can be sent and answered between scans, ns."""
        lock = self._lock
        lock.check(now_ns)
        if lock.last is None:
            # With the newest firmware, a scan that began before pulses were stopped may still run.
            return max(now_ns, self._stopped_ns + self._scan_ns)
        answer_ns = min(3 * self._answer_ns, (lock.period_ns - self._scan_ns) // 3)
        number = lock.first_after(now_ns)
        before, following = lock.scan(number - 1), lock.scan(number)
        if before.late > now_ns:
            return before.late + MARGIN_NS
        return now_ns if now_ns + answer_ns < following.early else following.late + MARGIN_NS

    def _hold(self, proved: ProvedSequence) -> None:
        """Wait until the requested number of scans is over. Meanwhile send queries. The answers
        show when scans start, and the queries prevent the host timeout of the board."""
        line, shown, lock = self._kit.line, self._shown, self._lock
        asked_ns = now_ns = line.now_ns()
        # Another thread may set the board to zero, which ends the pattern.
        while shown is not None and shown is self._shown:
            times = 1 if line.has_newer() else proved.times
            if lock.last is None:
                ask_ns = now_ns + POLL_NS
                last_ns = shown.since.late + times * lock.period_ns * 1001 // 1000
            else:
                ask_ns = asked_ns + KEEP_NS
                coming = lock.scan(lock.first_after(now_ns))
                if coming.late - coming.early > WIDE_NS:
                    ask_ns = min(ask_ns, (coming.early + coming.late) // 2)
                last_ns = lock.scan(lock.first_after(shown.since.late) + times - 1).late
            over_ns = last_ns + self._scan_ns + MARGIN_NS
            if now_ns >= over_ns:
                line.wait_until(self._between_scans(now_ns))
                return
            # Check once per period whether a newer sequence is waiting.
            until_ns = min(over_ns, ask_ns, now_ns + lock.period_ns)
            line.wait_until(until_ns)
            now_ns = line.now_ns()
            if until_ns == ask_ns:
                asked_ns = now_ns
                with self._kit.lock:
                    if shown is self._shown and self._ask(b"") and self._before:
                        self._look(shown, self._before[1])

    def _look(self, shown: ShownPattern, readings: Readings) -> None:
        """When readings first show pulses, set ``since`` just before the scan with these pulses."""
        scan = self._lock.last
        if not shown.is_seen and shown.pulsed(readings).any():
            shown.is_seen = True
            if scan is not None and scan.late >= shown.since.early:
                shown.since = Span(scan.early - 1, scan.early - 1)

    def _stop_pulses(self) -> None:
        """Stop all pulses, and report the scans of the pattern that was shown."""
        shown, self._shown = self._shown, None
        begun_ns, stopped = self._kit.line.now_ns(), None
        try:
            stopped = self._ask(wire.QUIET)
        finally:
            self._stopped_ns = self._kit.line.now_ns()
            if shown is not None:
                self._report_scans(shown, stopped or Span(begun_ns, self._stopped_ns))

    def _report_scans(self, shown: ShownPattern, end: Span) -> None:
        """Report the scans and the voltages of a pattern. Latch the board if an output outside the
        pattern has pulsed."""
        sequence, line = shown.proved.sequence, self._kit.line
        least, largest = self._lock.starts(shown.since, end)
        pulsed = np.zeros(self._outputs, bool)
        if self._before is not None:
            now = self._before[1]
            pulsed = shown.pulsed(now)
            electrode, current_ua = one_against_all(sequence)
            readings, level_ua = now[self._wiring[electrode]], int(np.abs(current_ua).max())
            if pulsed.any():
                least, self._seen_ua = max(1, least), min(level_ua, self._seen_ua)
            elif level_ua >= self._seen_ua and (readings < LOW).all():
                # Earlier pulses, no stronger than these, raised the readings. These pulses did
                # not, so no scan took place.
                self._lock.last, least = None, 0
            if least:
                volts, lifted = (readings * VOLTS_PER_COUNT).astype(np.float32), None
                if volts.any():
                    # Without a finger, all current flows through the board's own load.
                    alone_v = np.minimum(np.abs(current_ua) / 1000 * DUMMY_KOHM, COMPLIANCE_V)
                    lifted = bool((volts >= OPEN_SHARE * alone_v).all())
                line.measured(sequence, volts, lifted)
        line.delivered(shown.proved, least, most=max(least, largest))
        pulsed[self._wiring[sequence.site]] = False
        if pulsed.any():
            raise line.fault(f"output {pulsed.argmax()} pulsed although its pattern was zero")
