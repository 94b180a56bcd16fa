"""Driver of the eTactileKit, version 2: the board loops the last pattern, the host sends changes.

On the wire (native USB, or TCP port 8080; little endian, no framing, no checksum)::

    FC u8   electrodes N        FB u8   0 monophasic, 1 biphasic, 2 impedance only
    FD u8   1 anodic 0 cathodic FA u16  pulse width µs
    F9 u8   sense height        F8 u8   sense width µs
    F7 u8   discharge µs        F6 u16  scans per second
    FE N×u16 heights in counts  FF      reply N×u16: ADC of the last finished scan
    F5      reply: chips        F4      reply: N, the only echo

A byte lost inside FE would leave the board waiting, and the next byte sent would
complete a pattern shifted by eight bits: up to 41 mA. So every change is guarded:
impedance-only with a sense height of zero (no pulses) goes before it, F4 after it,
and pulses come back only when its echo has come. A lost byte eats the F4: no echo,
no pulses, and the driver starts the board's parser afresh. Heights avoid bytes that
look like commands. A *doubled* byte cannot be told by anything on this wire; USB and
TCP do not double bytes.
"""

import time
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.board import BOTH, Capabilities
from smarttouch.boards.impedance import Impedance, judge
from smarttouch.boards.probe import one_each
from smarttouch.boards.streamed import Job, StreamedBoard, one_against_all
from smarttouch.errors import BoardError, LineLostError
from smarttouch.profile.device import Output
from smarttouch.scan.safety import SafetyLimits
from smarttouch.scan.sequence import ScanSequence
from smarttouch.scan.timing import ScanTiming

UA_PER_COUNT = 9.99
"""Nominal; its firmware does not cap 4095 counts, which are 41 mA."""
LARGEST = 1000
"""Counts, about 10 mA: nothing above leaves this host, whatever the limits."""
VOLTS_PER_COUNT = 0.0893
DUMMY_KOHM = 66.0
"""A load fitted beside the skin; it takes V / 66 kΩ of the current."""
COMPLIANCE_V = 300.0
"""Of its switches (HV513), the most a reading can be worth."""
FIRST_COMMAND = 0xF4
ECHO_S = 0.1
CHIPS_S = 0.5
FORGETS_S = 2.15
"""After such a silence it has dropped whatever half command it had."""
GRACE_S = 0.1
"""How much longer than its time a sequence may loop before it is taken away."""
PIECE, PAUSE_S = 8, 0.003
"""What USB of older firmware takes without losing bytes."""
LOSSES_UNTIL_SLOW = 2
SENSE_COUNTS, SENSE_US = 100, 50

QUIET = bytes([0xFB, 2])
PING = bytes([0xF4])


