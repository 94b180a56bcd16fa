"""The line to an eTactileKit: firmware detection, queries, and recovery from lost bytes."""

import contextlib
import time
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    LineLostError,
    OtherDeviceError,
    SilentBoardError,
    not_offered,
)
from smarttouch.base.wire.port import Port, open_port
from smarttouch.boards.kits.etactilekit_wire import (
    AT_REST,
    CHIPS,
    NO_SENSE,
    PING,
    QUIET,
    READINGS,
    ZEROS,
)
from smarttouch.boards.kits.keeper import PAUSE_S, PIECE
from smarttouch.boards.kits.kept_line import KeptLine
from smarttouch.boards.kits.scan_lock import Span
from smarttouch.boards.kits.streamed import StreamedBoard
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits

FIRMWARES = ("71adee2", "newest")  # by their first commits in the repository
ECHO_S = 0.1
CHIPS_S = 0.5  # longest time to an answer
MORE_S = 0.03  # wait for more than the answer: USB chips keep bytes for 16 ms
FORGETS_S = 2.15  # silence after which a partial command is dropped
LOSSES_UNTIL_SLOW = 2
TRIES = 3
LOOKS = 5  # answers in a row without an echo after which the firmware has none
AWAY_S, AWAY_MOST_S = 0.6, 1.8
"""Time of a closed port after which the newest firmware drops half a command, and after which any
may have."""


