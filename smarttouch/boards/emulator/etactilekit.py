"""The firmware of the eTactileKit, version 2, to the byte, its faults included.

It refuses nothing: a wrong byte is a wrong current. It goes on with its last
pattern for ever, also without a host, and a scan that takes longer than its
period simply takes longer. Without a pulse width there are no pulses.

Where its source does not say: at power-on there are no electrodes, all heights,
times and modes are 0, and it is anodic; an unknown mode is monophasic; each
change counts from the next slot; outputs are grounded between pulses if there is
a discharge at all, else left unconnected; outputs beyond the electrode count are
unconnected.
"""

import math

from smarttouch.boards.emulator.books import Books
from smarttouch.boards.emulator.finger import Finger
from smarttouch.boards.emulator.single_source import LARGEST_READING, SingleSource
from smarttouch.boards.emulator.skin import COMPLIANCE_V

UA_PER_COUNT = 9.99
LARGEST = LARGEST_READING
SHORTEST_US = 6.6
"""What it takes to switch the source on and off."""
SWITCHING_NS = 10_000
FORGETS_NS = 2_000_000_000
DUMMY_OHM = 66e3
"""Load fitted beside the skin."""
RATE_HZ = 100
PATTERN, READINGS, COUNT, MODE, POLARITY, WIDTH = 0xFE, 0xFF, 0xFC, 0xFB, 0xFD, 0xFA
SENSE_HEIGHT, SENSE_WIDTH, DISCHARGE, RATE, CHIPS, ECHO = 0xF9, 0xF8, 0xF7, 0xF6, 0xF5, 0xF4
BIPHASIC, SENSE_ONLY = 1, 2
_MOST = 255
_SETTINGS = {
    COUNT: 1,
    MODE: 1,
    POLARITY: 1,
    WIDTH: 2,
    SENSE_HEIGHT: 1,
    SENSE_WIDTH: 1,
    DISCHARGE: 1,
    RATE: 2,
}
"""Bytes after each op-code that sets a number."""


