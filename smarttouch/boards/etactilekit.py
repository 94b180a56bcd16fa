"""Driver of the eTactileKit, version 2: the board loops the last pattern, the host sends changes.

What goes over the wire, and what guards it, stands in `etactilekit_wire`.
"""

import time
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.board import BOTH, Capabilities
from smarttouch.boards.etactilekit_readings import COMPLIANCE_V, Readings
from smarttouch.boards.etactilekit_wire import (
    CHIPS,
    LARGEST,
    NO_SENSE,
    ON,
    PING,
    QUIET,
    READINGS,
    SENSE,
    SENSE_COUNTS,
    SENSE_US,
    UA_PER_COUNT,
    ZEROS,
    Settings,
    heights_of,
    pattern,
    settings_of,
)
from smarttouch.boards.impedance import Impedance
from smarttouch.boards.probe import one_each
from smarttouch.boards.streamed import Job, StreamedBoard
from smarttouch.errors import BoardError, LineLostError, SequenceLateError
from smarttouch.profile.device import Output
from smarttouch.scan.safety import SafetyLimits
from smarttouch.scan.sequence import ScanSequence
from smarttouch.scan.timing import ScanTiming

ECHO_S = 0.1
CHIPS_S = 0.5
"""The longest that it takes to answer anything."""
FORGETS_S = 2.15
"""After such a silence it has dropped whatever half command it had."""
GRACE_S = 0.1
"""How much longer than its time a sequence may loop before it is taken away."""
PIECE, PAUSE_S = 8, 0.003
"""What USB of older firmware takes without losing bytes."""
LOSSES_UNTIL_SLOW = 2


