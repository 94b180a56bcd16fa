"""Driver of the eTactileKit, which scans on its own clock; the host loads its patterns.

Its bytes, and what guards them, are in `etactilekit_wire`; `etactilekit_step` scans each pattern a
known number of times.
"""

import time
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.boards.board import BOTH, Capabilities
from smarttouch.boards.faults import slow_line_notes
from smarttouch.boards.kits.current_scale import scale_of
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
from smarttouch.boards.kits.streamed import Job
from smarttouch.boards.probe_scans import one_each
from smarttouch.boards.reports import Impedance, judge
from smarttouch.profile.device import Output
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

NEWEST_ZERO_MS = 520.0  # newest firmware: ends its scan 500 ms after the host's last byte
IDLE_S = 0.1  # time without a sequence after which the pattern on the board becomes zeros
SENSE_S, SENSE_SCANS = 0.25, 5  # of sense scans, ten a second; most until they end
ATTEMPTS = 4  # attempts at a pattern that gave no reading, though weaker ones did
OPEN_SHARE = 0.95  # of the voltage without a finger: if all slots reach it, it is lifted


class ETactileKitBoard(SteppedKit):
    """The eTactileKit: ``etactilekit:PORT`` or ``etactilekit:tcp://HOST:8080``.

    After the port, ``?slow`` writes 8 bytes every 3 ms from the start, for USB of older firmware
    (the driver goes over to it by itself when frames get lost), and ``?firmware=71adee2`` or
    ``newest`` selects the firmware if a query cannot. Both: ``?slow&firmware=71adee2``.
    """

    default_profile: ClassVar[str] = "etactilekit-32"
    room_s: ClassVar[float] = 0.5
    timing: ScanTiming = ScanTiming(
        slot_extra_us=10, every_electrode=True, own_widths=False, whole_hz=True, load=0.9
    )

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        super().__init__(port, limits, output)
        self._scale = scale_of(self.kind, None if output is None else output.ua_per_count)
        self.ua_per_count: float = self._scale.measured_ua
        self._nothing = bytes(2 * self._outputs)
        self._on_board = b""
        self._volts: list[tuple[ScanSequence, NDArray[np.float32]]] = []

    # -- opening and closing -----------------------------------------------

    def _greet(self) -> None:
        firmware, capacity = self._find_out()
        self._zero_anywhere = zero_anywhere(self._outputs)
        self._promise_zero(self._zero_anywhere)
        self._give_up()
        self._on_board, self._settings, self._before = b"", None, None
        self._senses = False
        self._waits = firmware != "newest"
        self._zero()
        self.notes += slow_line_notes(lambda: self._exchange(b""))
        self.capabilities: Capabilities = Capabilities(
            electrodes=self._gate.limits.electrodes,
            output="one-against-all",
            max_current_ma=LARGEST * self._scale.measured_ua / 1000,
            max_slots=self._gate.limits.electrodes,
            time_to_zero_ms=NEWEST_ZERO_MS if firmware == "newest" else None,
            kept_ms=KEPT_MS,
            firmware=f"eTactileKit {firmware}, {capacity} outputs",
            polarities=BOTH,
            acknowledges=True,
            measures=True,
            compliance_v=COMPLIANCE_V,
        )

    def _zero_first(self) -> None:
        self._promise_zero(self._zero_anywhere)
        self._write_out(self._zero_anywhere)

    def _zero(self) -> None:
        for _ in range(2):
            if not self._senses or self._exchange(NO_SENSE) is not None:
                self._senses = False
                break
            self._resync()
        else:
            raise self._lost("does not confirm the end of its sense pulses")
        self._stop_pulses()
        if not (self._load(self._nothing) or self._load(self._nothing)):
            raise self._lost("does not confirm a pattern of zeros")

    # -- sequences ---------------------------------------------------------

    def _encode(self, sequence: ScanSequence) -> bytes:
        settings = settings_of(sequence)
        busy_us = settings.scan_us(self._outputs)
        if sequence.slots and 1000 * busy_us > 0.97 * settings.period_ns:
            # Its parser would never run again.
            raise BoardError(
                f"a scan of {self._outputs} outputs takes {busy_us} µs, which does not fit "
                f"{settings.period_ns // 1000} µs: lower pulse.discharge_us or the rate"
            )
        return payload(sequence, self._wiring, self._scale, self._gate.limits)

    def _serve(self) -> None:
        idle, free_ns = False, 0
        while not self._closing.is_set():
            self._rest()
            job = self._take(None if idle else time.monotonic() + IDLE_S)
            if job is not None and self._is_in_time(job, max(job.due_ns, free_ns)):
                self._perform(job)
                # A sequence that waited for its turn is not late.
                free_ns = self._clock.now_ns()
                idle = False
            elif not self._closing.is_set():
                with self._line:
                    self._zero()
                if job is not None:
                    self._drop_late(job)
                idle = True

    def _perform(self, job: Job) -> None:
        """Scan a sequence as often as requested, or until a newer one waits."""
        if not job.sequence.slots or job.data == self._nothing:
            self._begun(job)
            for _ in range(job.times):
                self._wait(self._clock.now_ns() + 1000 * job.sequence.period_us)
                if self._waiting is not None or self._closing.is_set():
                    return
            return
        for attempt in range(ATTEMPTS):
            with self._line:
                if self._closing.is_set():
                    return
                if not self._show(job):
                    self.refused += attempt == 0
                    return
            if attempt == 0:
                self._begun(job)
            self._hold(job)
            with self._line:
                if self._shown is None or self._stop_pulses():
                    self._listen()
                    return

    def _show(self, job: Job) -> bool:
        """Enable a sequence's pulses; return whether the board has done so."""
        settings = settings_of(job.sequence)
        if settings != self._settings and not self._set(settings):
            return False
        if job.data != self._on_board and not self._load(job.data):
            return False
        self._wait(self._free_of_scans(self._clock.now_ns()))
        if self._closing.is_set() or (span := self._ask(GO, drives=True)) is None:
            self._on_board = b""
            return False
        self._note_rise(job)
        assert self._before is not None
        self._shown = ShownPattern(job, span, self._before[1])
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
            if self._exchange(commands) is None:
                self._resync()
                return False
        if settings.rate_hz != before_hz:
            # The newest firmware finishes the current period.
            self._wait(self._clock.now_ns() + 10**9 // before_hz + MARGIN_NS)
        self._settings = settings
        return True

    def _load(self, pattern: bytes) -> bool:
        """Load a pattern while nothing flows; return whether the board has it."""
        self._on_board = b""
        if self._exchange(LOAD + pattern) is None:
            self._resync()
            return False
        self._on_board = pattern
        return True

    def _note_volts(
        self, job: Job, current_ua: NDArray[np.int64], readings: NDArray[np.uint16]
    ) -> None:
        volts = (readings * VOLTS_PER_COUNT).astype(np.float32)
        with self._news:
            self._volts = [*self._volts[-63:], (job.sequence, volts)]
        if volts.any():
            # Without a finger all current takes the load beside the skin.
            alone_v = np.minimum(np.abs(current_ua) / 1000 * DUMMY_KOHM, COMPLIANCE_V)
            self.lifted: bool = bool((volts >= OPEN_SHARE * alone_v).all())

    def _begun(self, job: Job) -> None:
        with self._news:
            self._books.add(job.sequence, 0)
            self.acknowledged += 1

    def take_volts(self) -> list[tuple[ScanSequence, NDArray[np.float32]]]:
        with self._news:
            taken, self._volts = self._volts, []
        return taken

    # -- measuring ---------------------------------------------------------

    def _measure(self) -> Impedance:
        level_ua = int(SENSE_COUNTS * self._scale.measured_ua)
        most_ua = int(SENSE_COUNTS * self._scale.largest_ua)
        scan = one_each(
            self._gate.limits, most_ua, SENSE_US, 1.0, time.monotonic_ns(), cathodic=False,
            period_us=100_000,
        )  # fmt: skip
        self.drain()
        for _ in range(2):  # a busy board may not have scanned all electrodes in the first
            readings = self._sense(scan)
            if readings is not None:
                break
        else:
            raise LineLostError(
                f"the board at {self._port_name} did not report all of its {self._outputs} "
                "readings: measure again"
            )
        volts = readings[self._wiring].astype(np.float64) * VOLTS_PER_COUNT
        through_skin = np.maximum(level_ua / 1000 - volts / DUMMY_KOHM, 1e-6)
        return judge(volts, through_skin, COMPLIANCE_V)

    def _sense(self, scan: ScanSequence) -> NDArray[np.uint16] | None:
        """Sense for `SENSE_S`; return the reading of each output, counts, if the board sent all."""
        with self._line:
            self._zero()
            try:
                with self._measuring(scan, SENSE_SCANS):
                    self._senses = True
                    self._write_out(SENSE)
                # Ten scans a second; two of them are over when the readings are queried.
                self._pause(SENSE_S)
                found = self._exchange(NO_SENSE, ask=True)
                self._senses = found is None
                if found is None:
                    self._resync()
            finally:
                self._settings = self._before = None
                self._zero()
        return None if found is None else found[1]
