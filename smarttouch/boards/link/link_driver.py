"""Driver of boards that implement our own protocol over a serial line."""

import contextlib
from collections import deque
from typing import ClassVar, Protocol

from smarttouch.base.errors import (
    BoardError,
    EmergencyStopError,
    SequenceLateError,
)
from smarttouch.boards.line import Line
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.link_host import OLD_PACKETS, LinkHost, SentPart, reason_of
from smarttouch.boards.link.packet_line import HEARTBEAT_S, PAUSED_S, PacketLine
from smarttouch.boards.link.protocol import Message, MessageKind, Refusal, Rule
from smarttouch.boards.link.sequence_encoding import ScanPart
from smarttouch.boards.reports import Capabilities
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits

AGAIN_S = 0.04
"""Time after which a sequence without an ACK is sent again, unless it is too late for it."""
AFTER_ZERO_S = 0.02
"""Time after a stop in which the board's count of slots must stand still: a period at 50 Hz."""


class PortProcess(Protocol):
    """Process that emulates a board, on a port of its own."""

    def start(self, line: Line) -> str:
        """Return the name of the port; of the same process if the line was only lost."""
        ...

    def end(self) -> None: ...


class LinkDriver(LinkHost):
    """Driver of a board at the far end of a serial line: ``link:PORT``, a device or any URL that
    pyserial knows; ``process`` emulates the board where there is none."""

    idle_s: ClassVar[float] = HEARTBEAT_S / 4

    def __init__(
        self,
        port: str,
        limits: SafetyLimits,
        output: Output | None = None,
        *,
        process: PortProcess | None = None,
    ) -> None:
        super().__init__(limits, output)
        if not port and process is None:
            raise BoardError("link: needs a port, for example link:/dev/ttyACM0")
        self.port = port or None
        self.process = process
        self._packets: PacketLine = PacketLine(self._receive)
        self._flight: SentPart | None = None  # without an answer: the board has room for one
        self._repeated: deque[int] = deque(maxlen=64)
        """Sequences sent more than once: they may be answered more than once."""
        self._again_s = 0.0

    def answer_within(self, seconds: float) -> None:
        """Set the longest wait for an answer, and the longest silence of the board."""
        self._packets.answer_s = self._packets.silence_s = seconds

    # -- the driver's interface --------------------------------------------

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._line, self._limits = line, limits
        line.connect(self.process.start(line) if self.process is not None else str(self.port))
        self._flight = None
        self._suspicion = ""
        self._packets.open(line)
        if not line.reopened:
            self._packets_before = 0
        self._packets.begin(self._take_offer)
        self._set_up()
        if not line.reopened:
            self._packets_before = sum(self._account_before[OLD_PACKETS])
        return self.can

    def write(self, proved: ProvedSequence) -> None:
        for part in self._encoded(proved):
            self._number += 1
            self._wait_for_room()
            self._send_part(proved, part)

    def zero(self) -> None:
        packets = self._packets
        with packets.news:
            packets.news.notify_all()
        if not packets.is_open or not packets.session.begun:
            return
        if packets.fault is not None:
            packets.stop_blindly()
            return
        try:
            packets.ask(MessageKind.STOP)
            self._check_zero()
        except BoardError:
            # A lost board has been reported, or will be at the next send.
            if packets.fault is None:
                raise

    def close(self) -> None:
        packets = self._packets
        if packets.is_open and packets.session.begun:
            # A board still in its session would refuse the next HELLO; after a stop this is barred.
            packets.stop_blindly()
        packets.close()
        if self.process is not None and not self._line.reopened:
            self._line.disconnect()
            self.process.end()

    def idle(self) -> float | None:
        """Send a lost packet again, and a heartbeat if one is due."""
        if self._packets.fault is not None:
            return None
        if self._suspicion:
            fault = self._line.events.fault(self._suspicion)
            self._packets.fail(fault)
            raise fault
        self._send_again()
        return self._packets.beat()

    def is_busy(self) -> bool:
        return bool(self._ask_account()[7])

    def aftermath(self) -> str:
        if self._can is None:
            return ""
        return f"; it shorts all electrodes within {self._can.time_to_zero_ms:g} ms of silence"

    @property
    def refused_packets(self) -> int:
        """Number of packets from the board that were old, of another session, or not requested."""
        return self._packets.refused

    # -- sequences ---------------------------------------------------------

    def _send_part(self, proved: ProvedSequence, part: ScanPart) -> None:
        """Send a sequence, or a part of one, which is due when the part before has begun."""
        packets, now_ns = self._packets, self._line.now_ns()
        if part.first:
            proved = self._line.later(proved, max(proved.due_ns, now_ns))
        with packets.news:
            self._flight = self._note_sent(proved, part, now_ns)
            self._again_s = packets.now_s() + AGAIN_S
        try:
            packets.send(MessageKind.SEQUENCE, self._number, part.payload, proved=proved)
        except SequenceLateError:
            self._flight = None
            raise

    def _wait_for_room(self) -> None:
        packets, line = self._packets, self._line

        def is_over() -> bool:
            return self._flight is None or packets.fault is not None or line.is_stopped

        with packets.news:
            if not packets.wait(is_over, packets.answer_s) and self._flight is not None:
                number = self._flight.number
                what = f"has not acknowledged sequence {number} within {packets.answer_s:g} s"
                raise line.lost(what)
            packets.raise_fault()
            line.require_running()

    def _send_again(self) -> None:
        """Send a sequence without an ACK once more, unless it is too late for it.

        It has the same number: the board recognizes it if only the ACK was lost.
        """
        packets = self._packets
        # Nothing newer can go out between the look and the write.
        with self._line.current():
            with packets.news:
                now_s, flight = packets.now_s(), self._flight
                if flight is None or now_s < self._again_s:
                    return
                self._again_s = now_s + AGAIN_S
                self._repeated.append(flight.number)
                self._unsafe_refused += 1
            # If it is late, the next sequence reports that the board is lost.
            with contextlib.suppress(SequenceLateError):
                payload, proved = flight.part.payload, flight.proved
                packets.send(MessageKind.SEQUENCE, flight.number, payload, proved=proved)

    def _check_zero(self) -> None:
        """Latch the board if it delivers slots after it has confirmed a stop; keep its account."""
        try:
            slots = self._ask_account()[1]
            with self._packets.news:
                self._packets.wait(lambda: False, AFTER_ZERO_S)
            self._account = self._ask_account()
        except BoardError:
            # It has confirmed zero; what has become of the line since then changes nothing.
            return
        if self._account[1] != slots:
            raise self._line.events.fault("the board delivered pulses after it had confirmed zero")

    # -- packets of the board ----------------------------------------------

    def _receive(self, message: Message) -> None:
        """Handle an unrequested packet."""
        has_switch = self._can is not None and self._can.emergency_switch
        if message.state & protocol.SWITCH_OPEN and has_switch:
            self._packets.fail(self._emergency())
        match message.kind:
            case MessageKind.ACK if len(message.payload) == protocol.ACK.size:
                if self._is_first_answer(message):
                    self._note_start(message, self._line.now_ns())
            case MessageKind.NAK:
                self._refused(message)
            case _:
                super()._receive(message)

    def _is_first_answer(self, message: Message) -> bool:
        """Return whether a packet answers the sequence on its way; count it if it answers none."""
        if self._flight is not None and self._flight.number == message.about:
            self._flight = None
            return True
        if message.about not in self._repeated:
            self._packets.session.refuse()
        return False

    def _emergency(self) -> EmergencyStopError:
        return EmergencyStopError(
            f"the emergency switch of the board at {self._packets.name} was opened: all electrodes "
            "are at zero; close it, then begin again"
        )

    def _refused(self, message: Message) -> None:
        why, rule, words = reason_of(message)
        packets = self._packets
        if why == Refusal.EMERGENCY:
            packets.fail(self._emergency())
            return
        if why in (Refusal.GARBLED, Refusal.OLD, Refusal.FOREIGN):
            # Our own part of it is sent again; REPORT counts the rest.
            return
        if not self._is_first_answer(message):
            return
        self._line.events.refused()
        if why in (Refusal.UNSAFE, Refusal.MALFORMED):
            self._unsafe_refused += 1
            # Clocks differ: what rose too fast for the board's restarts at zero.
            fault = self._line.lost if rule == Rule.RISE else packets.gone
            packets.fail(fault(f"refused sequence {message.about} as unsafe: {words}"))
        elif why == Refusal.STOPPED and not self._line.is_stopped:
            packets.fail(packets.gone("has been stopped or restarted by another program"))
        elif why == Refusal.SILENCE:
            slow = packets.now_s() - packets.paused_at_s < PAUSED_S
            cause = "this computer was too slow" if slow else "check the cable"
            silence = f"received nothing for {protocol.SILENCE_MS} ms ({cause})"
            packets.fail(self._line.lost(silence))
