"""Emulated firmware of the eTactileKit, with the bytes, scans and faults of the real firmware.

The firmware checks nothing: a wrong byte causes a wrong current. Settings that arrive during a scan
apply to the next scan. A pulse of width 0 lasts 6.6 µs, because the source must be switched on and
off. The answer to READINGS has the last voltage of each electrode.

The firmware of commit 71adee2 does not parse commands during a scan. If a scan takes longer than
its period, the next scan follows immediately, and the parser never runs again. Without a host, this
firmware repeats its last pattern forever. The newest firmware parses commands on a second core.
Half a second after the host has gone, the newest firmware sets all amplitudes to zero. On the real
board, the half second begins when the host closes the USB port; here, at the host's last byte.

Two assumptions are not in the published source. Between pulses, outputs are grounded; if the
discharge time is 0, they are unconnected. Outputs beyond the electrode count are unconnected."""

import math
from dataclasses import dataclass

import numpy as np

from smarttouch.emulator.firmware_base import LARGEST_READING, DeliveryLog, KitFirmware
from smarttouch.emulator.skin import COMPLIANCE_V, EmulatedFinger

UA_PER_COUNT = 9.99
SWITCHING_NS = 10_000
FORGETS_NS, SILENCE_NS = 2_000_000_000, 500_000_000
DUMMY_OHM = 66e3  # load in parallel with the skin
RATE_HZ = 100
_MOST = 255
FIRMWARES = ("71adee2", "newest")
PATTERN, READINGS, COUNT, MODE, POLARITY, WIDTH = 0xFE, 0xFF, 0xFC, 0xFB, 0xFD, 0xFA
SENSE_HEIGHT, SENSE_WIDTH, DISCHARGE, RATE, CHIPS, ECHO = 0xF9, 0xF8, 0xF7, 0xF6, 0xF5, 0xF4
BIPHASIC, SENSE_ONLY = 1, 2
SHORTEST_US = 6.6  # duration of the shortest pulse: switching the source on and off
_SIZES = dict.fromkeys(range(RATE, PATTERN), 1) | {WIDTH: 2, RATE: 2}
"""Number of bytes after each op-code that sets a value."""
_Pulse = tuple[int, float, tuple[int, ...]]  # amplitude in counts, width µs, sign of each phase


@dataclass
class _Scan:
    """Settings of a scan, fixed at its start."""

    pulses: list[_Pulse]  # one for each electrode
    starts_ns: list[int]  # start of each slot, and end of the scan
    discharge_us: int
    done: int = 0
    pulsed: bool = False