class ETactileKitLine(StreamedBoard):
    """Line to an eTactileKit: detects its firmware, and exchanges bytes with it.

    The board repeats its last pattern without a host: `_promise_zero` comes before anything that
    can become a current.
    """

    kind = "etactilekit"
    takes_wiring: ClassVar[bool] = True
    can_be_asked: ClassVar[bool] = True

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        port, _, options = port.partition("?")
        self._slow, self._wanted = _parse(options)
        super().__init__(port, limits, output)
        wiring = None if output is None else output.wiring
        self._wiring = np.arange(limits.electrodes) if wiring is None else np.asarray(wiring)
        self._outputs = int(self._wiring.max()) + 1
        if self._outputs > 253:
            raise BoardError(
                f"output {self._outputs - 1} is out of reach: an eTactileKit counts to 253 outputs"
            )
        self._echo = bytes([self._outputs])
        self._lost_frames = 0
        self._senses = False  # whether it may be making sense pulses

    # -- zero by the keeper ----------------------------------------------------

    def _wrap(self, port: Port) -> Port:
        return KeptLine(port)

    def _promise_zero(self, zero: bytes) -> None:
        """Set the keeper's zero command; see `KeptLine.promise_zero`."""
        with self._open_port("has vanished") as port:
            port.promise_zero(zero, self._slow)

    def _at_zero(self) -> bool:
        return self._serial is not None and bool(self._serial.at_zero)

    def _aftermath(self) -> str:
        if self._at_zero():
            return ""
        return "; the board goes on with its last pattern: lift the finger, then switch it off"

    # -- detection -----------------------------------------------------------

    def _find_out(self) -> tuple[str, int]:
        """Put any firmware at zero; return its name and its number of outputs."""
        for _ in range(TRIES - 1):
            # Bytes may be lost here too.
            with contextlib.suppress(LineLostError):
                return self._identify()
        return self._identify()

    def _identify(self) -> tuple[str, int]:
        chips = self._chips = self._wake()
        capacity = 8 * chips
        if self._outputs > capacity:
            raise BoardError(
                f"the eTactileKit at {self._port_name} has {capacity} outputs, the profile needs "
                f"{self._outputs}: use the profile of this board"
            )
        self._require_echo(chips)
        # No sense pulses: the guard of every change relies on that.
        self._write_out(QUIET + NO_SENSE + bytes([0xFC, self._outputs]) + PING)
        if self._read(1, ECHO_S) != self._echo:
            raise self._lost("does not echo its number of electrodes")
        if self._wanted is not None:
            return self._wanted, capacity
        return FIRMWARES[self._forgets_hosts() and self._forgets_hosts()], capacity

    def _wake(self) -> int:
        """Put the board at zero and its parser at the start of a command; return its number of
        chips."""
        for pause_s in (0.01, FORGETS_S):
            # An earlier host may have left half a pattern, which any byte but zero would complete
            # as a current. What zeros do not end, a silence does.
            self._write_out(ZEROS)
            self._pause(pause_s)
            for command in AT_REST:
                self._write_out(command)
            self._flush()
            self._write(CHIPS)
            if answer := self._read(1, CHIPS_S):
                return answer[0]
        raise SilentBoardError(
            f"the board at {self._port_name} does not answer as an eTactileKit does: check that "
            "it is on, and switch it off and on"
        )

    def _require_echo(self, chips: int) -> None:
        """Raise unless the firmware echoes; its number of electrodes is zero meanwhile."""
        for _ in range(LOOKS):
            self._flush()
            # The answer to the second byte shows whether the first was a query.
            self._write(PING + CHIPS)
            answer = self._read(1, CHIPS_S)
            if answer == b"\0" and self._read(1, CHIPS_S) == bytes([chips]):
                return
            if answer != bytes([chips]):
                raise self._lost(
                    "answers in a way that no known eTactileKit does "
                    f"({answer.hex() or 'not at all'}): switch it off and on, or update it"
                )
        for command in AT_REST:
            self._write_out(command)
        raise BoardError(
            f"the firmware of the eTactileKit at {self._port_name} is older than commit 71adee2, "
            "and not supported: flash the newest one of the kit's repository, "
            "aid-lab-org/eTactileKit"
        )

    def _forgets_hosts(self) -> bool:
        """Return whether it drops a partial command when its host was away for a while."""
        began = time.monotonic()
        self._write(b"\xfd")
        self._pause(0.05)
        self._reconnect(AWAY_S)
        self._write(PING)
        forgets = self._read(1, ECHO_S) == self._echo
        in_time = time.monotonic() - began < AWAY_MOST_S
        self._flush()
        self._write(bytes(3) + PING)
        if self._read(1, CHIPS_S) != self._echo:
            self._resync()
        return forgets and in_time

    def _reconnect(self, away_s: float) -> None:
        assert self._serial is not None
        self._serial.close()
        self._pause(away_s)
        self._serial = self._wrap(open_port(self._port_name))

    def _recognize(self) -> None:
        # No zeros before the query: another device might act on them.
        for pause_s in (0.0, FORGETS_S):
            self._pause(pause_s)
            self._flush()
            self._write(CHIPS)
            if received := self._read(1, CHIPS_S):
                # A longer answer is another device's; zero waits only briefly for that.
                received += self._read(1, MORE_S)
                break
        if received != bytes([self._chips]):
            raise OtherDeviceError(
                f"what is at {self._port_name} now does not answer as that board did: nothing but "
                "this question was sent"
            )

    # -- queries -------------------------------------------------------------

    def _exchange(
        self, body: bytes, *, ask: bool = False, drives: bool = False
    ) -> tuple[Span, NDArray[np.uint16] | None] | None:
        """Send commands and wait until they are executed; return the span in which that was and, if
        asked for, the readings (N,) before them in the board's order; None if the answer is wrong.
        Commands that make current are marked by ``drives``."""
        data = READINGS * ask + body + PING
        expected = 2 * self._outputs * ask + 1
        # A late answer must not be taken for this one's.
        self._flush()
        begun_ns = self._clock.now_ns()
        with self._driving() if drives else contextlib.nullcontext():
            self._write_out(data)
        answer = self._read(expected, ECHO_S + (len(data) / PIECE * PAUSE_S if self._slow else 0.0))
        span = Span(begun_ns, self._clock.now_ns())
        if len(answer) != expected or answer[-1:] != self._echo:
            return None
        return span, np.frombuffer(answer[:-1], "<u2") if ask else None

    def _resync(self) -> None:
        """Resynchronize the board's parser to the start of a command; nothing flows meanwhile."""
        self._note_loss()
        # Zeros complete any half pattern, and are no commands; if not, silence does.
        for zeros, pause_s in ((ZEROS, 0.01), (b"", FORGETS_S)):
            self._write_out(zeros)
            time.sleep(pause_s)
            self._flush()
            self._write_out(QUIET + NO_SENSE * self._senses + bytes(4) + PING)
            # The answer may only be late, and a silence would cost far more.
            if self._read(1, CHIPS_S) == self._echo:
                return
        raise self._lost("does not answer any more")

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


def _parse(options: str) -> tuple[bool, str | None]:
    """Return whether to write slowly, and the firmware that the user chose."""
    slow, firmware = False, None
    for option in options.split("&") if options else ():
        name, _, value = option.partition("=")
        if option == "slow":
            slow = True
        elif name == "firmware":
            if value not in FIRMWARES:
                raise not_offered("?firmware", value, FIRMWARES, BoardError)
            firmware = value
        else:
            raise BoardError(f"etactilekit: takes the options ?slow and ?firmware, not ?{option}")
    return slow, firmware
