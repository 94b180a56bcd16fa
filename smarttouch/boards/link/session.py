"""Session with a ``link`` board: its packets, a thread that reads them, and the board's clock."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable

from smarttouch.base.errors import BoardError, LineLostError, SilentBoardError
from smarttouch.base.posix import prioritized
from smarttouch.base.wire.framing import Deframer, WirePacket
from smarttouch.boards import link as protocol
from smarttouch.boards.line import Line
from smarttouch.boards.link import (
    ANSWERS,
    HALF,
    NOTHING,
    SILENCE_MS,
    VERSION,
    Feature,
    Message,
    MessageKind,
    Rule,
    decode,
    draw_half,
    encode,
)
from smarttouch.boards.reports import Capabilities
from smarttouch.stimulation.safety_gate import ProvedSequence

HEARTBEAT_S = 0.03  # longest silence of the host: the board gives up after 0.1 s
SILENCE_S = 0.5  # after which a board, which sends every 20 ms in a session, is gone
LISTENED_S = 0.1  # most silence counted for one read; the rest was a pause of ours
ANSWER_S = 1.0
AGAIN_S = 0.25  # time after which a query is sent again
PAUSED_S = 1.0  # time for which a pause of this computer explains what the board does
STOPPED_S = 0.05  # time in which a query sees that the board was stopped
LAST_NUMBER = 2**32 - 1


class LinkSession:
    """One session with a board, from before HELLO on; a fault is raised at the next call. Each
    `open` begins another one.

    Parameters
    ----------
    receive : callable
        Gets every packet that answers no query, with `news` held.
    draw : callable
        Returns the host's half of a session, a new one each time.
    """

    line: Line

    def __init__(
        self, receive: Callable[[Message], None], draw: Callable[[], int] = draw_half
    ) -> None:
        # Longest wait for an answer, and longest silence of the board in a session.
        self.answer_s: float = ANSWER_S
        self.silence_s: float = SILENCE_S
        self.refused: int = 0  # packets of the board, in all sessions
        self.news: threading.Condition = threading.Condition()
        self._receive, self._draw = receive, draw
        self._closed = threading.Event()
        self._closed.set()
        self.paused_at_s: float = -PAUSED_S  # when this computer last wrote after a long pause
        self._reader: threading.Thread | None = None
        self._restart()

    def _restart(self) -> None:
        self.number: int = self._draw()  # its upper half is 0 until the board has answered HELLO
        self.begun: bool = False  # whether the board has answered BEGIN
        self.sent: int = 0  # number of the last packet
        self.fault: BoardError | None = None
        self._taken = self._offered = 0
        self._asked: dict[int, MessageKind] = {}  # answers that are due, by the queries' numbers
        self._answers: dict[int, Message] = {}
        self._deframer = Deframer()
        self._ahead_ns: deque[int] = deque(maxlen=16)  # of the host's clock before the board's

    @property
    def name(self) -> str:
        """Name of the board's port."""
        return self.line.name

    @property
    def is_open(self) -> bool:
        """Whether a reader runs."""
        return not self._closed.is_set()

    def open(self, line: Line) -> None:
        """Start reading from a connected line."""
        self.line = line
        self._restart()
        self._closed.clear()
        self._last_written = self._last_packet = self.now_s()
        self._listen()

    def _listen(self) -> None:
        self._reader = threading.Thread(target=self._read_all, name="board reader", daemon=True)
        self._reader.start()

    def now_ns(self) -> int:
        """Return the time by which sequences are sent and answered."""
        return self.line.now_ns()

    def now_s(self) -> float:
        """Return the time by the clock of all timeouts here."""
        return time.monotonic()

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition, with `news` held; return whether it holds."""
        return self.news.wait_for(condition, timeout_s)

    def close(self) -> None:
        """End the reader."""
        self._closed.set()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join(ANSWER_S)

    # -- queries -----------------------------------------------------------

    def begin(self, accept: Callable[[Message], None]) -> None:
        """Begin a session with a board, unless ``accept`` raises on its CAPABILITIES, of any
        version."""
        deadline_s = self.now_s() + self.answer_s
        while True:
            accept(self.ask(MessageKind.HELLO))
            try:
                if not self.begun:
                    self.ask(MessageKind.BEGIN, within_s=AGAIN_S)
                return
            except SilentBoardError:
                # Another HELLO may have replaced what the board has offered.
                if self.now_s() >= deadline_s:
                    raise

    def ask(
        self, question: MessageKind, payload: bytes = b"", within_s: float | None = None
    ) -> Message:
        """Send a query until it is answered; raise SilentBoardError if it is not, within
        `answer_s` if no time is given."""
        kind, first, now_s = ANSWERS[question], self.sent + 1, self.now_s()
        deadline_s = now_s + (self.answer_s if within_s is None else within_s)

        def answered() -> bool:
            reply = self._answers.get(kind)
            # An answer of another version may name no query.
            return reply is not None and (reply.about >= first or reply.version != VERSION)

        def over() -> bool:
            return self.fault is not None or answered() or self.line.is_stopped

        while now_s < deadline_s:
            self.send(question, payload=payload)
            until_s = self.now_s() + AGAIN_S
            with self.news:
                # In short waits: a stop of a board that is being opened wakes nobody.
                while not self.wait(over, STOPPED_S) and self.now_s() < until_s:
                    pass
                self.raise_fault()
                self.line.require_running()
                if answered():
                    return self._answers.pop(kind)
            now_s = self.now_s()
        raise SilentBoardError(
            f"the board at {self.name} does not answer: check that it is on and speaks link "
            f"version {VERSION}"
        )

    # -- packets of the host -------------------------------------------------

    def encode(self, kind: MessageKind, about: int = 0, payload: bytes = b"") -> bytes:
        """Return the host's next packet."""
        if self.sent == LAST_NUMBER:
            raise LineLostError(f"the session of {LAST_NUMBER} packets is over")
        self.sent += 1
        if kind in ANSWERS:
            self._asked[self.sent] = ANSWERS[kind]
        session = self.number & HALF if kind == MessageKind.HELLO else self.number
        return encode(kind, session, self.sent, self._taken, about, payload)

    def send(
        self,
        kind: MessageKind,
        about: int = 0,
        payload: bytes = b"",
        *,
        proved: ProvedSequence | None = None,
    ) -> None:
        """Write the next packet of the session; one that delivers a sequence is refused as
        `Line.write` says."""
        try:
            # Numbered under the lock, so that packets leave in order.
            with self.line.current():
                self._put(self.encode(kind, about, payload), proved)
        except LineLostError as lost:
            self.fail(lost)
            self.raise_fault()
        now_s, before_s = self.now_s(), self._last_written
        self._last_written = now_s
        if now_s - before_s > SILENCE_MS / 1000:
            self.paused_at_s = now_s
        if kind is not MessageKind.HEARTBEAT:
            self._last_packet = now_s

    def _put(self, packet: bytes, proved: ProvedSequence | None) -> None:
        # A leading zero ends any half packet on the line.
        self.line.write(b"\0" * (proved is None) + packet, proved)

    def stop_blindly(self) -> None:
        """Write a STOP to a line that has failed, which may still carry it."""
        with contextlib.suppress(BoardError):
            self._put(self.encode(MessageKind.STOP), None)

    def fail(self, fault: BoardError) -> None:
        """Keep the first fault for the next call."""
        with self.news:
            self.fault = self.fault or fault
            self.news.notify_all()

    def raise_fault(self) -> None:
        if self.fault is not None:
            raise self.fault

    def beat(self) -> float:
        """Send a heartbeat if one is due; return the time to the next look, s."""
        now_s = self.now_s()
        if self.begun and now_s - self._last_written > HEARTBEAT_S:
            self.send(MessageKind.HEARTBEAT)
        # Nothing is due soon after a packet: a sequence is sent again after longer than that, too.
        return max(HEARTBEAT_S / 4, self._last_packet + HEARTBEAT_S * 2 / 3 - now_s)

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
            # Before a session a board sends nothing by itself.
            if self.take(data) or not self.begun:
                silent_s = 0.0
            if silent_s > self.silence_s:
                self.fail(self.line.lost(f"has been silent for {self.silence_s:g} s"))
                return

    def take(self, data: bytes) -> list[Message]:
        """Process bytes from the board; return the packets of the session among them."""
        taken = []
        for packet in self._deframer.feed(data):
            with self.news:
                if (message := self._accept(packet)) is None:
                    self.refuse()
                    continue
                taken.append(message)
                if message.kind in ANSWERS.values():
                    self._answers[message.kind] = message
                else:
                    self._receive(message)
                self.news.notify_all()
        return taken

    def refuse(self) -> None:
        """Count a refused packet; those before CAPABILITIES are of an earlier run."""
        self.refused += self.number > HALF

    def _accept(self, packet: WirePacket) -> Message | None:
        """Return a packet as a message, or None if it is old, of another session, or an answer to
        what was not asked."""
        message = decode(packet)
        if message.kind == MessageKind.CAPABILITIES:
            return message if self._accept_offer(message) else None
        if (
            message.session != self.number
            or message.number <= self._taken
            or message.version != VERSION
        ):
            return None
        self._taken = message.number
        if message.kind in ANSWERS.values() and not self._was_asked(message):
            return None
        self.begun |= message.kind == MessageKind.BEGUN
        return message

    def _accept_offer(self, offer: Message) -> bool:
        if offer.version != VERSION:
            # A board of another version is reported by its version.
            return not self.begun
        if offer.session & HALF != self.number & HALF or not self._was_asked(offer):
            return False
        if self.begun or offer.about < self._offered:
            return offer.session == self.number
        self.number, self._offered = offer.session, offer.about
        return True

    def _was_asked(self, answer: Message) -> bool:
        return self._asked.pop(answer.about, None) == answer.kind

    def start_ns(self, board_us: int, sent_ns: int, now_ns: int) -> int:
        """Return when a sequence began by the host's clock, by the answer that came fastest of the
        last few: it was sent at a time, began at one of the board's clock, and was answered now."""
        if self._ahead_ns and 1000 * board_us + min(self._ahead_ns) < sent_ns:
            # No sequence begins before it is sent: the board's clock has stood still.
            self._ahead_ns.clear()
        self._ahead_ns.append(now_ns - 1000 * board_us)
        return 1000 * board_us + min(self._ahead_ns)


