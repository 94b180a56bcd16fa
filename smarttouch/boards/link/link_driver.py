"""Driver of boards that implement our own protocol over a serial line."""

import contextlib
from collections import deque
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    EmergencyStopError,
    LineLostError,
    OtherDeviceError,
    SequenceLateError,
)
from smarttouch.base.wire.framing import LARGEST_PACKET
from smarttouch.boards import link as protocol
from smarttouch.boards.driver import Driver
from smarttouch.boards.line import Line
from smarttouch.boards.link import Message, MessageKind, Refusal, Rule, decode_volts, digest_of
from smarttouch.boards.link.sequence_encoding import (
    KernelImage,
    ScanPart,
    encode_limits,
    encode_scan,
)
from smarttouch.boards.link.session import (
    HEARTBEAT_S,
    PAUSED_S,
    LinkSession,
    capabilities_of,
    malformed,
    reason_of,
)
from smarttouch.boards.reports import BoardReport, Capabilities, SequenceStart
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable

AGAIN_S = 0.04
"""Time after which a sequence without an ACK is sent again, unless it is too late for it."""
AFTER_ZERO_S = 0.02
"""Time after a stop in which the board's count of slots must stand still: a period at 50 Hz."""
OLD_PACKETS = slice(8, 10)
"""Places of packets refused as old and as of another session in a board's account."""
MOST_COMPLIANCES = 2.1
"""Bound of a slot's voltage: sources of both poles at their limit reach twice the compliance."""
OPEN_SHARE = 0.97
"""Part of the compliance: if every slot reaches it, nothing touches the electrodes."""
OVERHEAD = protocol.WHOLE_HEAD_BYTES + 4  # bytes of a packet beside its payload
_PIECE = 1024  # bytes of kernels at once: nothing else can pass while they do
_IDLE = 3  # times that nothing new may have been kept


class SentPart(NamedTuple):
    """Sequence on its way, or the part of one that a packet has room for."""

    number: int
    proved: ProvedSequence
    part: ScanPart
    sent_ns: int


