"""Driver of the eTactileKit, which scans on its own clock; the host loads its patterns.

Its bytes, and what guards them, are in `etactilekit_wire`; `etactilekit_step` scans each pattern a
known number of times.
"""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    BoardStoppedError,
    LineLostError,
    SequenceLateError,
    not_offered,
)
from smarttouch.boards.kits import current_scale
from smarttouch.boards.kits.current_scale import require_kit
from smarttouch.boards.kits.etactilekit_line import FIRMWARES, ETactileKitLine
from smarttouch.boards.kits.etactilekit_step import MARGIN_NS, ShownPattern, SteppedKit
from smarttouch.boards.kits.etactilekit_wire import (
    COMPLIANCE_V,
    DUMMY_KOHM,
    GO,
    LARGEST,
    LOAD,
    NO_SENSE,
    SENSE,
    SENSE_COUNTS,
    SENSE_US,
    VOLTS_PER_COUNT,
    Settings,
    payload,
    settings_commands,
    settings_of,
    zero_anywhere,
)
from smarttouch.boards.kits.kept_line import KEPT_MS
from smarttouch.boards.kits.scan_lock import ScanLock
from smarttouch.boards.line import Line
from smarttouch.boards.probe_scans import one_each
from smarttouch.boards.reports import BOTH, Capabilities, Impedance, judge
from smarttouch.profile.device import Output
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

NEWEST_ZERO_MS = 520.0  # newest firmware: ends its scan 500 ms after the host's last byte
IDLE_S = 0.1  # time without a sequence after which the pattern on the board becomes zeros
SENSE_S, SENSE_SCANS = 0.25, 5  # of sense scans, ten a second; most until they end
ATTEMPTS = 4  # attempts at a pattern that gave no reading, though weaker ones did
OPEN_SHARE = 0.95  # of the voltage without a finger: if all slots reach it, it is lifted


