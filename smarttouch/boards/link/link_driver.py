"""Driver of ``link`` boards, and its sessions."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    EmergencyStopError,
    LineLostError,
    OtherDeviceError,
    SequenceLateError,
    SilentBoardError,
)
from smarttouch.base.posix import prioritized
from smarttouch.base.wire.framing import Deframer
from smarttouch.boards import link as protocol
from smarttouch.boards.driver import Driver, Line
from smarttouch.boards.link import HALF, VERSION, Feature, Message, MessageKind, Refusal, Rule
from smarttouch.boards.link import sequence_encoding as encoding
from smarttouch.boards.reports import BoardReport, Capabilities
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable

HEARTBEAT_S = 0.03  # longest time without a packet of the host; the board's timeout is 0.1 s
SILENCE_S = 0.5  # silence after which a board is lost: in a session, boards send every 20 ms
LISTENED_S = 0.1  # one read counts as at most this silence: if it took longer, this computer paused
ANSWER_S = 1.0
ASKED_AGAIN_S = 0.25  # time after which a query is sent again
PAUSED_S = 1.0  # for this time after a pause of this computer, its silence is explained by it
LAST_NUMBER = 2**32 - 1
AGAIN_S = 0.04  # time after which a sequence without an ACK is sent again
AFTER_ZERO_S = 0.02  # time after a confirmed stop in which no slot may follow: one period at 50 Hz
MOST_COMPLIANCES = 2.1  # largest valid ratio of slot voltage to compliance; two sources can reach 2
OPEN_SHARE = 0.97  # if all voltages reach this share of the compliance, the finger is lifted
_PIECE = 1024  # bytes of kernels per packet; longer packets would block the line too long
_IDLE = 3  # give up storing kernels after this number of successive packets without progress
_COUNTED = "sequences", "slots", "pulses", "violations", "refused_packets"


class LinkSession:
    """Session with a board. Each `open` starts a new session, which begins with HELLO. A fault is
    stored, and the next call raises the fault.

    Parameters
    ----------
    receive : callable
        Called with each packet that is not an answer. The lock `news` is held during the call.
    draw : callable
        Returns the host's half of a new session number.
    """

    line: Line
    now_s: Callable[[], float] = staticmethod(time.monotonic)  # clock that measures timeouts
    now_ns: Callable[[], int]  # clock by which sequences are planned
    put: Callable[[bytes, ProvedSequence | None], None]  # writes a packet, like `Line.write`

    def __init__(
        self, receive: Callable[[Message], None], draw: Callable[[], int] = protocol.draw_half
    ) -> None:
        self.answer_s: float = ANSWER_S  # longest wait for an answer
        self.silence_s: float = SILENCE_S  # longest silence of the board in a session
        self.refused: int = 0  # packets of the board that were refused, in all sessions
        self.news: threading.Condition = threading.Condition()
        self.paused_at_s: float = -PAUSED_S  # time of the last write that followed a pause
        self._receive, self._draw = receive, draw
        self._closed = threading.Event()
        self._reader: threading.Thread | None = None
        self._restart()

    def _restart(self) -> None:
        self.number: int = self._draw()  # session number; upper half 0 until HELLO is answered
        self.begun: bool = False  # whether the board has answered BEGIN
        self.sent: int = 0  # number of the last packet sent
        self.fault: BoardError | None = None
        self._taken = self._offered = 0
        self._asked: dict[int, MessageKind] = {}  # pending queries by number
        self._answers: dict[int, Message] = {}
        self._deframer = Deframer()
        self._ahead_ns: deque[int] = deque(maxlen=16)  # recent clock offsets to the board

    def open(self, line: Line) -> None:
        """Begin a new session on a connected line, and start to read."""
        self.line, self.now_ns, self.put = line, line.now_ns, line.write
        self._restart()
        self._closed.clear()
        self.written_s: float = self.now_s()  # time of the last written packet
        self._listen()

    def _listen(self) -> None:
        self._reader = threading.Thread(target=self._read_all, name="board reader", daemon=True)
        self._reader.start()

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition; return whether it is true. The caller holds the lock `news`."""
        return self.news.wait_for(condition, timeout_s)

    def close(self) -> None:
        """End the thread that reads."""
        self.begun = False
        self._closed.set()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join(ANSWER_S)

    # -- queries -----------------------------------------------------------

    def begin(self, accept: Callable[[Message], None]) -> None:
        """Begin a session with a board. ``accept`` receives the board's CAPABILITIES packet,
        whatever its version, and raises an error to reject the board."""
        deadline_s = self.now_s() + self.answer_s
        while True:
            accept(self.ask(MessageKind.HELLO))
            try:
                if not self.begun:
                    self.ask(MessageKind.BEGIN, within_s=ASKED_AGAIN_S)
                return
            except SilentBoardError:
                # The board may have a new challenge, for example after a restart: send HELLO again.
                if self.now_s() >= deadline_s:
                    raise

    def ask(
        self, question: MessageKind, payload: bytes = b"", within_s: float | None = None
    ) -> Message:
        """Send a query until it is answered, and return the answer. Raises SilentBoardError after
        ``within_s``, by default `answer_s`."""
        kind, first = protocol.ANSWERS[question], self.sent + 1
        deadline_s = self.now_s() + (self.answer_s if within_s is None else within_s)

        def answer() -> Message | None:
            reply = self._answers.get(kind)
            # A board with another protocol version may answer without the number of the query.
            return reply if reply and (reply.about >= first or reply.version != VERSION) else None

        def is_over() -> bool:
            return bool(self.fault or answer() or self.line.is_stopped)

        while self.now_s() < deadline_s:
            self.send(question, payload=payload)
            with self.news:
                # Wait in short steps: a stop while the board opens does not wake this thread.
                any(self.wait(is_over, ASKED_AGAIN_S / 5) for _ in range(5))
                if self.fault is not None:
                    raise self.fault
                self.line.require_running()
                if reply := answer():
                    return reply
        raise SilentBoardError(
            f"the board at {self.line.name} does not answer: check that it is on and speaks link "
            f"version {VERSION}"
        )

    # -- packets of the host -------------------------------------------------

    def encode(self, kind: MessageKind, about: int = 0, payload: bytes = b"") -> bytes:
        """Encode the host's next packet."""
        if self.sent == LAST_NUMBER:
            raise LineLostError(f"the session is over after {LAST_NUMBER} packets")
        self.sent += 1
        if kind in protocol.ANSWERS:
            self._asked[self.sent] = protocol.ANSWERS[kind]
        session = self.number & HALF if kind == MessageKind.HELLO else self.number
        return protocol.encode(Message(kind, self.sent, session, self._taken, about, payload))

    def send(
        self,
        kind: MessageKind,
        about: int = 0,
        payload: bytes = b"",
        *,
        proved: ProvedSequence | None = None,
    ) -> None:
        """Write the next packet of the session. For ``proved`` see `Line.write`."""
        try:
            # Number packets under the lock, so that they are sent in order.
            with self.line.current():
                # A leading zero ends an incomplete packet on the line.
                zero = b"\0" * (proved is None)
                self.put(zero + self.encode(kind, about, payload), proved)
        except LineLostError as lost:
            self.fail(lost)
            raise self.fault or lost from None
        before_s, self.written_s = self.written_s, self.now_s()
        if self.written_s - before_s > protocol.SILENCE_MS / 1000:
            self.paused_at_s = self.written_s

    def fail(self, fault: BoardError) -> None:
        """Store a fault for the next call to raise. Keep an earlier fault."""
        with self.news:
            self.fault = self.fault or fault
            self.news.notify_all()

    # -- packets of the board --------------------------------------------------

    @prioritized()
    def _read_all(self) -> None:
        silent_s, now_s = 0.0, self.now_s()
        while not self._closed.is_set():
            try:
                data = self.line.read_some()
            except BoardError as error:
                if not self._closed.is_set():
                    self.fail(error)
                return
            before_s, now_s = now_s, self.now_s()
            silent_s += min(now_s - before_s, LISTENED_S)
            # Before a session silence is normal, because boards only answer queries.
            if self.take(data) or not self.begun:
                silent_s = 0.0
            if silent_s > self.silence_s:
                self.fail(self.line.lost(f"has been silent for {self.silence_s:g} s"))
                return

    def take(self, data: bytes) -> list[Message]:
        """Process bytes from the board, and return the packets of the session. Old packets, packets
        of other sessions and unrequested answers are only counted."""
        taken = []
        for message in map(protocol.decode, self._deframer.feed(data)):
            kind, is_answer = message.kind, message.kind in protocol.ANSWERS.values()
            with self.news:
                if kind == MessageKind.CAPABILITIES:
                    accepted = self._accept_offer(message)
                else:
                    accepted = (message.session, message.version) == (self.number, VERSION)
                    accepted = accepted and message.number > self._taken
                    if accepted:
                        self._taken = message.number
                        accepted = not is_answer or self._asked.pop(message.about, None) == kind
                if not accepted:
                    self.refuse()
                    continue
                taken.append(message)
                self.begun |= kind == MessageKind.BEGUN
                if is_answer:
                    self._answers[kind] = message
                else:
                    self._receive(message)
                self.news.notify_all()
        return taken

    def refuse(self) -> None:
        """Count a refused packet. Before CAPABILITIES, ignore it: it may be from an earlier run."""
        self.refused += self.number > HALF

    def _accept_offer(self, offer: Message) -> bool:
        if offer.version != VERSION:
            # Take a packet of another protocol version, so that `begin` can report the version.
            return not self.begun
        was_asked = self._asked.pop(offer.about, None) == offer.kind
        if offer.session & HALF != self.number & HALF or not was_asked:
            return False
        if self.begun or offer.about < self._offered:
            return offer.session == self.number
        self.number, self._offered = offer.session, offer.about
        return True

    def start_ns(self, board_us: int, sent_ns: int, now_ns: int) -> int:
        """Return the start of a sequence by the host's clock, ns. ``board_us`` is the start by the
        board's clock, ``sent_ns`` the time of sending, ``now_ns`` the time of the answer. The
        offset between the clocks comes from the fastest of the last 16 answers."""
        if self._ahead_ns and 1000 * board_us + min(self._ahead_ns) < sent_ns:
            # The old clock offset puts the start before the sending: the board's clock has paused.
            self._ahead_ns.clear()
        self._ahead_ns.append(now_ns - 1000 * board_us)
        return 1000 * board_us + min(self._ahead_ns)


