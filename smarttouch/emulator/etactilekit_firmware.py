"""Emulated firmware of the eTactileKit, exact in bytes and scans, with its faults.

It refuses nothing: a wrong byte is a wrong current. A scan is fixed when it starts; later commands
count from the next one. All generations but the newest parse nothing while they scan, so a scan
that takes longer than its period is followed by the next at once and ends their parser for good. A
pulse without a width still takes the time of switching on and off. Voltages are those of the slots
as they pass, not of a finished scan.

All repeat their last pattern for ever but the newest, which puts every amplitude at zero half a
second after the host fell silent. (On USB, silence is that the host's port is closed; here, on a
pseudo-terminal, that no byte comes.)

Where the published source does not say: outputs are grounded between pulses if there is any
discharge, else left unconnected; outputs beyond the electrode count are unconnected.
"""

import math
from dataclasses import dataclass

from smarttouch.emulator import kit_hardware as op
from smarttouch.emulator.finger_events import EmulatedFinger
from smarttouch.emulator.firmware import DeliveryLog, Firmware
from smarttouch.emulator.kit_hardware import SingleSource
from smarttouch.emulator.skin import COMPLIANCE_V

UA_PER_COUNT = 9.99
SWITCHING_NS = 10_000
FORGETS_NS = 2_000_000_000
DUMMY_OHM = 66e3  # load fitted in parallel with the skin
RATE_HZ = 100
_MOST = 255


@dataclass
class _Scan:
    """Settings of a scan, fixed at its start."""

    pulses: list[op.Pulse]  # of each electrode
    starts_ns: list[int]  # of each slot; the last is the end
    discharge_us: int
    done: int = 0
    pulsed: bool = False