class ETactileKitFirmware(KitFirmware):
    """Firmware of the kit on a model of the skin. The delivery log has the currents of all outputs.
    ``firmware`` is one of `FIRMWARES`; ``dummy_ohm`` is a load in parallel with the skin."""

    longest_step_ns = 400_000_000  # scans continue while this process is delayed for up to 0.4 s
    codes = range(ECHO, 256)

    def __init__(
        self,
        books: DeliveryLog,
        finger: EmulatedFinger | None = None,
        compliance_v: float = COMPLIANCE_V,
        firmware: str = "71adee2",
        dummy_ohm: float = DUMMY_OHM,
    ) -> None:
        super().__init__(books, finger, compliance_v, dummy_ohm)
        self._newest = firmware == FIRMWARES[1]
        self._chips = math.ceil(books.electrodes / 8)
        self._set = dict.fromkeys(_SIZES, 0) | {POLARITY: 1, RATE: RATE_HZ}
        self._heights, self._readings = [0] * _MOST, [0] * _MOST
        self._answers = b""
        self._begun_ns = self._started_ns = self._next_ns = 0
        self._scan: _Scan | None = None
        self._stuck = self._hushed = False

    @property
    def busy(self) -> bool:
        return bool(self._received) or not self._silent()

    def feed(self, data: bytes, now_ns: int) -> bytes:
        self._pass_time(now_ns)
        self._fed_ns, self._hushed = now_ns, False
        if not self._received:
            self._begun_ns = now_ns
        self._received += data
        if self._scan is None or self._newest:
            self._parse(now_ns)
        return self._take_answers()

    def advance(self, now_ns: int) -> bytes:
        self._pass_time(now_ns)
        return self._take_answers()

    def zero(self, reason: str, now_ns: int) -> None:
        super().zero(reason, now_ns)
        self._stop_all()
        self._scan = None

    def _take_answers(self) -> bytes:
        answers, self._answers = self._answers, b""
        return answers

    def _pass_time(self, now_ns: int) -> None:
        if self._newest and not self._hushed and now_ns - self._fed_ns >= SILENCE_NS:
            self._scan_until(self._fed_ns + SILENCE_NS)
            self._stop_all()
            self._received.clear()
            self._hushed = True
            self._settle("silence")
        self._scan_until(now_ns)
        if self._received and now_ns - self._begun_ns >= FORGETS_NS:
            self._received.clear()

    def _stop_all(self) -> None:
        self._heights = [0] * _MOST
        self._set[SENSE_HEIGHT] = 0

    # -- commands ----------------------------------------------------------

    def _parse(self, now_ns: int) -> None:
        while not self._stuck and (command := self._next_command()) is not None:
            self._begun_ns = now_ns
            self._answers += self._obey(command, now_ns)
        self._settle("pattern")

    def _length(self) -> int:
        code = self._received[0]
        return 1 + (2 * self._set[COUNT] if code == PATTERN else _SIZES.get(code, 0))

    def _obey(self, command: bytes, now_ns: int) -> bytes:
        code, value = command[0], int.from_bytes(command[1:], "little")
        count = self._set[COUNT]
        if code == PATTERN:
            heights = np.frombuffer(command[1:], "<u2").tolist()
            self._heights[:count] = [min(height, LARGEST_READING) for height in heights]
        elif code == READINGS:
            return np.array(self._readings[:count], "<u2").tobytes()
        elif code in (CHIPS, ECHO):
            return bytes([self._chips if code == CHIPS else count])
        elif code == RATE:
            self._set[RATE] = value or self._set[RATE]
            if not self._newest:
                self._next_ns = max(now_ns, self._started_ns + self._period_ns())
        elif code == COUNT:
            if self._newest:
                # In the newest firmware, an electrode has zero amplitude when it joins the scan.
                self._heights[count:value] = [0] * max(0, value - count)
            self._set[COUNT] = value
        else:
            self._set[code] = value
        return b""

    # -- scanning ----------------------------------------------------------

    def _pulses(self) -> list[_Pulse]:
        """Return the pulse of each electrode for a scan that starts now."""
        numbers, sign = self._set, -1 if self._set[POLARITY] else 1
        heights = self._heights[: numbers[COUNT]]
        if numbers[MODE] == SENSE_ONLY:
            sense_us = max(float(numbers[SENSE_WIDTH]), SHORTEST_US)
            return [(numbers[SENSE_HEIGHT], sense_us, (sign,))] * len(heights)
        phases = (sign, -sign) if numbers[MODE] == BIPHASIC else (sign,)
        width_us = max(float(numbers[WIDTH]), SHORTEST_US)
        return [(height, width_us, phases) for height in heights]

    def _silent(self) -> bool:
        """Return whether a scan that starts now would have no pulses."""
        return not any(height for height, _, _ in self._pulses())

    def _settle(self, reason: str) -> None:
        if self.books.state == "driving" and self._scan is None and self._silent():
            self.books.state, self.books.reason = "shorted", reason

    def _period_ns(self) -> int:
        return 1_000_000 // self._set[RATE] * 1000

    def _scan_until(self, now_ns: int) -> None:
        while True:
            if self._scan is not None:
                if not self._go_on(self._scan, now_ns):
                    return
            elif self._next_ns > now_ns:
                return
            else:
                self._begin(now_ns)

    def _begin(self, now_ns: int) -> None:
        pulses = self._pulses()
        discharge_us = self._set[DISCHARGE]
        lengths_ns = [
            int(len(phases) * (1000 * width_us + SWITCHING_NS)) + 1000 * discharge_us
            for _, width_us, phases in pulses
        ]
        if not any(height for height, _, _ in pulses) and not any(self._readings):
            # Skip all due scans in one step, because they have no pulses.
            each_ns = max(self._period_ns(), sum(lengths_ns))
            self._next_ns += (now_ns - self._next_ns) // each_ns * each_ns
        starts_ns = [self._next_ns]
        for length_ns in lengths_ns:
            starts_ns.append(starts_ns[-1] + length_ns)
        self._started_ns = self._next_ns
        self._scan = _Scan(pulses, starts_ns, discharge_us)

    def _go_on(self, scan: _Scan, now_ns: int) -> bool:
        """Execute the slots that are due; return whether the scan is over."""
        while scan.done < len(scan.pulses):
            if scan.starts_ns[scan.done] > now_ns:
                return False
            self._execute(scan, scan.done)
            scan.done += 1
        end_ns = scan.starts_ns[-1]
        if end_ns > now_ns:
            return False
        self._scan = None
        self.books.sequences += scan.pulsed
        self._next_ns = max(self._started_ns + self._period_ns(), end_ns)
        if not self._newest:
            self._stuck |= self._next_ns == end_ns
            self._parse(end_ns)
        self._settle("pattern")
        return True

    def _execute(self, scan: _Scan, electrode: int) -> None:
        height, width_us, phases = scan.pulses[electrode]
        self._readings[electrode] = 0
        if not height:
            return
        start_ns = scan.starts_ns[electrode]
        for phase, sign in enumerate(phases):
            last = phase == len(phases) - 1
            reading = self._pulse(
                self.books.sequences,
                electrode,
                sign * height * UA_PER_COUNT,
                width_us,
                start_ns,
                among=min(len(scan.pulses), self.books.electrodes),
                rest_us=scan.discharge_us if last else 0,
                grounded=bool(scan.discharge_us) and phase == 0,
                more=not last,
            )
            if phase == 0:
                self._readings[electrode] = reading
            start_ns += int(1000 * width_us) + SWITCHING_NS
        scan.pulsed = True
        self.books.state = "driving"
