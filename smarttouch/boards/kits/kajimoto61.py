"""Driver of the ESP32 kit with 61 electrodes. One packet is one scan; the host times it.

On the wire (UART over USB, 921600 8N1, no checksum, no acknowledgment)::

    STIMULATE  FF, then 61 bytes: intensity of each electrode, 0 to 200
    MEASURE    FE; the reply is 61 readings, then FF. Not used: readings wrap at a third of the
               board's largest voltage, so they do not determine an impedance

The board steps through the intensities in order. For each nonzero intensity it makes an anodic
pulse of 50 µs, then grounds all outputs for 150 µs. Without packets, no current flows.

A lost or doubled byte is not detected. It shifts one scan by one electrode, and the next packet may
be lost. The packet after that is correct, because no intensity equals the start byte.

After power-on the board tests its source until the first packet arrives. This packet contains only
zeros, and zeros load no new value into the D/A converter. When the first electrode pulses, the
converter therefore still holds the last value of the test, at most 2.5 mA, for about 3 µs (8 nC).
No packet can prevent this.
"""

from typing import ClassVar

import numpy as np

from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.boards import kits
from smarttouch.boards.driver import Driver, Line
from smarttouch.boards.kits import one_against_all, require_kit, steps_of
from smarttouch.boards.reports import Capabilities
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence, ScanTiming

ELECTRODES = 61
STIMULATE = 0xFF
ZERO = bytes([STIMULATE]) + bytes(ELECTRODES)
WIDTH_US, REST_US = 50, 150
LARGEST = 200
COUNTS_PER_BYTE = 16
HURRY = 20  # after a late packet, the next interval may be shorter by 1/HURRY of a period
LEAD_S = 0.003  # each packet of a run is sent this much later: a reserve if this computer is slow


class Kajimoto61Driver(Driver):
    """Driver of the kit with 61 electrodes: ``kajimoto61:PORT``."""

    default_profile: ClassVar[str] = "kajimoto-61"
    timing: ScanTiming = ScanTiming(
        width_us=WIDTH_US, discharge_us=REST_US, slot_extra_us=8, scan_us=700, in_index_order=True,
        own_widths=False, load=1 / 1.1,
    )  # fmt: skip

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        self.ua_per_count: float = require_kit("kajimoto61", port, output, self.default_profile)
        if limits.electrodes != ELECTRODES:
            raise BoardError(
                f"a kajimoto61 board has {ELECTRODES} electrodes, but the profile has "
                f"{limits.electrodes}: use the profile {self.default_profile}"
            )
        self.port, self._limits = port, limits
        # planned time of the next packet; None if it does not depend on earlier packets
        self._next_ns: int | None = None
        self._skipped, self._note_ns = 0, 0
        self._period_ns = 0

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._line, self._next_ns = line, None
        if line.reopened and line.identity is None:
            raise BoardError(
                f"the board at {self.port} was lost; it has no USB serial number and cannot be "
                "identified, so nothing is sent to a device that reconnects: check the cable, then "
                "start again"
            )
        line.connect(str(self.port))
        line.pause(kits.BOOT_S)
        line.discard_input()
        self.zero()
        # Detect an eTactileKit: it answers the start byte FF, a kajimoto61 board does not.
        if answer := line.read(64, 0.05):
            raise BoardError(
                f"the board at {self.port} is not a kajimoto61, because it answers a scan (with "
                f"{len(answer)} bytes): use its own kind, perhaps etactilekit:{self.port}"
            )
        return Capabilities(
            electrodes=ELECTRODES,
            output="one-against-all",
            max_current_ma=LARGEST * COUNTS_PER_BYTE * self.ua_per_count / 1000,
            max_slots=ELECTRODES,
            time_to_zero_ms=13.0,
            firmware="kajimoto61 (version unknown)",
            polarities=("anodic",),
            host_timed=True,
        )

    def zero(self) -> None:
        # The first zeros complete an incomplete packet. Then `ZERO` ends the self-test.
        self._line.write(bytes(ELECTRODES))
        self._line.pause(0.02)
        self._line.write(ZERO)
        self._line.discard_input()

    def encode(self, sequence: ScanSequence) -> bytes:
        """Return the packet of a sequence. Raises BoardError if the board cannot deliver it."""
        electrode, current_ua = one_against_all(sequence)
        width_us, discharge_us = sequence.width_us, sequence.discharge_us
        wrong = (current_ua > 0) | (width_us != WIDTH_US) | (discharge_us > REST_US)
        if wrong.any():
            slot = int(wrong.argmax())
            raise BoardError(
                f"slot {slot} wants {-current_ua[slot]} µA anodic for {width_us[slot]} µs and "
                f"{discharge_us[slot]} µs of discharge, but this board makes anodic pulses of "
                f"{WIDTH_US} µs and grounds for {REST_US} µs: use the board's profile",
                slot=slot,
            )
        shortest = self.timing.shortest_period_us(0, sequence.slots, ELECTRODES, WIDTH_US, REST_US)
        if sequence.period_us < shortest:
            raise BoardError(
                f"a period of {sequence.period_us} µs is too short for {sequence.slots} "
                f"electrodes: this board needs {shortest} µs"
            )
        packet = np.zeros(1 + ELECTRODES, np.uint8)
        packet[0] = STIMULATE
        scale_ua, limits = self.ua_per_count, self._limits
        steps = steps_of(
            "kajimoto61", scale_ua, limits, WIDTH_US, -current_ua, electrode, COUNTS_PER_BYTE
        )
        packet[1 + electrode] = np.minimum(steps, LARGEST)
        return packet.tobytes()

    def write(self, proved: ProvedSequence) -> None:
        """Send a packet for each pass, at deadlines one period apart."""
        line, packet = self._line, self.encode(proved.sequence)
        now_ns, period_ns = line.now_ns(), 1000 * proved.sequence.period_us
        if now_ns > proved.write_before_ns:
            raise line.late()
        next_ns, self._next_ns = self._next_ns, None
        if next_ns is None or now_ns - next_ns > self._period_ns:
            # At the start of a run and after a pause, plan all deadlines anew.
            next_ns = now_ns + int(LEAD_S * 1e9)
        for scan in range(proved.times):
            if line.now_ns() < next_ns:
                line.wait_until(next_ns)
            if line.has_newer():
                if scan == 0:
                    line.board.replaced += 1
                break
            sent_ns = line.now_ns()
            proved = line.later(proved, next_ns)
            try:
                line.write(packet, proved)
            except LineLostError:
                # The board may have received the packet and delivered the scan.
                line.delivered(proved, 0, most=1)
                raise
            line.delivered(proved, 1)
            self._skipped += max(0, (sent_ns - next_ns) // period_ns)
            if self._skipped and sent_ns >= self._note_ns:
                # at most one note a minute
                line.board.notes.append(
                    f"this computer was too slow: {self._skipped} sequences were skipped"
                )
                self._skipped, self._note_ns = 0, sent_ns + 60_000_000_000
            # After a late packet, delay all later packets: catching up would exceed the proved
            # rate. A packet may be early by 1/20 of a period, which is the margin of the board.
            next_ns = max(next_ns + period_ns, sent_ns + period_ns - period_ns // HURRY)
            self._period_ns = period_ns
        self._next_ns = next_ns
