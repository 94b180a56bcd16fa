"""Emulated firmware of the 61-electrode ESP32 kit, with the bytes and faults of the real firmware.

The firmware checks nothing, and waits forever for the rest of an incomplete packet. A reading that
is too large for a byte wraps around. From power-on until the first STIMULATE, the firmware tests
its current source without driving an electrode; meanwhile it answers MEASURE. A STIMULATE of zeros
causes no pulse. After the test, the D/A converter keeps the test's last value until the next pulse.
If STIMULATE causes it, it begins with this value, until the converter has loaded the right one."""

from collections import deque
from dataclasses import dataclass, field

from smarttouch.emulator.firmware_base import DeliveryLog, KitFirmware
from smarttouch.emulator.skin import COMPLIANCE_V, EmulatedFinger

ELECTRODES = 61
STIMULATE, MEASURE = 0xFF, 0xFE
PACKET = 1 + ELECTRODES
LARGEST = 200
UA_PER_STEP = 16 * 10_000 / 4096  # a step is 16 DAC counts; 4096 counts are nominally 10 mA
WIDTH_US, GROUNDED_US, SWITCHING_US = 50, 150, 8
TEST_UA = 898 * 10_000 / 4096  # last current of the self-test
LOADING_US = 3  # time in which the D/A converter loads a value
MEASURE_UA, MEASURE_US = 2500, 25
MEASURE_NS, WIRE_NS = 1_400_000, 670_000  # delay and duration of the reply to MEASURE
BUFFER = 384  # bytes buffered during a scan: 128 in the chip, 256 in its driver (an estimate)


@dataclass
class _Scan:
    """Scan of the electrodes, one after another."""

    number: int
    pulses: list[tuple[int, float]]  # electrode, and current in µA, positive cathodic
    start_ns: int
    measures: bool = False
    readings: list[int] = field(default_factory=list)

    @property
    def slot_ns(self) -> int:
        if self.measures:
            return MEASURE_US * 1000
        return (WIDTH_US + GROUNDED_US + SWITCHING_US) * 1000

    @property
    def end_ns(self) -> int:
        return self.start_ns + len(self.pulses) * self.slot_ns


class Kajimoto61Firmware(KitFirmware):
    """Firmware of the kit on a model of the skin."""

    codes = (STIMULATE, MEASURE)

    def __init__(
        self,
        books: DeliveryLog,
        finger: EmulatedFinger | None = None,
        compliance_v: float = COMPLIANCE_V,
    ) -> None:
        super().__init__(books, finger, compliance_v)
        books.state, self._testing = "self-test", True
        self._free_ns = self._commands = 0
        self._scan: _Scan | None = None
        self._replies: deque[tuple[int, bytes]] = deque()
        self._loaded_ua = TEST_UA

    @property
    def busy(self) -> bool:
        return self._scan is not None or bool(self._replies)

    def feed(self, data: bytes, now_ns: int) -> bytes:
        self._run(now_ns)
        self._fed_ns = now_ns
        self._received += data
        self._run(now_ns)
        # Packets wait while a scan runs; bytes beyond the buffer are lost.
        del self._received[BUFFER:]
        return self._take_replies(now_ns)

    def advance(self, now_ns: int) -> bytes:
        self._run(now_ns)
        return self._take_replies(now_ns)

    def zero(self, reason: str, now_ns: int) -> None:
        super().zero(reason, now_ns)
        self._scan = None
        self._replies.clear()

    def _take_replies(self, now_ns: int) -> bytes:
        taken = b""
        while self._replies and self._replies[0][0] <= now_ns:
            taken += self._replies.popleft()[1]
        return taken

    def _run(self, now_ns: int) -> None:
        while self._is_free(now_ns) and (command := self._next_command()) is not None:
            measures = command[0] == MEASURE
            self._testing &= measures
            currents = [-float(MEASURE_UA)] * ELECTRODES
            if not measures:
                currents = [-UA_PER_STEP * value * (value <= LARGEST) for value in command[1:]]
            pulses = [(electrode, current) for electrode, current in enumerate(currents) if current]
            self._commands += 1
            start_ns = max(self._free_ns, self._fed_ns)
            self._scan = _Scan(self._commands, pulses, start_ns, measures)
            if pulses:
                self.books.state = "driving"

    def _is_free(self, now_ns: int) -> bool:
        if self._scan is not None:
            self._execute(self._scan, now_ns)
        return self._scan is None

    def _length(self) -> int:
        return PACKET if self._received[0] == STIMULATE else 1

    def _execute(self, scan: _Scan, now_ns: int) -> None:
        while (done := len(scan.readings)) < len(scan.pulses):
            start_ns = scan.start_ns + done * scan.slot_ns
            if start_ns > now_ns:
                return
            electrode, current_ua = scan.pulses[done]
            if self._loaded_ua and not scan.measures:
                start_ns += self._connect_early(scan, electrode, start_ns)
            self._loaded_ua = 0.0
            reading = self._pulse(
                scan.number, electrode, current_ua, MEASURE_US if scan.measures else WIDTH_US,
                start_ns, among=ELECTRODES,
                rest_us=0 if scan.measures else GROUNDED_US + SWITCHING_US, slot=done,
            )  # fmt: skip
            scan.readings.append(reading)
        if scan.end_ns > now_ns:
            return
        self._scan, self._free_ns = None, scan.end_ns
        self.books.state, self.books.reason = ("self-test" if self._testing else "shorted"), "end"
        if self._testing:
            self._loaded_ua = TEST_UA
        if scan.measures:
            wrapped = bytes(min(254, (reading >> 2) % 256) for reading in scan.readings)
            ready_ns = scan.start_ns + MEASURE_NS + WIRE_NS
            self._replies.append((ready_ns, wrapped + bytes([0xFF])))
        else:
            self.books.sequences += 1

    def _connect_early(self, scan: _Scan, electrode: int, start_ns: int) -> int:
        """Deliver the current of the last value of the self-test, which the D/A converter still
        holds. Return how long this current flows, ns."""
        self._pulse(
            scan.number, electrode, -self._loaded_ua, LOADING_US, start_ns, among=ELECTRODES,
            rest_us=0, grounded=False, more=True,
        )  # fmt: skip
        return 1000 * LOADING_US