class LinkDriver(Driver):
    """Driver of a board at the far end of a serial line: ``link:PORT``, a device or any URL that
    pyserial knows."""

    keeps_kernels: ClassVar[bool] = True
    reports_delivery: ClassVar[bool] = True
    reports_starts: ClassVar[bool] = True
    _line: Line
    idle_s: ClassVar[float] = HEARTBEAT_S / 4

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        if not port:
            raise BoardError("link: needs a port, for example link:/dev/ttyACM0")
        self.port = port
        self._session: LinkSession = LinkSession(self._receive)
        self._flight: SentPart | None = None  # without an answer: the board has room for one
        self._repeated: deque[int] = deque(maxlen=64)
        """Sequences sent more than once: they may be answered more than once."""
        self._again_s = 0.0
        self._output = output
        self._limits = limits
        self.can: Capabilities | None = None  # of the board, once it has been asked
        self._number = 0
        self._account: tuple[Any, ...] | None = None
        """Account of the board at zero, since it was stopped."""
        self._account_before: tuple[Any, ...] = ()
        """Account of the board when it was opened, or opened again after its line was lost."""
        self._refused_before = 0  # packets that it had refused when it was opened
        self._slots_sent = 0  # slots sent since then, repetitions included
        self._unsafe_refused = 0
        """Sequences refused as unsafe since then, and those sent again: they may count twice."""
        self._suspicion = ""  # fault found in what the board says, until the board is latched
        self._table: KernelTable | None = None
        self._image: KernelImage | None = None
        self._sent: dict[int, SentPart] = {}  # the last of them, by their numbers
        self._volts: list[NDArray[np.float32]] = []  # voltages of the parts of a scan so far

    # -- the driver's interface --------------------------------------------

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._line, self._limits = line, limits
        self._connect()
        self._flight = None
        self._suspicion = ""
        self._session.open(line)
        if not line.reopened:
            self._refused_before = 0
        self._session.begin(self._take_offer)
        limited = self._session.ask(MessageKind.LIMITS, encode_limits(self._limits))
        if limited.payload != b"\1":
            raise malformed(self._session.name)
        self._give_kernels()
        self._account_before, self._account = self._ask_account(), None
        self._slots_sent = self._unsafe_refused = 0
        if not line.reopened:
            self._refused_before = sum(self._account_before[OLD_PACKETS])
        assert self.can is not None
        return self.can

    def _connect(self) -> None:
        self._line.connect(str(self.port))

    def write(self, proved: ProvedSequence) -> None:
        can = self.can
        assert can is not None
        room = (can.packet_bytes or LARGEST_PACKET) - OVERHEAD
        switched, image = can.output != "weighted", self._image
        for part in encode_scan(
            proved.sequence, proved.times, can.measures, switched, image, room, can.max_slots
        ):
            self._number += 1
            self._wait_for_room()
            self._send_part(proved, part)

    def zero(self) -> None:
        session = self._session
        with session.news:
            session.news.notify_all()
        if not session.is_open or not session.begun:
            return
        if session.fault is not None:
            session.stop_blindly()
            return
        try:
            session.ask(MessageKind.STOP)
            self._check_zero()
        except BoardError:
            # A lost board has been reported, or will be at the next send.
            if session.fault is None:
                raise

    def close(self) -> None:
        session = self._session
        if session.is_open and session.begun:
            # A board still in its session would refuse the next HELLO; after a stop this is barred.
            session.stop_blindly()
        session.close()

    def idle(self) -> float | None:
        """Send a lost packet again, and a heartbeat if one is due."""
        if self._session.fault is not None:
            return None
        if self._suspicion:
            fault = self._line.events.fault(self._suspicion)
            self._session.fail(fault)
            raise fault
        self._send_again()
        return self._session.beat()

    def is_busy(self) -> bool:
        return bool(self._ask_account()[7])

    def aftermath(self) -> str:
        if self.can is None:
            return ""
        return f"; it shorts all electrodes within {self.can.time_to_zero_ms:g} ms of silence"

    @property
    def refused_packets(self) -> int:
        """Number of packets from the board that were old, of another session, or not requested."""
        return self._session.refused

    # -- the session ---------------------------------------------------------

    def store_kernels(self, table: KernelTable) -> None:
        self._table = table
        self._give_kernels()

    def _give_kernels(self) -> None:
        """Give the board as many kernels as it has room for; the rest goes as currents."""
        can, self._image = self.can, None
        if self._table is None or can is None or not can.kernel_bytes or not can.packet_bytes:
            return
        image = KernelImage.of(self._table, can.kernel_bytes, can.most_kernels)
        piece = min(_PIECE, can.packet_bytes - OVERHEAD - protocol.KERNELS.size)
        at, furthest, data, idle = 0, 0, b"", 0
        # What it keeps already is not sent again; a board that keeps nothing is lost.
        while idle < _IDLE:
            head = protocol.KERNELS.pack(image.identity, len(image.data), at)
            answer = self._session.ask(MessageKind.KERNELS, head + data).payload
            if len(answer) != protocol.KEPT.size:
                raise malformed(self._session.name)
            identity, stored, whole, proof = protocol.KEPT.unpack(answer)
            if identity == image.identity and whole:
                if proof != digest_of(image.data, self._session.number):
                    raise self._line.events.fault(
                        f"the board at {self._session.name} holds other kernels than those sent"
                    )
                self._image = image
                return
            # The first query carries no kernels: its answer shows where to begin.
            stored = stored if identity == image.identity and stored < len(image.data) else 0
            idle = 0 if stored > furthest else idle + 1
            furthest = max(furthest, stored)
            at, data = stored, image.data[stored : stored + piece]
        # Its session may have ended, as after 100 ms in which the host was held up.
        raise LineLostError(
            f"the board at {self._session.name} does not keep the kernels that it is sent: check "
            "its firmware"
        )

    def _take_offer(self, answer: Message) -> None:
        """Take a board's capabilities if they fit the profile and, once its line was lost, those
        from before. A wrong board has received no more than HELLO."""
        name, known = self._session.name, self.can if self._line.reopened else None
        capabilities = capabilities_of(answer, name)
        if capabilities.emergency_switch and answer.state & protocol.SWITCH_OPEN:
            raise EmergencyStopError(
                f"the emergency switch of the board at {name} is open: close it, then begin again"
            )
        if known not in (None, capabilities):
            raise OtherDeviceError(f"the board at {name} now is another: only HELLO was sent to it")
        outputs, electrodes = capabilities.electrodes, self._limits.electrodes
        wanted = capabilities.output if self._output is None else self._output.kind
        if (outputs, capabilities.output) != (electrodes, wanted):
            raise BoardError(
                f"the board at {name} has {outputs} electrodes and is {capabilities.output}, the "
                f"profile needs {electrodes} and {wanted}: use the profile of this board"
            )
        self.can = capabilities

    def _ask_account(self) -> tuple[Any, ...]:
        """Return a REPORT: counts, mA and µC, in the order of `protocol.REPORT`."""
        answer = self._session.ask(MessageKind.STATUS)
        if len(answer.payload) != protocol.REPORT.size:
            raise malformed(self._session.name)
        fields = protocol.REPORT.unpack(answer.payload)
        strongest_ua, charge_pc, net_pc = fields[4:7]
        return (*fields[:4], strongest_ua / 1e3, charge_pc / 1e6, net_pc / 1e6, *fields[7:])

    def status(self) -> BoardReport:
        """Return the board's report; latch the board if that has what was not sent."""
        now, before, limits = self._account, self._account_before, self._limits
        if now is None:
            now = self._ask_account()
        violations, slots = now[3] - before[3], now[1] - before[1]
        largest_ma = limits.total_ua / 1000 if limits.one_source else limits.current_ua.max() / 1000
        fault = self._line.events.fault
        if violations > self._unsafe_refused:
            raise fault(
                f"the board counted {violations} violations of its own rules, and refused "
                f"{self._unsafe_refused} sequences for one"
            )
        if slots > self._slots_sent:
            raise fault(f"the board delivered {slots} slots where {self._slots_sent} were sent")
        if now[4] > max(before[4], largest_ma):
            raise fault(
                f"the board delivered {now[4]:g} mA, above the {largest_ma:g} mA that may be sent"
            )
        refused = max(0, sum(now[OLD_PACKETS]) - self._refused_before)
        return BoardReport(*(*now[:7], refused))

    # -- sequences ---------------------------------------------------------

    def _send_part(self, proved: ProvedSequence, part: ScanPart) -> None:
        """Send a sequence, or a part of one, which is due when the part before has begun."""
        session, now_ns = self._session, self._session.now_ns()
        if part.first:
            proved = self._line.later(proved, max(proved.due_ns, now_ns))
        with session.news:
            self._flight = SentPart(self._number, proved, part, now_ns)
            self._sent[self._number] = self._flight
            self._sent.pop(self._number - 4, None)
            self._slots_sent += part.slots * proved.times
            self._again_s = session.now_s() + AGAIN_S
        try:
            session.send(MessageKind.SEQUENCE, self._number, part.payload, proved=proved)
        except SequenceLateError:
            self._flight = None
            raise

    def _wait_for_room(self) -> None:
        session, line = self._session, self._line

        def is_over() -> bool:
            return self._flight is None or session.fault is not None or line.is_stopped

        with session.news:
            if not session.wait(is_over, session.answer_s) and self._flight is not None:
                number = self._flight.number
                what = f"has not acknowledged sequence {number} within {session.answer_s:g} s"
                raise line.lost(what)
            session.raise_fault()
            line.require_running()

    def _send_again(self) -> None:
        """Send a sequence without an ACK once more, unless it is too late for it.

        It has the same number: the board recognizes it if only the ACK was lost.
        """
        session = self._session
        # Nothing newer can go out between the look and the write.
        with self._line.current():
            with session.news:
                now_s, flight = session.now_s(), self._flight
                if flight is None or now_s < self._again_s:
                    return
                self._again_s = now_s + AGAIN_S
                self._repeated.append(flight.number)
                self._unsafe_refused += 1
            # If it is late, the next sequence reports that the board is lost.
            with contextlib.suppress(SequenceLateError):
                payload, proved = flight.part.payload, flight.proved
                session.send(MessageKind.SEQUENCE, flight.number, payload, proved=proved)

    def _check_zero(self) -> None:
        """Latch the board if it delivers slots after it has confirmed a stop; keep its account."""
        try:
            slots = self._ask_account()[1]
            with self._session.news:
                self._session.wait(lambda: False, AFTER_ZERO_S)
            self._account = self._ask_account()
        except BoardError:
            # It has confirmed zero; what has become of the line since then changes nothing.
            return
        if self._account[1] != slots:
            raise self._line.events.fault("the board delivered pulses after it had confirmed zero")

    # -- packets of the board ----------------------------------------------

    def _receive(self, message: Message) -> None:
        """Handle an unrequested packet."""
        can = self.can
        if can is not None and can.emergency_switch and message.state & protocol.SWITCH_OPEN:
            self._session.fail(self._emergency())
        match message.kind:
            case MessageKind.ACK if len(message.payload) == protocol.ACK.size:
                if sent := self._answered(message):
                    (board_us,) = protocol.ACK.unpack(message.payload)
                    session = self._session
                    time_ns = session.start_ns(board_us, sent.sent_ns, session.now_ns())
                    if not sent.part.first:
                        start = SequenceStart(sent.proved.number, time_ns, board_us)
                        self._line.events.started(start)
            case MessageKind.NAK:
                self._refused(message)
            case MessageKind.ALIVE:
                if can is not None and can.force and len(message.payload) == protocol.ALIVE.size:
                    (force_mn,) = protocol.ALIVE.unpack(message.payload)
                    self._line.events.force(force_mn / 1000)
            case MessageKind.VOLTAGES:
                self._note_volts(message)
            case _:
                self._session.refuse()

    def _note_volts(self, message: Message) -> None:
        sent, can = self._sent.get(message.about), self.can
        if sent is None or can is None:
            return self._session.refuse()
        sequence, part = sent.proved.sequence, sent.part
        decoded = decode_volts(message.payload)
        if len(decoded) != part.slots or not len(decoded):
            return None
        self._volts = [*self._volts, decoded] if part.first else [decoded]
        volts = np.concatenate(self._volts)
        if len(volts) == sequence.slots == part.first + part.slots:
            compliance = can.compliance_v
            if compliance is not None and volts.max() > MOST_COMPLIANCES * compliance:
                self._suspicion = (
                    f"the board measured {volts.max():.0f} V with a source of {compliance:g} V"
                )
            self._line.events.volts(sequence, volts)
            lifted = compliance is not None and bool((volts >= OPEN_SHARE * compliance).all())
            self._line.events.lift(lifted)
        return None

    def _answered(self, message: Message) -> SentPart | None:
        """Return the sequence on its way if a packet answers it; count a packet that answers
        none."""
        flight = self._flight
        if flight is not None and flight.number == message.about:
            self._flight = None
            return flight
        if message.about not in self._repeated:
            self._session.refuse()
        return None

    def _emergency(self) -> EmergencyStopError:
        return EmergencyStopError(
            f"the emergency switch of the board at {self._session.name} was opened: all electrodes "
            "are at zero; close it, then begin again"
        )

    def _refused(self, message: Message) -> None:
        why, rule, words = reason_of(message)
        session = self._session
        if why == Refusal.EMERGENCY:
            session.fail(self._emergency())
            return
        if why in (Refusal.GARBLED, Refusal.OLD, Refusal.FOREIGN):
            # Our own part of it is sent again; REPORT counts the rest.
            return
        if self._answered(message) is None:
            return
        self._line.events.refused()
        if why in (Refusal.UNSAFE, Refusal.MALFORMED):
            self._unsafe_refused += 1
            # Clocks differ: what rose too fast for the board's restarts at zero.
            lost = self._line.lost(f"refused sequence {message.about} as unsafe: {words}")
            session.fail(lost if rule == Rule.RISE else BoardError(str(lost)))
        elif why == Refusal.STOPPED and not self._line.is_stopped:
            lost = self._line.lost("has been stopped or restarted by another program")
            session.fail(BoardError(str(lost)))
        elif why == Refusal.SILENCE:
            slow = session.now_s() - session.paused_at_s < PAUSED_S
            cause = "this computer was too slow" if slow else "check the cable"
            silence = f"received nothing for {protocol.SILENCE_MS} ms ({cause})"
            session.fail(self._line.lost(silence))
