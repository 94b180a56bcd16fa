"""The line to an eTactileKit: firmware detection, queries, and recovery from lost bytes."""

import contextlib
import threading
import time
from contextlib import AbstractContextManager

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    OtherDeviceError,
    SilentBoardError,
)
from smarttouch.base.wire.port import LINE_ERRORS, Port, reason
from smarttouch.boards.kits import current_scale
from smarttouch.boards.kits.etactilekit_wire import (
    AT_REST,
    CHIPS,
    NO_SENSE,
    PING,
    QUIET,
    READINGS,
    ZEROS,
    zero_anywhere,
)
from smarttouch.boards.kits.scan_lock import Span
from smarttouch.boards.kits.watched_port import WatchedPort, require_watchdog
from smarttouch.boards.line import Line
from smarttouch.stimulation.safety_gate import ProvedSequence

FIRMWARES = ("71adee2", "newest")  # by their first commits in the repository
ECHO_S = 0.1
CHIPS_S = 0.5  # longest time to an answer
MORE_S = 0.03  # wait for more than the answer: USB chips keep bytes for 16 ms
FORGETS_S = 2.15  # silence after which a partial command is dropped
MOST_LOSSES = 4  # lost commands in a row after which the firmware cannot be driven safely
LOOKS = 5  # answers in a row without an echo after which the firmware has none
AWAY_S, AWAY_MOST_S = 0.6, 1.8
"""Time of a closed port after which the newest firmware drops half a command, and after which any
may have."""


