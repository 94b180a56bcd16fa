"""Packets of a ``link`` board: a thread reads them, and queries wait for their answers."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable

from smarttouch.base.errors import BoardError, LineLostError, SilentBoardError
from smarttouch.base.posix import prioritized
from smarttouch.base.wire.framing import Deframer
from smarttouch.boards.line import Line
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import (
    ANSWERS,
    NOTHING,
    SILENCE_MS,
    VERSION,
    Feature,
    HostSession,
    Message,
    MessageKind,
    Rule,
    draw_half,
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


class PacketLine:
    """Packets to and from one board, by `line`; a fault is raised at the next call.

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
        self.session: HostSession = HostSession(draw)  # of all packets; each opening has its own
        # Longest wait for an answer, and longest silence of the board in a session.
        self.answer_s: float = ANSWER_S
        self.silence_s: float = SILENCE_S
        self._draw = draw
        self.news: threading.Condition = threading.Condition()
        self.fault: BoardError | None = None
        self._receive = receive
        self._closed = threading.Event()
        self._closed.set()
        self.paused_at_s: float = -PAUSED_S  # when this computer last wrote after a long pause
        self._deframer = Deframer()
        self._answers: dict[int, Message] = {}
        self._reader: threading.Thread | None = None

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
        self._closed.clear()
        self.fault = None
        self.session = HostSession(self._draw, self.session.refused)
        self._deframer = Deframer()
        self._answers.clear()
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

    def begin(self, accept: Callable[[Message], None]) -> None:
        """Begin a session with a board, unless ``accept`` raises on its CAPABILITIES, of any
        version."""
        deadline_s, offer = self.now_s() + self.answer_s, None
        while self.now_s() < deadline_s:
            offer = self._ask_once(MessageKind.HELLO) or offer
            if offer is None:
                continue
            accept(offer)
            if self.session.begun or self._ask_once(MessageKind.BEGIN):
                return
        raise self._no_answer()

    def ask(self, question: MessageKind, payload: bytes = b"") -> Message:
        """Send a query until it is answered."""
        first, deadline_s = self.session.sent + 1, self.now_s() + self.answer_s
        while self.now_s() < deadline_s:
            if answer := self._ask_once(question, first, payload):
                return answer
        raise self._no_answer()

    def _ask_once(
        self, question: MessageKind, first: int = 0, payload: bytes = b""
    ) -> Message | None:
        """Send a query; return an answer to it, or to one sent since ``first``."""
        first = first or self.session.sent + 1
        kind = ANSWERS[question]

        def answered() -> bool:
            found = self._answers.get(kind)
            # An answer of another version may name no query.
            return found is not None and (found.about >= first or found.version != VERSION)

        def over() -> bool:
            return self.fault is not None or answered() or self.line.is_stopped

        self.send(question, payload=payload)
        until_s = self.now_s() + AGAIN_S
        with self.news:
            # In short waits: a stop of a board that is being opened wakes nobody.
            while not self.wait(over, STOPPED_S) and self.now_s() < until_s:
                pass
            self.raise_fault()
            self.line.require_running()
            return self._answers.pop(kind) if answered() else None

    def _no_answer(self) -> SilentBoardError:
        return SilentBoardError(
            f"the board at {self.name} does not answer: check that it is on and speaks link "
            f"version {VERSION}"
        )

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
                self._put(self.session.encode(kind, about, payload), proved)
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
            self._put(self.session.encode(MessageKind.STOP), None)

    def fail(self, fault: BoardError) -> None:
        """Keep the first fault for the next call."""
        with self.news:
            self.fault = self.fault or fault
            self.news.notify_all()

    def raise_fault(self) -> None:
        if self.fault is not None:
            raise self.fault

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
            if self.take(data) or not self.session.begun:
                silent_s = 0.0
            if silent_s > self.silence_s:
                self.fail(self.line.lost(f"has been silent for {self.silence_s:g} s"))
                return

    def take(self, data: bytes) -> int:
        """Process bytes from the board; return the number of packets of the session among them."""
        taken = 0
        for packet in self._deframer.feed(data):
            with self.news:
                message = self.session.take(packet)
                if message is None:
                    continue
                taken += 1
                if message.kind in ANSWERS.values():
                    self._answers[message.kind] = message
                else:
                    self._receive(message)
                self.news.notify_all()
        return taken

    def beat(self) -> float:
        """Send a heartbeat if one is due; return the time to the next look, s."""
        now_s = self.now_s()
        if self.session.begun and now_s - self._last_written > HEARTBEAT_S:
            self.send(MessageKind.HEARTBEAT)
        # Nothing is due soon after a packet: a sequence is sent again after longer than that, too.
        return max(HEARTBEAT_S / 4, self._last_packet + HEARTBEAT_S * 2 / 3 - now_s)


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
    name = next((each.name.lower() for each in Rule if each == rule), "unknown")
    words = f"rule {rule} ({name})" if rule else "malformed"
    words += f": {value}, allowed {allowed}" if value or allowed else ""
    words += f", slot {slot}" if slot != NOTHING else ""
    words += f", electrode {electrode}" if electrode != NOTHING else ""
    return reason, rule, words


class BoardClock:
    """Reads a board's clock as the host's, by the answer that came fastest of the last few."""

    def __init__(self) -> None:
        self._ahead_ns: deque[int] = deque(maxlen=16)

    def note(self, board_us: int, sent_ns: int, now_ns: int) -> int:
        """Return the host's time of the start of a sequence that was sent at a time, and its answer
        now."""
        if self._ahead_ns and 1000 * board_us + min(self._ahead_ns) < sent_ns:
            # No sequence begins before it is sent: the board's clock has stood still.
            self._ahead_ns.clear()
        self._ahead_ns.append(now_ns - 1000 * board_us)
        return 1000 * board_us + min(self._ahead_ns)