def capabilities_of(answer: Message, name: str) -> Capabilities:
    """Return the capabilities in a CAPABILITIES of any version."""
    if answer.version != VERSION:
        raise BoardError(
            f"the board at {name} speaks link version {answer.version}, this program {VERSION}: "
            "bring both to the same"
        )
    head = protocol.CAPABILITIES.size
    end = head + protocol.KEEPING.size
    if len(answer.payload) < end:
        raise malformed(name)
    outputs, output, features, current_ua, slots, zero_ms, volts = (
        protocol.CAPABILITIES.unpack_from(answer.payload)
    )
    if output >= len(protocol.OUTPUTS):
        raise BoardError(f"the board at {name} has outputs of unknown kind {output}")
    room, packet, kernels = protocol.KEEPING.unpack_from(answer.payload, head)
    if not features & Feature.KERNELS:
        room = kernels = 0
    return Capabilities(
        electrodes=outputs, output=protocol.OUTPUTS[output], max_current_ma=current_ua / 1000,
        max_slots=slots, time_to_zero_ms=zero_ms,
        firmware=answer.payload[end:].decode("utf-8", "replace"),
        measures=bool(features & Feature.VOLTAGE), force=bool(features & Feature.FORCE),
        compliance_v=float(volts) or None, recharges=bool(features & Feature.RECHARGE),
        emergency_switch=bool(features & Feature.EMERGENCY), kernel_bytes=room,
        most_kernels=kernels, packet_bytes=packet,
    )  # fmt: skip


def malformed(name: str) -> BoardError:
    """Return the error of a board that gives invalid answers."""
    return BoardError(f"the board at {name} gives invalid answers: check its firmware")


def reason_of(refusal: Message) -> tuple[int, int, str]:
    """Return reason, rule and text of a NAK."""
    if len(refusal.payload) != protocol.NAK.size:
        return 0, Rule.NONE, ""
    reason, rule, slot, electrode, value, allowed = protocol.NAK.unpack(refusal.payload)
    name = next((known.name.lower() for known in Rule if known == rule), "unknown")
    words = f"rule {rule} ({name})" if rule else "malformed"
    words += f": {value}, allowed {allowed}" if value or allowed else ""
    words += f", slot {slot}" if slot != NOTHING else ""
    words += f", electrode {electrode}" if electrode != NOTHING else ""
    return reason, rule, words