class ETactileKitFirmware:
    """The kit between its line and its electrodes.

    Parameters
    ----------
    books : Books
        Its electrodes are all the outputs that there are.
    finger : Finger, optional
        What happens to the skin while it runs.
    compliance_v : float, V
    variant : int
        1 is silent to the questions that version 1 does not know.
    dummy_ohm : float
        Load beside the skin; infinite for none.
    """

    def __init__(
        self,
        books: Books,
        finger: Finger | None = None,
        compliance_v: float = COMPLIANCE_V,
        variant: int = 2,
        dummy_ohm: float = DUMMY_OHM,
    ) -> None:
        self.books, self._variant = books, variant
        self._chips = math.ceil(books.electrodes / 8)
        self._source = SingleSource(books, finger, compliance_v, dummy_ohm)
        self._set = dict.fromkeys(_SETTINGS, 0) | {POLARITY: 1, RATE: RATE_HZ}
        self._heights = [0] * _MOST
        self._readings, self._finished = [0] * _MOST, [0] * _MOST
        self._received = bytearray()
        self._begun_ns = self._fed_ns = 0
        self._slot = self._scan_ns = self._next_ns = 0
        self._pulsed = False

    @property
    def busy(self) -> bool:
        return not self._silent()

    def feed(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes from the host; return what there is to answer."""
        self.advance(now_ns)
        self._fed_ns = now_ns
        if not self._received:
            self._begun_ns = now_ns
        self._received += data
        answer = b""
        while (command := self._next_command(now_ns)) is not None:
            answer += self._obey(command)
        if self.books.state == "driving" and self._silent():
            self.books.state, self.books.reason = "shorted", "pattern"
        return answer

    def advance(self, now_ns: int) -> bytes:
        """Do all that is due; it has nothing to say unasked."""
        self._scan_until(now_ns)
        if self._received and now_ns - self._begun_ns >= FORGETS_NS:
            self._received.clear()
        return b""

    def hang_up(self, now_ns: int) -> None:
        """The host has closed the line, which this board does not notice."""
        self.advance(now_ns)

    def zero(self, reason: str, now_ns: int) -> None:
        """Forget the pattern, as without power."""
        self._heights = [0] * _MOST
        self._set[SENSE_HEIGHT] = 0
        self.books.state, self.books.reason = "shorted", reason
        self.books.zero_after_ms = (now_ns - self._fed_ns) / 1e6

    # -- commands ----------------------------------------------------------

    def _next_command(self, now_ns: int) -> bytes | None:
        received = self._received
        skipped = 0
        while skipped < len(received) and received[skipped] < ECHO:
            skipped += 1
        del received[:skipped]
        if not received:
            return None
        length = 1 + self._payload(received[0])
        if len(received) < length:
            return None
        command = bytes(received[:length])
        del received[:length]
        self._begun_ns = now_ns
        return command

    def _payload(self, code: int) -> int:
        return 2 * self._set[COUNT] if code == PATTERN else _SETTINGS.get(code, 0)

    def _obey(self, command: bytes) -> bytes:
        code, value = command[0], int.from_bytes(command[1:], "little")
        count = self._set[COUNT]
        if code == PATTERN:
            for electrode in range(count):
                height = int.from_bytes(command[1 + 2 * electrode : 3 + 2 * electrode], "little")
                self._heights[electrode] = min(height, LARGEST)
        elif code == READINGS:
            return b"".join(each.to_bytes(2, "little") for each in self._finished[:count])
        elif code in (CHIPS, ECHO):
            if self._variant < 2:
                return b""
            return bytes([self._chips if code == CHIPS else count])
        elif code != RATE or value:
            self._set[code] = value
        return b""

    # -- scanning ----------------------------------------------------------

    def _pulse_of(self, electrode: int) -> tuple[int, float]:
        """Return height in counts and width in µs of an electrode's pulse; 0 for none."""
        if self._set[MODE] == SENSE_ONLY:
            height, width = self._set[SENSE_HEIGHT], self._set[SENSE_WIDTH]
        else:
            height, width = self._heights[electrode], self._set[WIDTH]
        return height, max(float(width), SHORTEST_US) if width else 0.0

    def _silent(self) -> bool:
        """Whether no slot of a scan has a pulse."""
        count = self._set[COUNT]
        if self._set[MODE] == SENSE_ONLY:
            return not (count and self._set[SENSE_HEIGHT] and self._set[SENSE_WIDTH])
        return not (self._set[WIDTH] and any(self._heights[:count]))

    def _slot_ns(self) -> int:
        _, width = self._pulse_of(0)
        pulses = 2 if self._set[MODE] == BIPHASIC else 1
        return int(pulses * (1000 * width + SWITCHING_NS) + 1000 * self._set[DISCHARGE])

    def _scan_until(self, now_ns: int) -> None:
        silent = self._silent()
        while self._next_ns <= now_ns:
            count, slot_ns = self._set[COUNT], self._slot_ns()
            if silent and self._slot == 0 and self._pass(count * slot_ns, now_ns):
                continue
            if self._slot >= count:
                self._end_scan()
            else:
                self._execute(self._slot)
                self._slot += 1
                self._next_ns += slot_ns

    def _period_ns(self) -> int:
        return 10**9 // self._set[RATE]

    def _end_scan(self) -> None:
        count = self._set[COUNT]
        self._finished[:count] = self._readings[:count]
        self.books.sequences += self._pulsed
        self._pulsed = False
        # A scan that took too long is followed by the next at once.
        self._scan_ns = max(self._scan_ns + self._period_ns(), self._next_ns)
        self._next_ns, self._slot = self._scan_ns, 0

    def _pass(self, scan_ns: int, now_ns: int) -> bool:
        """Let all whole scans without pulses pass at once; return whether there were any."""
        each_ns = max(scan_ns, self._period_ns())
        scans = (now_ns - self._next_ns) // each_ns
        if not scans:
            return False
        count = self._set[COUNT]
        self._readings[:count] = self._finished[:count] = [0] * count
        self._next_ns += scans * each_ns
        self._scan_ns = self._next_ns
        return True

    def _execute(self, electrode: int) -> None:
        height, width_us = self._pulse_of(electrode)
        if not height or not width_us:
            self._readings[electrode] = 0
            return
        current_ua = height * UA_PER_COUNT * (-1 if self._set[POLARITY] else 1)
        discharge = self._set[DISCHARGE]
        biphasic = self._set[MODE] == BIPHASIC
        start_ns = self._next_ns
        phases = (current_ua, -current_ua) if biphasic else (current_ua,)
        for phase, phase_ua in enumerate(phases):
            last = phase == len(phases) - 1
            reading = self._source.pulse(
                self.books.sequences,
                electrode,
                phase_ua,
                width_us,
                start_ns,
                among=min(self._set[COUNT], self.books.electrodes),
                rest_us=discharge if last else 0,
                grounded=bool(discharge) and phase == 0,
                more=not last,
            )
            if phase == 0:
                self._readings[electrode] = reading
            start_ns += int(1000 * width_us) + SWITCHING_NS
        self._pulsed = True
        self.books.state = "driving"
