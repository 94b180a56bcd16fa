"""Driver of the 61-electrode ESP32 kit: one packet is one scan, timed by the host.

On the wire (UART over USB, 921600 8N1, no checksum, no acknowledgment)::

    STIMULATE  FF, then 61 bytes: intensity of each electrode, 0 to 200
    MEASURE    FE; the reply is 61 readings, then FF

The board makes one anodic pulse of 50 µs for each intensity that is not zero, in
order, each followed by 150 µs with all outputs grounded. Without packets there
are no pulses: a host that is lost is a board at zero.

A byte lost or doubled on the line shifts one scan by an electrode, undetectably;
the packet after the next is whole again, as no intensity looks like a start.

After power-on the board tests its source until the first packet: ours is zeros. They
load nothing into its converter, so the test's last value, at most 1,024 counts or
2.5 mA, flows for some 3 µs through the electrode that pulses first, before its own
value does. No packet can prevent that; it is 8 nC, once after power-on.
"""

import time
from typing import ClassVar

import numpy as np

from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.boards.board import Capabilities
from smarttouch.boards.kits.current_scale import one_against_all, scale_of
from smarttouch.boards.kits.streamed import Job, StreamedBoard
from smarttouch.boards.probe_scans import one_each
from smarttouch.boards.reports import Impedance, judge
from smarttouch.profile.device import Output
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

ELECTRODES = 61
STIMULATE, MEASURE = 0xFF, 0xFE
ZERO = bytes([STIMULATE]) + bytes(ELECTRODES)
WIDTH_US, REST_US = 50, 150
LARGEST = 200
COUNTS_PER_BYTE = 16
MEASURE_MA, MEASURE_US = 2.5, 25  # of MEASURE, fixed by the firmware (over 20 µs)
ANSWER_READS, READ_S = 25, 0.02  # its answer comes within 2.1 ms; it is given half a second
READING_V = 4 * 0.0893  # volts per unit, by the divider of its relative, the eTactileKit
WRAP = 256
COMPLIANCE_V = 300.0  # limit of its switches (HV507)
HURRY = 20  # divisor of a period: no two packets are closer than it by more than a twentieth
LEAD_S = 0.003  # from a run's first sequence to its packet: margin for delayed later ones