class SentPart(NamedTuple):
    """Sequence that was sent, or a part of one if the board needs parts."""

    number: int
    proved: ProvedSequence
    part: encoding.ScanPart
    sent_ns: int


class LinkDriver(Driver):
    """Driver of a board at ``link:PORT``; PORT is a serial device or a URL of pyserial."""

    keeps_kernels: ClassVar[bool] = True
    _line: Line

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        if not port:
            raise BoardError("link: needs a port, for example link:/dev/ttyACM0")
        self.port = port
        self._session: LinkSession = LinkSession(self._receive)
        self._flight: SentPart | None = None  # part sent and not answered yet
        self._again_s = 0.0
        self._output, self._limits = output, limits
        self.can: Capabilities | None = None  # known after CAPABILITIES
        self._number = 0
        self._last_report: BoardReport | None = None  # report after the stop
        self._report: BoardReport  # report at the last opening or reconnection
        self._first: BoardReport  # baseline of counts: report at the last opening or power-on
        self._slots_sent = 0  # slots sent since `_report`; each repetition counts
        self._unsafe_refused = 0  # upper bound of the number of sequences refused as unsafe
        self._suspicion = ""  # fault seen in measured voltages: `idle` then stops the board
        self._table: KernelTable | None = None
        self._image: encoding.KernelImage | None = None
        self._sent: dict[int, SentPart] = {}  # recent parts by number
        self._volts: list[NDArray[np.float32]] = []  # voltages of earlier parts of a scan

    # -- the driver's interface --------------------------------------------

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._line, self._limits = line, limits
        self._connect()
        self._flight = None
        self._suspicion = ""
        self._session.open(line)
        self._session.begin(self._take_offer)
        limited = self._session.ask(MessageKind.LIMITS, encoding.encode_limits(self._limits))
        if limited.payload != b"\1":
            raise self._malformed()
        self._give_kernels()
        self._report, self._last_report = self._ask_report(), None
        self._slots_sent = self._unsafe_refused = 0
        # A board counts from power-on: a smaller count means that it was switched on again.
        if not line.reopened or self._report.sequences < self._first.sequences:
            self._first = self._report
        assert self.can is not None
        return self.can

    def _connect(self) -> None:
        self._line.connect(str(self.port))

    def write(self, proved: ProvedSequence) -> None:
        """Send a sequence, in parts if it exceeds the board's capacity. Each part is sent when the
        board has begun the previous part."""
        can, session, line = self.can, self._session, self._line
        assert can is not None
        for part in encoding.encode_scan(proved.sequence, proved.times, can, self._image):
            self._number += 1
            with session.news:
                # Wait for the previous ACK: the board can hold only one waiting sequence.
                if (flight := self._flight) is not None and not session.wait(
                    lambda: not self._flight or session.fault is not None or line.is_stopped,
                    session.answer_s,
                ):
                    unheard = f"acknowledged sequence {flight.number} within {session.answer_s:g} s"
                    raise line.lost(f"has not {unheard}")
                if session.fault is not None:
                    raise session.fault
                line.require_running()
                now_ns = session.now_ns()
                if part.first:
                    proved = line.later(proved, max(proved.due_ns, now_ns))
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

    def zero(self) -> None:
        """Stop the board; latch it if it delivers slots after confirming the stop."""
        session = self._session
        with session.news:
            session.news.notify_all()
        if not session.begun:
            return
        try:
            if session.fault is not None:
                # A failed line may still transmit the stop.
                session.send(MessageKind.STOP)
                return
            session.ask(MessageKind.STOP)
        except BoardError:
            # The next `send` raises a stored fault; raise only other errors here.
            if session.fault is None:
                raise
            return
        try:
            slots = self._ask_report().slots
            with session.news:
                session.wait(lambda: False, AFTER_ZERO_S)
            self._last_report = self._ask_report()
        except BoardError:
            # The board has confirmed zero, so the state of the line does not matter.
            return
        if self._last_report.slots != slots:
            raise self._line.fault("the board delivered pulses after it had confirmed zero")

    def close(self) -> None:
        session = self._session
        if session.begun:
            # End the session, because a board in a session refuses the next HELLO. After a stop
            # the session has already ended: then ignore the error of this write.
            with contextlib.suppress(BoardError):
                session.send(MessageKind.STOP)
        session.close()

    def idle(self) -> float | None:
        """Resend an unacknowledged sequence that is not late. Send a heartbeat if one is due."""
        session = self._session
        if session.fault is not None:
            raise session.fault
        if self._suspicion:
            fault = self._line.fault(self._suspicion)
            session.fail(fault)
            raise fault
        # Hold the lock, so that no newer packet is sent between check and write.
        with self._line.current(), session.news:
            now_s, flight = session.now_s(), self._flight
            if flight is not None and now_s >= self._again_s:
                self._again_s = now_s + AGAIN_S
                self._unsafe_refused += 1
                payload, proved = flight.part.payload, flight.proved
                # Keep the number: if only the ACK was lost, the board recognizes the repetition. If
                # the sequence is late, the next `write` reports the missing ACK.
                with contextlib.suppress(SequenceLateError):
                    session.send(MessageKind.SEQUENCE, flight.number, payload, proved=proved)
        if session.begun and now_s - session.written_s > HEARTBEAT_S:
            session.send(MessageKind.HEARTBEAT)
        # time until the next heartbeat is due
        return max(HEARTBEAT_S / 4, session.written_s + HEARTBEAT_S * 2 / 3 - now_s)

    # -- the session ---------------------------------------------------------

    def _take_offer(self, answer: Message) -> None:
        """Check and store a board's capabilities. They must fit the profile. After a lost
        connection, they must be unchanged. Before this check, a board receives only HELLO."""
        name, before = self._line.name, self.can if self._line.reopened else None
        if answer.version != VERSION:
            raise BoardError(
                f"the board at {name} speaks link version {answer.version}, but this program "
                f"speaks version {VERSION}: update the older one"
            )
        end = protocol.CAPABILITIES.size
        if len(answer.payload) < end:
            raise self._malformed()
        electrodes, kind, able, current_ua, slots, zero_ms, volts, room, packet, kernels = (
            protocol.CAPABILITIES.unpack_from(answer.payload)
        )
        if kind >= len(protocol.OUTPUTS):
            raise BoardError(f"the board at {name} has unknown output kind {kind}: check firmware")
        keeps = bool(able & Feature.KERNELS)
        can = Capabilities(
            electrodes=electrodes, output=protocol.OUTPUTS[kind], max_current_ma=current_ua / 1000,
            max_slots=slots, time_to_zero_ms=zero_ms,
            firmware=answer.payload[end:].decode("utf-8", "replace"),
            measures=bool(able & Feature.VOLTAGE), force=bool(able & Feature.FORCE),
            compliance_v=float(volts) or None,
            # A recharge phase needs a source for each electrode.
            recharges=bool(able & Feature.RECHARGE) and protocol.OUTPUTS[kind] == "weighted",
            emergency_switch=bool(able & Feature.EMERGENCY), kernel_bytes=keeps * room,
            most_kernels=keeps * kernels, packet_bytes=packet, acknowledges=True,
        )  # fmt: skip
        if can.emergency_switch and answer.state & protocol.SWITCH_OPEN:
            raise self._emergency()
        if before not in (None, can):
            raise OtherDeviceError(f"another board is at {name}: only HELLO was sent to it")
        wanted = can.output if self._output is None else self._output.kind
        if (electrodes, can.output) != (self._limits.electrodes, wanted):
            raise BoardError(
                f"the board at {name} has {electrodes} electrodes and is {can.output}, but the "
                f"profile needs {self._limits.electrodes} and {wanted}: use the profile of this "
                "board"
            )
        self.can = can

    def _malformed(self) -> BoardError:
        return BoardError(
            f"the board at {self._line.name} gives invalid answers: check its firmware"
        )

    def store_kernels(self, table: KernelTable) -> None:
        self._table = table
        self._give_kernels()

    def _give_kernels(self) -> None:
        """Store the kernels that fit on the board. Slots of other kernels are sent as currents."""
        can, self._image = self.can, None
        if self._table is None or can is None or not can.kernel_bytes or not can.packet_bytes:
            return
        image = encoding.KernelImage.of(self._table, can.kernel_bytes, can.most_kernels)
        piece = min(_PIECE, can.packet_bytes - encoding.OVERHEAD - protocol.KERNELS.size)
        at, furthest, data, idle = 0, 0, b"", 0
        # Send only kernels that the board lacks. A packet that adds no stored bytes counts as lost.
        while idle < _IDLE:
            head = protocol.KERNELS.pack(image.identity, len(image.data), at)
            answer = self._session.ask(MessageKind.KERNELS, head + data).payload
            if len(answer) != protocol.KEPT.size:
                raise self._malformed()
            identity, stored, whole, proof = protocol.KEPT.unpack(answer)
            if identity == image.identity and whole:
                if proof != protocol.digest_of(image.data, self._session.number):
                    raise self._line.fault(
                        f"the board at {self._line.name} stores kernels that differ from those sent"
                    )
                self._image = image
                return
            # The first packet contains no kernels. Its answer shows what the board has stored.
            stored = stored if identity == image.identity and stored < len(image.data) else 0
            idle = 0 if stored > furthest else idle + 1
            furthest = max(furthest, stored)
            at, data = stored, image.data[stored : stored + piece]
        # Perhaps the session has ended, for example because this program paused for 100 ms.
        raise LineLostError(
            f"the board at {self._line.name} does not store the kernels sent to it: check "
            "its firmware"
        )

    def _ask_report(self) -> BoardReport:
        """Query the board's REPORT. Packets that are old or of another session count as refused."""
        answer = self._session.ask(MessageKind.STATUS)
        if len(answer.payload) != protocol.REPORT.size:
            raise self._malformed()
        fields = protocol.REPORT.unpack(answer.payload)
        strongest_ua, charge_pc, net_pc, busy, old, foreign = fields[4:10]
        counted = *fields[:4], strongest_ua / 1e3, charge_pc / 1e6, net_pc / 1e6
        return replace(BoardReport(*counted), refused_packets=old + foreign, is_busy=bool(busy))

    def status(self) -> BoardReport:
        """Return the board's report. Latch the board if it reports more slots or unsafe sequences
        than this host sent, or a new maximum of current above the limits."""
        fault = self._session.fault
        if self._line.is_stopped and fault is not None and not isinstance(fault, LineLostError):
            raise fault
        now, before, limits = self._last_report or self._ask_report(), self._report, self._limits
        largest_ma = limits.total_ua / 1000 if limits.one_source else limits.current_ua.max() / 1000
        for reported, allowed, unit in (
            (now.violations - before.violations, self._unsafe_refused, "unsafe sequences"),
            (now.slots - before.slots, self._slots_sent, "slots"),
            (now.max_current_ma, max(before.max_current_ma, largest_ma), "mA"),
        ):
            if reported > allowed:
                raise self._line.fault(
                    f"the board reports {reported:g} {unit}, but at most {allowed:g} are possible"
                )
        first = self._first
        counted = {name: max(0, getattr(now, name) - getattr(first, name)) for name in _COUNTED}
        return replace(now, **counted, refused_by_host=self._session.refused)

    # -- packets of the board ----------------------------------------------

    def _receive(self, message: Message) -> None:
        """Handle a packet that is not an answer. The caller holds the session's lock `news`."""
        can, session, line, payload = self.can, self._session, self._line, message.payload
        if can is not None and can.emergency_switch and message.state & protocol.SWITCH_OPEN:
            session.fail(self._emergency())
        match message.kind:
            case MessageKind.ACK if len(payload) == protocol.ACK.size:
                sent = self._flight
                if sent is not None and sent.number == message.about:
                    self._flight = None
                    (board_us,) = protocol.ACK.unpack(payload)
                    time_ns = session.start_ns(board_us, sent.sent_ns, session.now_ns())
                    if not sent.part.first:
                        line.started(sent.proved, time_ns, board_us)
                else:
                    session.refuse()
            case MessageKind.NAK:
                self._refused(message)
            case MessageKind.ALIVE:
                if can is not None and can.force and len(payload) == protocol.ALIVE.size:
                    line.board.force_n = protocol.ALIVE.unpack(payload)[0] / 1000
            case MessageKind.VOLTAGES if message.about in self._sent:
                self._note_volts(self._sent[message.about], payload)
            case _:
                session.refuse()

    def _note_volts(self, sent: SentPart, payload: bytes) -> None:
        """Collect voltages, and report them when the last part of a scan has arrived. Ignore the
        last byte of an odd number of bytes."""
        sequence, part = sent.proved.sequence, sent.part
        counts = np.frombuffer(payload[: len(payload) // 2 * 2], "<u2")
        if len(counts) != part.slots or not len(counts):
            return
        self._volts = self._volts if part.first else []
        self._volts.append(np.asarray(counts / np.float32(protocol.VOLT), np.float32))
        volts = np.concatenate(self._volts)
        if len(volts) == len(sequence.site) == part.first + part.slots:
            assert self.can is not None
            highest_v = self.can.compliance_v or np.inf
            if volts.max() > MOST_COMPLIANCES * highest_v:
                self._suspicion = (
                    f"the board measured {volts.max():.0f} V, but its compliance is {highest_v:g} V"
                )
            lifted = bool((volts >= OPEN_SHARE * highest_v).all())
            self._line.measured(sequence, volts, lifted)

    def _emergency(self) -> EmergencyStopError:
        return EmergencyStopError(
            f"the emergency switch of the board at {self._line.name} is open: all electrodes "
            "are at zero; close the switch, then start again"
        )

    def _refused(self, message: Message) -> None:
        """Handle a NAK, by which the board refuses a packet."""
        session, line = self._session, self._line
        why, rule, words = _reason_of(message.payload)
        if why == Refusal.EMERGENCY:
            session.fail(self._emergency())
            return
        if why in (Refusal.GARBLED, Refusal.OLD, Refusal.FOREIGN):
            # Do nothing: a refused sequence or query is sent again; REPORT counts the refusal.
            return
        if self._flight is None or self._flight.number != message.about:
            session.refuse()
            return
        self._flight = None
        line.board.refused += 1
        if why in (Refusal.UNSAFE, Refusal.MALFORMED):
            self._unsafe_refused += 1
            # `Rule.RISE`: intensity would rise too fast, by the board's clock. Restart at 0.
            lost = line.lost(f"refused sequence {message.about} as unsafe: {words}")
            session.fail(lost if rule == Rule.RISE else BoardError(str(lost)))
        elif why == Refusal.STOPPED and not line.is_stopped:
            lost = line.lost("has been stopped or restarted by another program")
            session.fail(BoardError(str(lost)))
        elif why == Refusal.SILENCE:
            slow = session.now_s() - session.paused_at_s < PAUSED_S
            cause = "this computer was too slow" if slow else "check the cable"
            session.fail(line.lost(f"received nothing for {protocol.SILENCE_MS} ms ({cause})"))


def _reason_of(payload: bytes) -> tuple[int, int, str]:
    """Return reason, rule and text of a NAK."""
    if len(payload) != protocol.NAK.size:
        return 0, Rule.NONE, ""
    reason, rule, slot, electrode, value, allowed = protocol.NAK.unpack(payload)
    name = next((known.name.lower() for known in Rule if known == rule), "unknown")
    words = f"rule {rule} ({name})" if rule else "malformed"
    words += f": {value}, allowed {allowed}" if value or allowed else ""
    words += f", slot {slot}" if slot != protocol.NOTHING else ""
    words += f", electrode {electrode}" if electrode != protocol.NOTHING else ""
    return reason, rule, words