class ETactileKitBoard(StreamedBoard):
    """An eTactileKit: ``etactilekit:PORT`` or ``etactilekit:tcp://HOST:8080``.

    ``?slow`` after the port writes 8 bytes every 3 ms from the start, for USB of
    older firmware; the driver goes over to it by itself when frames get lost.
    """

    kind = "etactilekit"
    usual_profile: ClassVar[str] = "etactilekit-32"
    takes_wiring: ClassVar[bool] = True
    timing = ScanTiming(
        slot_extra_us=10, every_electrode=True, own_widths=False, whole_hz=True, load=0.9
    )

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
        self._nothing = bytes(2 * self._outputs)
        self._slow = option == "slow"
        self._lost_frames = 0
        self._on_board = b""
        self._settings: Settings | None = None
        self._sent: ScanSequence | None = None
        self._readings = Readings(self._wiring)

    # -- opening and closing -----------------------------------------------

    def _greet(self) -> None:
        self._on_board, self._settings, self._sent = b"", None, None
        # A host before us may have left half a pattern: any other byte would complete it, as a
        # current. What zeros do not end, it forgets in silence.
        self._write_out(ZEROS)
        answer = b""
        for pause_s in (0.01, FORGETS_S):
            self._pause(pause_s)
            self._flush()
            self._write(CHIPS)
            if answer := self._read(1, CHIPS_S):
                break
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
        self._write_out(NO_SENSE + bytes([0xFC, self._outputs]) + PING)
        if self._read(1, ECHO_S) != bytes([self._outputs]):
            raise BoardError(
                f"the board at {self._port_name} does not echo its number of electrodes: its "
                "firmware is not eTactileKit v2; update it"
            )
        if not self._transmit(self._nothing, None):
            raise self._lost("does not answer to a pattern of zeros")
        self._note_round_trip(self._ping)
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

    def _ping(self) -> bytes:
        self._write(PING)
        return self._read(1, ECHO_S)

    def _zero(self) -> None:
        if not (self._transmit(self._nothing, None) or self._transmit(self._nothing, None)):
            raise self._lost("does not confirm a pattern of zeros")

    def _aftermath(self) -> str:
        return "; an eTactileKit goes on with its last pattern: lift the finger, then switch it off"

    # -- sequences ---------------------------------------------------------

    def _encode(self, sequence: ScanSequence) -> bytes:
        settings_of(sequence)
        assert self.ua_per_count is not None
        return heights_of(sequence, self._wiring, self.ua_per_count, self._largest)

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
                try:
                    done = self._show(job)
                except SequenceLateError:
                    self._zero()
                    self._drop_late(job)
                    until_s = None
                    continue
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
        """Put a sequence on the board if it is another; return whether the board has it.

        `SequenceLateError` if it was to begin too long ago.
        """
        sequence = job.sequence
        settings = settings_of(sequence)
        due_ns = job.due_ns + int(1e9 * self._wire_s(2 * settings.commands() + job.data))
        if self._is_late(due_ns):
            raise self._late()
        if sequence.slots and settings != self._settings:
            if not self._set(settings):
                return False
        elif job.data == self._on_board:
            return True
        return self._transmit(job.data, sequence, due_ns)

    def _set(self, settings: Settings) -> bool:
        """Set pulse and rate while nothing flows; return whether the board has them."""
        commands = pattern(self._nothing)[:-1] + settings.commands() + PING
        self._on_board, self._settings = b"", None
        self._flush()
        self._write_out(commands)
        if self._read(1, ECHO_S + self._wire_s(commands)) == bytes([self._outputs]):
            self._settings = settings
            return True
        self._resync()
        return False

    def _transmit(
        self, heights: bytes, sequence: ScanSequence | None, due_ns: int | None = None
    ) -> bool:
        """Send a pattern under guard; return whether the board has it and pulses again.

        With the time when it was to begin, `SequenceLateError` if that is too long ago; it
        does not pulse then.
        """
        self._on_board = b""
        # The voltages are those of the pattern before: ask while it is still there.
        ask = self._sent is not None and self._sent.slots > 0
        frame = (READINGS if ask else b"") + pattern(heights)
        # An echo that was late must not pass for that of this pattern.
        self._flush()
        self._write_out(frame)
        expected = 2 * self._outputs * ask + 1
        answer = self._read(expected, ECHO_S + self._wire_s(frame))
        if len(answer) != expected or answer[-1] != self._outputs:
            self._resync()
            return False
        if ask and self._sent is not None:
            self.lifted = self._readings.note(self._sent, answer[:-1], self.lifted)
        if due_ns is None:
            self._write_out(ON)
        elif not self._write_in_time(ON, due_ns):
            self._sent = None
            raise self._late()
        self._on_board, self._sent = heights, sequence
        return True

    def take_volts(self) -> list[tuple[ScanSequence, NDArray[np.float32]]]:
        return self._readings.take()

    # -- a byte was lost ---------------------------------------------------

    def _resync(self) -> None:
        """Bring the board's parser back to where a command begins; nothing flows meanwhile.

        Raises
        ------
        LineLostError
            If it does not echo any more.
        """
        self._note_loss()
        self._sent = None
        # Zeros complete any half pattern, and are no commands; if not, silence does.
        for zeros, pause_s in ((ZEROS, 0.01), (b"", FORGETS_S)):
            self._write_out(zeros)
            time.sleep(pause_s)
            self._flush()
            self._write_out(QUIET + bytes(4) + PING)
            # It may only have been late, and silence costs far more than waiting here.
            if self._read(1, CHIPS_S) == bytes([self._outputs]):
                return
        raise self._lost("does not echo any more")

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
        assert self.ua_per_count is not None
        level_ua = int(SENSE_COUNTS * self.ua_per_count)
        self._gate.prove_measurement(
            one_each(
                self._gate.limits, level_ua, SENSE_US, 1.0, time.monotonic_ns(), cathodic=False,
                period_us=100_000,
            )
        )  # fmt: skip
        self.drain()
        with self._line:
            self._zero()
            # Ten scans a second; two of them are over when the readings are asked for.
            self._write_out(SENSE)
            time.sleep(0.25)
            self._write_out(READINGS + NO_SENSE + PING)
            answer = self._read(2 * self._outputs + 1, 0.5)
            self._settings = None
            self._zero()
        if len(answer) != 2 * self._outputs + 1:
            raise LineLostError(
                f"the board at {self._port_name} told {len(answer) // 2} of {self._outputs} "
                "readings: measure again"
            )
        return self._readings.impedance(answer[:-1], level_ua / 1000)