class Kajimoto61Board(StreamedBoard):
    """Kit of 61 electrodes: ``kajimoto61:PORT``."""

    kind = "kajimoto61"
    default_profile: ClassVar[str] = "kajimoto-61"
    timing: ScanTiming = ScanTiming(
        width_us=WIDTH_US, discharge_us=REST_US, slot_extra_us=8, scan_us=700, in_index_order=True,
        own_widths=False, load=1 / 1.1,
    )  # fmt: skip

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        super().__init__(port, limits, output)
        if limits.electrodes != ELECTRODES:
            raise BoardError(
                f"a kajimoto61 board has {ELECTRODES} electrodes, the profile "
                f"{limits.electrodes}: use the profile {self.default_profile}"
            )
        self._scale = scale_of(self.kind, None if output is None else output.ua_per_count)
        self.ua_per_count: float = self._scale.measured_ua
        self._step_ua = COUNTS_PER_BYTE * self.ua_per_count
        most = self._scale.most_counts(limits, WIDTH_US, COUNTS_PER_BYTE)
        self._largest = np.minimum(LARGEST, most)
        self.capabilities: Capabilities = Capabilities(
            electrodes=ELECTRODES,
            output="one-against-all",
            max_current_ma=LARGEST * self._step_ua / 1000,
            max_slots=ELECTRODES,
            time_to_zero_ms=13.0,
            firmware="kajimoto61 (it does not tell its version)",
            polarities=("anodic",),
            clock="host",
            acknowledges=False,
            measures=False,
        )

    def _greet(self) -> None:
        self._flush()
        self._zero()
        # This board sends nothing unrequested; an eTactileKit takes FF for a query and answers.
        if answer := self._read(64, 0.05):
            raise BoardError(
                f"the board at {self._port_name} answers {len(answer)} bytes to a packet that a "
                "kajimoto61 board answers with none: it is another one, perhaps etactilekit:"
            )

    def _zero(self) -> None:
        # Zeros complete a packet that was cut short; a full one ends the self-test.
        self._write(bytes(ELECTRODES))
        time.sleep(0.02)
        self._write(ZERO)
        self._flush()

    def _encode(self, sequence: ScanSequence) -> bytes:
        electrode, current_ua = one_against_all(sequence)
        if (current_ua > 0).any():
            slot = int((current_ua > 0).argmax())
            raise BoardError(
                f"slot {slot} is cathodic, and this board is anodic only: choose a mode that its "
                "profile offers",
                slot=slot,
            )
        if (sequence.width_us != WIDTH_US).any() or (sequence.discharge_us > REST_US).any():
            raise BoardError(
                f"this board pulses for {WIDTH_US} µs and grounds for {REST_US} µs, the sequence "
                f"wants {int(sequence.width_us[0])} and {int(sequence.discharge_us[0])}"
            )
        shortest = self.timing.shortest_period_us(sequence.slots, ELECTRODES, WIDTH_US, REST_US)
        if sequence.period_us < shortest:
            raise BoardError(
                f"a period of {sequence.period_us} µs is too short for {sequence.slots} "
                f"electrodes: this board needs {shortest} µs"
            )
        packet = np.zeros(1 + ELECTRODES, np.uint8)
        packet[0] = STIMULATE
        # Neither rounding nor a wrong scale may exceed the limit that was proved.
        steps = np.minimum(np.rint(-current_ua / self._step_ua), self._largest[electrode])
        packet[1 + electrode] = steps.astype(np.uint8)
        return packet.tobytes()

    def _serve(self) -> None:
        """Send the newest sequence on a grid of absolute deadlines."""
        deadline_ns, job = 0, None
        while (newest := self._take()) is not None:
            now = self._clock.now_ns()
            if not self._is_in_time(newest, newest.due_ns):
                self._drop_late(newest)
                continue
            if job is None or now - deadline_ns > 1000 * job.sequence.period_us:
                # The first of a run or after a pause starts a new grid.
                deadline_ns = now + int(LEAD_S * 1e9)
            job, deadline_ns = self._scan(newest, deadline_ns)
            self._rest()

    def _scan(self, job: Job, deadline_ns: int) -> tuple[Job | None, int]:
        """Send one sequence as often as requested; return the last one sent, None if it had become
        too late, and when the next one may go."""
        left = job.times
        while left:
            self._clock.wait_until(deadline_ns, self._closing)
            if (fresh := self._peek()) is not None:
                self.replaced += left == job.times
                job, left = fresh, fresh.times
            with self._line, self._driving():
                if self._closing.is_set():
                    break
                sent_ns = self._clock.now_ns()
                if not (self._is_in_time(job, deadline_ns) and self._went(job, deadline_ns)):
                    self._drop_late(job)
                    return None, deadline_ns
                self._note_rise(job)
            self._delivered(job)
            left -= 1
            # After a late packet the grid moves, as catching up would exceed the proved rate; the
            # part of a period that is caught up lies within the board's own margin.
            period_ns = 1000 * job.sequence.period_us
            deadline_ns = max(deadline_ns + period_ns, sent_ns + period_ns - period_ns // HURRY)
        return job, deadline_ns

    def _went(self, job: Job, deadline_ns: int) -> bool:
        """Write a sequence in time; return whether it was. Where the line breaks meanwhile, the
        scan counts as one that may have been made."""
        try:
            return self._write_in_time(job.data, deadline_ns)
        except LineLostError:
            with self._news:
                self._books.add(job.sequence, 0, job.number == self._last_begun, most=1)
            raise

    def _peek(self) -> Job | None:
        with self._news:
            job, self._waiting = self._waiting, None
            return job

    def _measure(self) -> Impedance:
        """Request one MEASURE; readings wrap, so that some of them fit more than one voltage."""
        scan = one_each(
            self._gate.limits,
            int(MEASURE_MA * 1000 * self._scale.largest_ua / self._scale.nominal_ua),
            MEASURE_US,
            1.0,
            time.monotonic_ns(),
            cathodic=False,
            period_us=20_000,
        )
        self.drain()
        with self._line:
            self._pause(0.02)
            self._flush()
            with self._measuring(scan):
                self._write(bytes([MEASURE]))
            answer = b""
            # In short reads, as a stop waits for one.
            for _ in range(ANSWER_READS):
                self._go_on_unless_stopped()
                answer += self._read(ELECTRODES + 1 - len(answer), READ_S)
                if len(answer) > ELECTRODES:
                    break
            if len(answer) != ELECTRODES + 1 or answer[-1] != 0xFF or 0xFF in answer[:-1]:
                self._zero()
                raise BoardError(
                    f"the board at {self._port_name} answered {len(answer)} of {ELECTRODES + 1} "
                    "bytes to a measurement, or some that are no readings: it was put at zero; "
                    "measure again"
                )
        readings = np.frombuffer(answer[:-1], np.uint8).astype(np.float64)
        # The next voltage that reads the same still lies within what the board can supply.
        unsure = (readings + WRAP) * READING_V < COMPLIANCE_V
        return judge(readings * READING_V, MEASURE_MA, COMPLIANCE_V, unsure)