class ETactileKitLine:
    """Dialogues with an eTactileKit: it detects the firmware and exchanges bytes with it.

    The board repeats its last pattern without a host: a watchdog is armed before anything that can
    become a current. ``lock`` is held for a dialogue, so that zero does not come between a command
    and its answer.
    """

    def __init__(self, line: Line, outputs: int, firmware: str | None) -> None:
        self.line: Line = line
        self.outputs: int = outputs
        self.zero: bytes = zero_anywhere(outputs)
        self.lock: AbstractContextManager[bool] = threading.RLock()
        self._wanted = firmware
        self._echo = bytes([outputs])
        self._losses = self._chips = 0
        self._watched: WatchedPort | None = None

    def connect(self, name: str) -> tuple[str, int]:
        """Open the port, put any firmware at zero, and return its name and its number of outputs.
        Another device than before gets nothing but a question."""
        line, is_known = self.line, self._is_known
        require_watchdog()
        line.connect(name, self._watch)
        if line.reopened and not is_known:
            self._recognize()
            self._arm()
            line.write(self.zero)
        else:
            # Only a reset takes the time to boot.
            line.pause(current_scale.BOOT_S)
        self._wanted, capacity = self._identify()
        self._arm()
        return self._wanted, capacity

    @property
    def is_at_zero(self) -> bool:
        """Whether the watchdog has put the board at zero."""
        return self._watched is not None and self._watched.at_zero

    @property
    def _is_known(self) -> bool:
        """Whether it is the same board as before, by its USB numbers."""
        return self.line.reopened and self.line.identity is not None

    def _watch(self, port: Port) -> Port:
        """Return the port, shared with a watchdog; the same board, which is back, gets zero."""
        if self._is_known:
            with contextlib.suppress(*LINE_ERRORS):
                port.write(self.zero)
        self._watched = WatchedPort(port, self.zero)
        if self._is_known:
            self._arm()
        return self._watched

    def _arm(self) -> None:
        assert self._watched is not None
        try:
            self._watched.arm()
        except LINE_ERRORS as error:
            raise self.line.lost(f"has vanished ({reason(error)})") from None

    # -- detection -----------------------------------------------------------

    def _identify(self) -> tuple[str, int]:
        chips = self._chips = self._wake()
        capacity = 8 * chips
        if self.outputs > capacity:
            raise BoardError(
                f"the eTactileKit at {self.line.name} has {capacity} outputs, the profile needs "
                f"{self.outputs}: use the profile of this board"
            )
        self._require_echo(chips)
        # No sense pulses: the guard of every change relies on that.
        self.line.write(QUIET + NO_SENSE + bytes([0xFC, self.outputs]) + PING)
        if self.line.read(1, ECHO_S) != self._echo:
            raise self.line.lost("does not echo its number of electrodes")
        if self._wanted is not None:
            return self._wanted, capacity
        return FIRMWARES[self._forgets_hosts() and self._forgets_hosts()], capacity

    def _wake(self) -> int:
        """Put the board at zero and its parser at the start of a command; return its number of
        chips."""
        for pause_s in (0.01, FORGETS_S):
            # An earlier host may have left half a pattern, which any byte but zero would complete
            # as a current. What zeros do not end, a silence does.
            self.line.write(ZEROS)
            self.line.pause(pause_s)
            for command in AT_REST:
                self.line.write(command)
            self.line.discard_input()
            self.line.write(CHIPS)
            if answer := self.line.read(1, CHIPS_S):
                return answer[0]
        raise SilentBoardError(
            f"the board at {self.line.name} does not answer as an eTactileKit does: check that "
            "it is on, and switch it off and on"
        )

    def _require_echo(self, chips: int) -> None:
        """Raise unless the firmware echoes; its number of electrodes is zero meanwhile."""
        for _ in range(LOOKS):
            self.line.discard_input()
            # The answer to the second byte shows whether the first was a query.
            self.line.write(PING + CHIPS)
            answer = self.line.read(1, CHIPS_S)
            if answer == b"\0" and self.line.read(1, CHIPS_S) == bytes([chips]):
                return
            if answer != bytes([chips]):
                raise self.line.lost(
                    "answers in a way that no known eTactileKit does "
                    f"({answer.hex() or 'not at all'}): switch it off and on, or update it"
                )
        for command in AT_REST:
            self.line.write(command)
        raise BoardError(
            f"the firmware of the eTactileKit at {self.line.name} is older than commit 71adee2, "
            "and not supported: flash the newest one of the kit's repository, "
            "aid-lab-org/eTactileKit"
        )

    def _forgets_hosts(self) -> bool:
        """Return whether it drops a partial command when its host was away for a while."""
        began = time.monotonic()
        self.line.write(b"\xfd")
        self.line.pause(0.05)
        self.line.reconnect(AWAY_S, self._watch)
        self.line.write(PING)
        forgets = self.line.read(1, ECHO_S) == self._echo
        in_time = time.monotonic() - began < AWAY_MOST_S
        self.line.discard_input()
        self.line.write(bytes(3) + PING)
        if self.line.read(1, CHIPS_S) != self._echo:
            self._resync()
        return forgets and in_time

    def _recognize(self) -> None:
        """Ask a device that has come back whether it is the same board, where USB does not tell."""
        # No zeros before the query: another device might act on them.
        for pause_s in (0.0, FORGETS_S):
            self.line.pause(pause_s)
            self.line.discard_input()
            self.line.write(CHIPS)
            if received := self.line.read(1, CHIPS_S):
                # A longer answer is another device's; zero waits only briefly for that.
                received += self.line.read(1, MORE_S)
                break
        if received != bytes([self._chips]):
            raise OtherDeviceError(
                f"what is at {self.line.name} now does not answer as that board did: nothing but "
                "this question was sent"
            )

    # -- queries -------------------------------------------------------------

    def exchange(
        self, body: bytes, *, ask: bool = False, drives: ProvedSequence | None = None
    ) -> tuple[Span, NDArray[np.uint16] | None] | None:
        """Send commands and wait until they are executed; return the span in which that was and, if
        asked for, the readings (N,) before them in the board's order. If the answer is wrong, lead
        the parser to the start of a command and return None. Commands that start the pulses of a
        sequence come with it, in ``drives``."""
        data = READINGS * ask + body + PING
        expected = 2 * self.outputs * ask + 1
        # A late answer must not be taken for this one's.
        self.line.discard_input()
        begun_ns = self.line.now_ns()
        if drives is None:
            self.line.write(data)
        else:
            self.line.drive(data, drives)
        answer = self.line.read(expected, ECHO_S)
        span = Span(begun_ns, self.line.now_ns())
        if len(answer) != expected or answer[-1:] != self._echo:
            self._resync()
            return None
        self._losses = 0
        return span, np.frombuffer(answer[:-1], "<u2") if ask else None

    def _resync(self) -> None:
        """Resynchronize the board's parser to the start of a command; nothing flows meanwhile."""
        self._losses += 1
        if self._losses > MOST_LOSSES:
            raise BoardError(
                f"{self._losses} commands in a row were lost on the way to the eTactileKit at "
                f"{self.line.name}, so it cannot be driven safely: use another cable and port, or "
                "flash the newest firmware of the kit's repository, aid-lab-org/eTactileKit"
            )
        # Zeros complete any half pattern, and are no commands; if not, silence does.
        for zeros, pause_s in ((ZEROS, 0.01), (b"", FORGETS_S)):
            self.line.write(zeros)
            self.line.pause(pause_s)
            self.line.discard_input()
            self.line.write(QUIET + bytes(4) + PING)
            # The answer may only be late, and a silence would cost far more.
            if self.line.read(1, CHIPS_S) == self._echo:
                return
        raise self.line.lost("does not answer any more")