class ETactileKitDriver(SteppedKit):
    """The eTactileKit: ``etactilekit:PORT`` or ``etactilekit:tcp://HOST:8080``.

    After the port, ``?firmware=71adee2`` or ``newest`` selects the firmware if a query cannot.
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

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        port, _, options = port.partition("?")
        self._firmware = _firmware(options)
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
        self._zero_anywhere = zero_anywhere(self._outputs)
        self._opening = self._away = False
        self._begin(True)

    # -- opening and closing -----------------------------------------------

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._limits = limits
        # A board that is away goes on by itself, unless the keeper has put it at zero.
        self._opening, self._away = True, line.reopened and not self._kit.is_at_zero
        try:
            if not line.reopened:
                self._kit = ETactileKitLine(line, self._outputs, self._firmware)
            return self._greet(line)
        except BoardStoppedError:
            # It is not at zero, whatever has stopped it.
            if self._away:
                raise line.lost("is not back") from None
            raise
        finally:
            self._opening = False

    def _greet(self, line: Line) -> Capabilities:
        kit = self._kit
        is_known = line.reopened and line.identity is not None
        line.connect(str(self.port), kit.keep_at_zero if is_known else kit.keep)
        if line.reopened:
            if not is_known:
                kit.recognize()
            kit.promise_zero(self._zero_anywhere)
            line.write(self._zero_anywhere)
        if is_known or not line.reopened:
            # Only a reset takes the time to boot.
            line.pause(current_scale.BOOT_S)
        firmware, capacity = kit.find_out()
        kit.promise_zero(self._zero_anywhere)
        self._give_up()
        self._begin(firmware != "newest")
        self._on_board, kit.senses = b"", False
        self._free_ns = 0
        self._put_at_zero()
        self._away = False
        return Capabilities(
            electrodes=self._limits.electrodes,
            output="one-against-all",
            max_current_ma=LARGEST * self._scale.measured_ua / 1000,
            max_slots=self._limits.electrodes,
            time_to_zero_ms=NEWEST_ZERO_MS if firmware == "newest" else None,
            kept_ms=KEPT_MS,
            firmware=f"eTactileKit {firmware}, {capacity} outputs",
            polarities=BOTH,
            acknowledges=True,
            measures=True,
            compliance_v=COMPLIANCE_V,
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
        kit = self._kit
        for _ in range(2):
            if not kit.senses or kit.exchange(NO_SENSE) is not None:
                kit.senses = False
                break
            kit.resync()
        else:
            raise kit.line.lost("does not confirm the end of its sense pulses")
        self._stop_pulses()
        if not (self._load(self._nothing) or self._load(self._nothing)):
            raise kit.line.lost("does not confirm a pattern of zeros")

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
        for attempt in range(ATTEMPTS):
            with self._kit.lock:
                if not self._show(proved, pattern):
                    if attempt == 0:
                        line.events.refused()
                    return
            if attempt == 0:
                line.events.delivered(proved, 0)
            self._hold(proved)
            with self._kit.lock:
                if self._shown is None or self._stop_pulses():
                    self._listen()
                    return

    def _show(self, proved: ProvedSequence, pattern: bytes) -> bool:
        """Enable a sequence's pulses; return whether the board has done so."""
        line, settings = self._kit.line, settings_of(proved.sequence)
        if settings != self._settings and not self._set(settings):
            return False
        if pattern != self._on_board and not self._load(pattern):
            return False
        # Settings and the board's own scans decide when it can begin.
        begin_ns = self._free_of_scans(line.now_ns())
        self._wait(begin_ns)
        if (span := self._ask(GO, drives=line.later(proved, begin_ns))) is None:
            self._on_board = b""
            return False
        assert self._before is not None
        self._shown = ShownPattern(proved, span, self._before[1])
        return True

    def _set(self, settings: Settings) -> bool:
        """Set pulse and rate while nothing flows; return whether the board has done so."""
        longest = max(
            each.scan_us(self._outputs, 20) for each in (settings, self._settings) if each
        )
        before_hz = 10 if self._settings is None else self._settings.rate_hz
        between_hz = max(1, min(settings.rate_hz, before_hz, 800_000 // longest))
        self._on_board, self._settings, self._before = b"", None, None
        self._lock = ScanLock(settings.period_ns)
        for commands in (LOAD + self._nothing, settings_commands(settings, between_hz)):
            if self._kit.exchange(commands) is None:
                self._kit.resync()
                return False
        if settings.rate_hz != before_hz:
            # The newest firmware finishes the current period.
            self._wait(self._kit.line.now_ns() + 10**9 // before_hz + MARGIN_NS)
        self._settings = settings
        return True

    def _load(self, pattern: bytes) -> bool:
        """Load a pattern while nothing flows; return whether the board has it."""
        self._on_board = b""
        if self._kit.exchange(LOAD + pattern) is None:
            self._kit.resync()
            return False
        self._on_board = pattern
        return True

    def _note_volts(
        self,
        proved: ProvedSequence,
        current_ua: NDArray[np.int64],
        readings: NDArray[np.uint16],
    ) -> None:
        events, volts = self._kit.line.events, (readings * VOLTS_PER_COUNT).astype(np.float32)
        events.volts(proved.sequence, volts)
        if volts.any():
            # Without a finger all current takes the load beside the skin.
            alone_v = np.minimum(np.abs(current_ua) / 1000 * DUMMY_KOHM, COMPLIANCE_V)
            events.lift(bool((volts >= OPEN_SHARE * alone_v).all()))

    # -- measuring ---------------------------------------------------------

    def measuring_scans(self) -> list[tuple[ScanSequence, int]]:
        """Return the scan twice: a busy board may not scan all electrodes in the first."""
        most_ua = int(SENSE_COUNTS * self._scale.largest_ua)
        scan = one_each(
            self._limits, most_ua, SENSE_US, 1.0, self._kit.line.now_ns(), cathodic=False,
            period_us=100_000,
        )  # fmt: skip
        return [(scan, SENSE_SCANS)] * 2

    def measure(self, proved: list[ProvedSequence]) -> Impedance:
        for scan in proved:
            readings = self._sense(scan)
            if readings is not None:
                break
        else:
            raise LineLostError(
                f"the board at {self.port} did not report all of its {self._outputs} readings: "
                "measure again"
            )
        volts = readings[self._wiring].astype(np.float64) * VOLTS_PER_COUNT
        level_ua = int(SENSE_COUNTS * self._scale.measured_ua)
        through_skin = np.maximum(level_ua / 1000 - volts / DUMMY_KOHM, 1e-6)
        return judge(volts, through_skin, COMPLIANCE_V)

    def _sense(self, proved: ProvedSequence) -> NDArray[np.uint16] | None:
        """Sense for `SENSE_S`; return the reading of each output, counts, if the board sent all."""
        kit = self._kit
        with kit.lock:
            self._put_at_zero()
            try:
                kit.senses = True
                kit.line.drive(SENSE, proved)
                # Ten scans a second; two of them are over when the readings are queried.
                kit.line.pause(SENSE_S)
                found = kit.exchange(NO_SENSE, ask=True)
                kit.senses = found is None
                if found is None:
                    kit.resync()
            finally:
                self._settings = self._before = None
                self._put_at_zero()
        return None if found is None else found[1]


def _firmware(options: str) -> str | None:
    """Return the firmware that the user chose, if any."""
    firmware = None
    for option in options.split("&") if options else ():
        name, _, firmware = option.partition("=")
        if name != "firmware":
            raise BoardError(f"etactilekit: takes the option ?firmware, not ?{option}")
        if firmware not in FIRMWARES:
            raise not_offered("?firmware", firmware, FIRMWARES, BoardError)
    return firmware