class ETactileKitBoard(StreamedBoard):
    """An eTactileKit: ``etactilekit:PORT`` or ``etactilekit:tcp://HOST:8080``.

    ``?slow`` after the port writes 8 bytes every 3 ms from the start, for USB of
    older firmware; the driver goes over to it by itself when frames get lost.
    """

    kind = "etactilekit"
    one_width: ClassVar[bool] = True
    usual_profile: ClassVar[str] = "etactilekit-32"
    takes_wiring: ClassVar[bool] = True
    timing = ScanTiming(slot_extra_us=10, every_electrode=True, whole_hz=True, load=0.9)

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        port, _, option = port.partition("?")
        if option not in ("", "slow"):
            raise BoardError(f"etactilekit: knows the option ?slow, not ?{option}")
        super().__init__(port, limits, output)
        wiring = None if output is None else output.wiring
        self._wiring = np.arange(limits.electrodes) if wiring is None else np.asarray(wiring)
        self._outputs = int(self._wiring.max()) + 1
        if self._outputs > 253:
            raise BoardError(
                f"output {self._outputs - 1} is out of reach: an eTactileKit counts to 253 outputs"
            )
        measured = None if output is None else output.ua_per_count
        self.ua_per_count: float = measured or UA_PER_COUNT
        self._largest = min(LARGEST, int(limits.current_ma * 1000 / self.ua_per_count))
        self._slow = option == "slow"
        self._lost_frames = 0
        self._on_board = b""
        self._settings: tuple[int, int, int, bool] | None = None
        self._sent: ScanSequence | None = None
        self._volts: list[tuple[ScanSequence, NDArray[np.float32]]] = []

    # -- opening and closing -----------------------------------------------

    def _greet(self) -> None:
        self._on_board, self._settings, self._sent = b"", None, None
        self._flush()
        self._write(b"\xf5")
        answer = self._read(1, CHIPS_S)
        if not answer:
            # A host before us may have left half a command: it forgets that in silence.
            time.sleep(FORGETS_S)
            self._flush()
            self._write(b"\xf5")
            answer = self._read(1, CHIPS_S)
        if not answer:
            raise BoardError(
                f"the board at {self._port_name} does not answer as an eTactileKit v2 does: check "
                "that it is on and its firmware is v2 (v1 cannot be told from other boards)"
            )
        capacity = 8 * answer[0]
        if self._outputs > capacity:
            raise BoardError(
                f"the eTactileKit at {self._port_name} has {capacity} outputs, the profile needs "
                f"{self._outputs}: use the profile of this board"
            )
        # No sense pulses: the guard of every change counts on that.
        self._write_out(b"\xf9\0\0\xf8\0\0" + bytes([0xFC, self._outputs]) + PING)
        if self._read(1, ECHO_S) != bytes([self._outputs]):
            raise BoardError(
                f"the board at {self._port_name} does not echo its number of electrodes: its "
                "firmware is not eTactileKit v2; update it"
            )
        if not self._transmit(self._frame(bytes(2 * self._outputs)), None):
            raise self._lost("does not answer to a pattern of zeros")
        self.capabilities = Capabilities(
            electrodes=self._gate.limits.electrodes,
            output="one-against-all",
            max_current_ma=LARGEST * self.ua_per_count / 1000,
            max_slots=self._gate.limits.electrodes,
            time_to_zero_ms=None,
            firmware=f"eTactileKit v2, {capacity} outputs",
            polarities=BOTH,
            acknowledges=True,
            measures=True,
            compliance_v=COMPLIANCE_V,
        )

    def _zero(self) -> None:
        if self._transmit(self._frame(bytes(2 * self._outputs)), None):
            return
        if self._resync() and self._transmit(self._frame(bytes(2 * self._outputs)), None):
            return
        raise self._lost("does not confirm a pattern of zeros")

    def _aftermath(self) -> str:
        return "; an eTactileKit goes on with its last pattern: lift the finger, then switch it off"

    # -- sequences ---------------------------------------------------------

    def _encode(self, sequence: ScanSequence) -> bytes:
        electrode, current_ua = one_against_all(sequence)
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
        discharge = int(sequence.discharge_us.max(initial=0))
        if discharge >= FIRST_COMMAND:
            raise BoardError(
                f"a discharge of {discharge} µs is too long: at most {FIRST_COMMAND - 1}"
            )
        counts = np.minimum(np.rint(np.abs(current_ua) / self.ua_per_count), self._largest)
        heights = np.zeros(self._outputs, np.uint16)
        heights[self._wiring[electrode]] = counts.astype(np.uint16)
        # A byte that looks like a command would be one, if the FE before it were lost.
        low = heights & 0xFF
        heights -= np.where(low >= FIRST_COMMAND, low - (FIRST_COMMAND - 1), 0).astype(np.uint16)
        return heights.astype("<u2").tobytes()

    def _frame(self, heights: bytes) -> bytes:
        return QUIET + b"\xfe" + heights

    def _serve(self) -> None:
        until_s: float | None = None
        while not self._closing.is_set():
            self._rest()
            job = self._take(until_s)
            if self._closing.is_set():
                return
            with self._line:
                if self._closing.is_set():
                    return
                if job is None:
                    self._zero()
                    until_s = None
                    continue
                began = time.monotonic()
                done = self._show(job)
            period_s = job.sequence.period_us / 1e6
            until_s = time.monotonic() + job.times * period_s + GRACE_S
            if done:
                self._delivered(job, job.times)
            else:
                self.refused += 1
            if self._slow:
                # Pulses pause while a change is written: leave them as much time as it took.
                self._closing.wait(time.monotonic() - began)

    def _show(self, job: Job) -> bool:
        """Put a sequence on the board if it is another; return whether the board has it."""
        sequence = job.sequence
        settings = self._settings_of(sequence)
        if sequence.slots and settings != self._settings:
            if not self._set(settings):
                return False
            self._settings = settings
        elif job.data == self._on_board:
            return True
        return self._transmit(self._frame(job.data), sequence)

    def _settings_of(self, sequence: ScanSequence) -> tuple[int, int, int, bool]:
        anodic = bool(sequence.slots) and bool(
            sequence.current_ua[0, np.abs(sequence.current_ua[0].astype(int)).argmax()] < 0
        )
        return (
            int(sequence.width_us.max(initial=0)),
            int(sequence.discharge_us.max(initial=0)),
            max(1, round(1e6 / sequence.period_us)),
            anodic,
        )

    def _set(self, settings: tuple[int, int, int, bool]) -> bool:
        """Set pulse and rate while nothing flows, each followed by zeros that end it."""
        width, discharge, rate, anodic = settings
        # Were the first byte of a word lost, the zeros would make it zero, not a longer pulse.
        end = bytes(3)
        commands = (
            QUIET + end + b"\xf9\0" + end + b"\xf8\0" + end
            + bytes([0xFD, anodic]) + end
            + b"\xfa" + width.to_bytes(2, "little") + end
            + bytes([0xF7, discharge]) + end
            + b"\xf6" + rate.to_bytes(2, "little") + end
        )  # fmt: skip
        self._on_board = b""
        self._write_out(QUIET + b"\xfe" + bytes(2 * self._outputs) + commands * 2 + PING)
        if self._read(1, ECHO_S + self._wire_s(commands * 2)) == bytes([self._outputs]):
            return True
        self._note_loss()
        self._resync()
        return False

    def _transmit(self, frame: bytes, sequence: ScanSequence | None) -> bool:
        """Send a pattern under guard; return whether the board has it and pulses again."""
        heights = frame[len(QUIET) + 1 :]
        self._on_board = b""
        # The voltages are those of the pattern before: ask while it is still there.
        ask = self._sent is not None and self._sent.slots > 0
        self._write_out((b"\xff" if ask else b"") + frame + PING)
        expected = 2 * self._outputs * ask + 1
        answer = self._read(expected, ECHO_S + self._wire_s(frame))
        if len(answer) != expected or answer[-1] != self._outputs:
            self._note_loss()
            self._resync()
            return False
        if ask and self._sent is not None:
            self._note_volts(self._sent, answer[:-1])
        self._write_out(bytes([0xFB, 0]))
        self._on_board, self._sent = heights, sequence
        return True

    def _note_volts(self, sequence: ScanSequence, readings: bytes) -> None:
        adc = np.frombuffer(readings, "<u2")
        electrode, _ = one_against_all(sequence)
        volts = (adc[self._wiring[electrode]] * VOLTS_PER_COUNT).astype(np.float32)
        with self._news:
            self._volts = [*self._volts[-63:], (sequence, volts)]
        if volts.any():
            self.lifted = bool((volts >= 0.97 * COMPLIANCE_V).all())

    def take_volts(self) -> list[tuple[ScanSequence, NDArray[np.float32]]]:
        with self._news:
            taken, self._volts = self._volts, []
        return taken

    # -- a byte was lost ---------------------------------------------------

    def _resync(self) -> bool:
        """Bring the board's parser back to where a command begins; nothing flows meanwhile."""
        self._sent = None
        # Zeros complete any half pattern, and are no commands; if not, silence does.
        for zeros, pause_s in ((2 * 255 + 4, 0.01), (0, FORGETS_S)):
            self._write_out(bytes(zeros))
            time.sleep(pause_s)
            self._flush()
            self._write_out(QUIET + bytes(4) + PING)
            if self._read(1, ECHO_S) == bytes([self._outputs]):
                return True
        return False

    def _note_loss(self) -> None:
        self._lost_frames += 1
        if self._slow or "://" in self._port_name:
            return
        if self._lost_frames >= LOSSES_UNTIL_SLOW:
            self._slow = True
            self.notes.append(
                f"{self._lost_frames} patterns were lost on the way to the board: from then on "
                f"{PIECE} bytes went every {1000 * PAUSE_S:g} ms (?slow)"
            )

    def _write_out(self, data: bytes) -> None:
        if not self._slow:
            self._write(data)
            return
        for start in range(0, len(data), PIECE):
            self._write(data[start : start + PIECE])
            time.sleep(PAUSE_S)

    def _wire_s(self, data: bytes) -> float:
        return len(data) / PIECE * PAUSE_S if self._slow else 0.0

    # -- measuring ---------------------------------------------------------

    def _measure(self) -> Impedance:
        width, counts = SENSE_US, min(SENSE_COUNTS, self._largest)
        level_ua = int(counts * self.ua_per_count)
        self._gate.prove_measurement(
            one_each(
                self._gate.limits, level_ua, width, 1.0, time.monotonic_ns(), cathodic=False,
                period_us=100_000,
            )
        )  # fmt: skip
        self.drain()
        with self._line:
            self._zero()
            # Ten scans a second; two of them are over when the readings are asked for.
            self._write_out(
                QUIET + b"\xfd\x01\xf7\x64\xf6\x0a\0" + bytes([0xF8, width, 0xF9, counts])
            )
            time.sleep(0.25)
            self._write_out(b"\xff\xf9\0\xf8\0" + PING)
            answer = self._read(2 * self._outputs + 1, 0.5)
            self._settings = None
            self._zero()
        if len(answer) != 2 * self._outputs + 1:
            raise LineLostError(
                f"the board at {self._port_name} told {len(answer) // 2} of {self._outputs} "
                "readings: measure again"
            )
        adc = np.frombuffer(answer[:-1], "<u2")[self._wiring].astype(np.float64)
        volts = adc * VOLTS_PER_COUNT
        through_skin = np.maximum(level_ua / 1000 - volts / DUMMY_KOHM, 1e-6)
        return judge(volts, through_skin, COMPLIANCE_V)