class ETactileKitFirmware(Firmware):
    """The kit between its line and its electrodes, which are all the outputs of its log;
    ``firmware`` is a key of `GENERATIONS`, and an infinite ``dummy_ohm`` is no load beside the
    skin."""

    longest_step_ns = 400_000_000  # its scans go on by its own clock while its process waits
    books: DeliveryLog

    def __init__(
        self,
        books: DeliveryLog,
        finger: EmulatedFinger | None = None,
        compliance_v: float = COMPLIANCE_V,
        firmware: str = "71adee2",
        dummy_ohm: float = DUMMY_OHM,
    ) -> None:
        self.books, self._is = books, op.GENERATIONS[firmware]
        self._chips = math.ceil(books.electrodes / 8)
        self._source = SingleSource(books, finger, compliance_v, dummy_ohm)
        self._set = dict.fromkeys(self._is.sizes, 0) | {op.POLARITY: 1, op.RATE: RATE_HZ}
        self._heights, self._readings = [0] * _MOST, [0] * _MOST
        self._received = bytearray()
        self._answers = b""
        self._begun_ns = self._fed_ns = self._started_ns = self._next_ns = 0
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
        if self._scan is None or not self._is.waits:
            self._parse(now_ns)
        return self._take_answers()

    def advance(self, now_ns: int) -> bytes:
        self._pass_time(now_ns)
        return self._take_answers()

    def zero(self, reason: str, now_ns: int) -> None:
        """Clear the pattern, as at a loss of power."""
        self._stop_all()
        self._scan = None
        self.books.state, self.books.reason = "shorted", reason
        self.books.zero_after_ms = (now_ns - self._fed_ns) / 1e6

    def _take_answers(self) -> bytes:
        answers, self._answers = self._answers, b""
        return answers

    def _pass_time(self, now_ns: int) -> None:
        silence_ns = self._is.silence_ns
        if silence_ns is not None and not self._hushed and now_ns - self._fed_ns >= silence_ns:
            self._scan_until(self._fed_ns + silence_ns)
            self._stop_all()
            self._received.clear()
            self._hushed = True
            self._settle("silence")
        self._scan_until(now_ns)
        if self._received and self._is.forgets and now_ns - self._begun_ns >= FORGETS_NS:
            self._received.clear()

    def _stop_all(self) -> None:
        self._heights = [0] * _MOST
        self._set[op.SENSE_HEIGHT] = 0
        if not self._is.has_modes:
            self._set[op.MODE] = 0

    # -- commands ----------------------------------------------------------

    def _parse(self, now_ns: int) -> None:
        while not self._stuck and (command := self._next_command(now_ns)) is not None:
            self._answers += self._obey(command, now_ns)
        self._settle("pattern")

    def _next_command(self, now_ns: int) -> bytes | None:
        received = self._received
        skipped = 0
        while skipped < len(received) and not self._knows(received[skipped]):
            skipped += 1
        del received[:skipped]
        if not received:
            return None
        length = 1 + self._payload(received[0])
        if length == 1 and received[0] == op.PATTERN and not self._is.forgets:
            # It waits for ever for the last of zero bytes.
            self._stuck = True
            return None
        if len(received) < length:
            return None
        command = bytes(received[:length])
        del received[:length]
        self._begun_ns = now_ns
        return command

    def _knows(self, code: int) -> bool:
        return code >= op.ECHO and (code > op.ECHO or self._is.echoes)

    def _payload(self, code: int) -> int:
        if code == op.PATTERN:
            return self._is.height_bytes * self._set[op.COUNT]
        return self._is.sizes.get(code, 0)

    def _obey(self, command: bytes, now_ns: int) -> bytes:
        code, value = command[0], int.from_bytes(command[1:], "little")
        count = self._set[op.COUNT]
        if code == op.PATTERN:
            size = self._is.height_bytes
            for electrode in range(count):
                height = command[1 + size * electrode : 1 + size * (electrode + 1)]
                self._heights[electrode] = min(int.from_bytes(height, "little"), op.LARGEST)
        elif code == op.READINGS:
            size = self._is.reading_bytes
            # One byte holds the upper eight of twelve bits.
            values = (each >> (4 if size == 1 else 0) for each in self._readings[:count])
            return b"".join(each.to_bytes(size, "little") for each in values)
        elif code in (op.CHIPS, op.ECHO):
            return bytes([self._chips if code == op.CHIPS else count])
        elif code == op.RATE:
            self._set[op.RATE] = value or self._set[op.RATE]
            if self._is.waits:
                self._next_ns = max(now_ns, self._started_ns + self._period_ns())
        elif code == op.COUNT:
            if self._is.silence_ns is not None:
                # In the newest, electrodes that join the scan begin at zero.
                self._heights[count:value] = [0] * max(0, value - count)
            self._set[op.COUNT] = value
        elif code != op.WIDTH or value or self._is.has_modes:
            self._set[code] = value
        return b""

    # -- scanning ----------------------------------------------------------

    def _pulses(self) -> list[op.Pulse]:
        """Return the pulse of each electrode in a scan that starts now."""
        heights = self._heights[: self._set[op.COUNT]]
        return [self._is.pulse(self._set, height) for height in heights]

    def _silent(self) -> bool:
        """Return whether a scan that starts now has no pulse."""
        return not any(height for height, _, _ in self._pulses())

    def _settle(self, reason: str) -> None:
        if self.books.state == "driving" and self._scan is None and self._silent():
            self.books.state, self.books.reason = "shorted", reason

    def _period_ns(self) -> int:
        if self._is.sizes[op.RATE] == 1:
            return round(1000 / self._set[op.RATE]) * 1_000_000
        return 1_000_000 // self._set[op.RATE] * 1000

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
        discharge_us = self._set[op.DISCHARGE]
        lengths_ns = [
            int(len(phases) * (1000 * width_us + SWITCHING_NS))
            + 1000 * discharge_us + self._is.slot_ns - SWITCHING_NS
            for _, width_us, phases in pulses
        ]  # fmt: skip
        if not any(height for height, _, _ in pulses) and not any(self._readings):
            # Scans without pulses are skipped at once.
            each_ns = max(self._period_ns(), sum(lengths_ns))
            self._next_ns += (now_ns - self._next_ns) // each_ns * each_ns
        starts_ns = [self._next_ns]
        for length_ns in lengths_ns:
            starts_ns.append(starts_ns[-1] + length_ns)
        self._started_ns = self._next_ns
        self._scan = _Scan(pulses, starts_ns, discharge_us)

    def _go_on(self, scan: _Scan, now_ns: int) -> bool:
        """Run the slots that are due; return whether the scan is over."""
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
        if self._is.waits:
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
            reading = self._source.pulse(
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
