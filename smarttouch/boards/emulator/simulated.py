"""Emulated board without a process or waiting: sequences advance its simulated time."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards import link_protocol as protocol
from smarttouch.boards.emulator import second
from smarttouch.boards.emulator.delivery_log import DeliveryLog
from smarttouch.boards.emulator.link import LinkFirmware
from smarttouch.boards.link_host import LinkHost
from smarttouch.boards.link_protocol import Kind
from smarttouch.boards.link_session import ANSWERS, HostSession, Message
from smarttouch.boards.link_setup import reason_of
from smarttouch.errors import BoardError, SilentBoardError
from smarttouch.profile.device import Output
from smarttouch.registry import refuse_rest
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence
from smarttouch.wire.framing import Deframer

_BEAT_NS = protocol.SILENCE_MS * 1_000_000 // 2  # longest time that the host says nothing
_LONGEST_GAP_NS = 1000 * (second.KEPT_US + second.SECOND_US)
"""Gap after which a board has forgotten all but its session: a longer one is cut to this."""

Pulses = tuple[NDArray[np.uint32], NDArray[np.float32], NDArray[np.int16]]
"""Sequence of each slot (N,), its width (N,) µs, and its delivered current (N, E) µA, positive
cathodic.
"""


@dataclass
class _KeptBooks(DeliveryLog):
    """Delivery log that keeps every pulse in memory until it is taken."""

    _kept: list[tuple[int, float, NDArray[np.int16]]] = field(default_factory=list, repr=False)

    def keep(self, number: int, width_us: float, current_ua: NDArray[np.float64]) -> None:
        self._kept.append((number, width_us, np.rint(current_ua).astype(np.int16)))

    def take(self) -> Pulses:
        kept, self._kept = self._kept, []
        current_ua = np.array([each for _, _, each in kept], np.int16)
        return (
            np.array([number for number, _, _ in kept], np.uint32),
            np.array([width for _, width, _ in kept], np.float32),
            current_ua.reshape(len(kept), self.electrodes),
        )


class _Line:
    """Line to firmware in the same thread, with the time that both go by."""

    name = "simulated:"

    def __init__(self, firmware: LinkFirmware, hear: Callable[[Message], None]) -> None:
        self.session, self.now_ns, self._said_ns = HostSession(), 0, 0
        self._firmware, self._hear, self._deframer = firmware, hear, Deframer()
        self._answers: dict[int, Message] = {}

    def ask(self, question: Kind, payload: bytes = b"") -> Message:
        self.say(question, 0, payload)
        if (answer := self._answers.pop(ANSWERS[question], None)) is None:
            raise SilentBoardError(f"the board at {self.name} does not answer", about="board")
        return answer

    def say(self, kind: Kind, about: int = 0, payload: bytes = b"") -> None:
        self._said_ns = self.now_ns
        self._take(self._firmware.feed(self.session.encode(kind, about, payload), self.now_ns))

    def wait_until(self, end_ns: int, go_on: Callable[[], None]) -> None:
        """Let time pass, with heartbeats; ``go_on`` raises if the board is to be stopped."""
        while end_ns - self._said_ns > _BEAT_NS:
            go_on()
            self.now_ns = self._said_ns + _BEAT_NS
            self.say(Kind.HEARTBEAT)
        self.now_ns = end_ns
        self._take(self._firmware.advance(end_ns))

    def _take(self, data: bytes) -> None:
        for packet in self._deframer.feed(data):
            message = self.session.take(packet)
            if message is not None and message.kind in ANSWERS.values():
                self._answers[message.kind] = message
            elif message is not None:
                self._hear(message)


class SimulatedBoard(LinkHost):
    """Emulated ``link`` board in the same thread: ``simulated:``. Its firmware, its packets and its
    host are those of ``emulator:``, but time is simulated: a sequence begins when its time stamp
    says, or at the end of the one before, and is over as soon as it has been computed."""

    simulated_time = True
    on_a_finger = False
    _line: _Line

    def __init__(
        self, rest: str, limits: SafetyLimits, output: Output | None = None, **_: Any
    ) -> None:
        super().__init__(limits, output)
        refuse_rest("simulated:", rest, BoardError)
        self._kind = "weighted" if output is None else output.kind
        self._power_up()

    def _time(self) -> None:
        """Return None: time is what sequences state, as no finger is on this board."""

    def take_pulses(self) -> Pulses:
        """Return all pulses delivered since the last call."""
        return self._books.take()

    def _open(self) -> None:
        self._power_up()
        self._take_offer(self._line.ask(Kind.HELLO))
        self._line.ask(Kind.BEGIN)
        self._set_up()
        # Until it tells the finger's force.
        self._wait_until(protocol.ALIVE_MS * 1_000_000)

    def _power_up(self) -> None:
        self._books = _KeptBooks(self._gate.limits.electrodes)
        self._firmware = LinkFirmware(
            self._books.electrodes, self._kind, self._books, ramp_ms=second.RAMP_MS
        )
        self._line = _Line(self._firmware, self._hear)
        self._number, self._suspicion = 0, ""
        self._stamp_ns = self._ahead_ns = 0
        """Time stamp of the last sequence, and by how much such stamps are ahead of time here."""

    def _wait_until(self, end_ns: int) -> None:
        self._line.wait_until(end_ns, self._go_on_unless_stopped)

    def _send(self, sequence: ScanSequence, times: int) -> int:
        line, self._number = self._line, self._number + 1
        payload = self._encoded(sequence, times)
        self._wait_until(self._start_ns(sequence.time_ns))
        self._note_sent(sequence, times)
        line.say(Kind.SEQUENCE, self._number, payload)
        self._wait_until(line.now_ns + sequence.period_us * times * 1000)
        if self._suspicion:
            raise self._latch(self._suspicion)
        return self._number

    def _start_ns(self, stamp_ns: int) -> int:
        """Return when a sequence with a time stamp begins."""
        now_ns, before_ns, self._stamp_ns = self._line.now_ns, self._stamp_ns, stamp_ns
        if self._number == 1 or stamp_ns < before_ns:
            # Stamps have begun anew, as they may.
            self._ahead_ns = stamp_ns - now_ns
        gap_ns = stamp_ns - self._ahead_ns - now_ns
        self._ahead_ns += max(0, gap_ns - _LONGEST_GAP_NS)
        return now_ns + min(max(0, gap_ns), _LONGEST_GAP_NS)

    def _hear(self, message: Message) -> None:
        match message.kind:
            case Kind.ACK:
                self.acknowledged += 1
            case Kind.NAK:
                self.refused += 1
                self._unsafe_refused += 1
                _, _, words = reason_of(message)
                raise BoardError(
                    f"the simulated board refused sequence {message.about}: {words}", about="board"
                )
            case _:
                super()._hear(message)

    def _stop(self) -> None:
        # A stop from another thread waits for the end of the sequence.
        with self._writing:
            self._line.say(Kind.STOP)
