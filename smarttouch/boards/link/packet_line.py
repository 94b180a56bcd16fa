"""Line to a ``link`` board: one thread reads, one keeps the board alive."""

import contextlib
import threading
import time
from collections.abc import Callable

from smarttouch.base.clock import prioritized
from smarttouch.base.errors import BoardError, BoardStoppedError, LineLostError, SilentBoardError
from smarttouch.base.wire.framing import Deframer
from smarttouch.base.wire.port import LINE_ERRORS, Port, read_some, reason, write_before
from smarttouch.boards.link.protocol import (
    ANSWERS,
    VERSION,
    HostSession,
    Message,
    MessageKind,
    draw_half,
)

HEARTBEAT_S = 0.03  # longest silence of the host: the board gives up after 0.1 s
SILENCE_S = 0.5  # after which a board, which sends every 20 ms in a session, is gone
LISTENED_S = 0.1  # most silence counted for one read; the rest was a pause of ours
ANSWER_S = 1.0
AGAIN_S = 0.25  # time after which a query is sent again
PIECE = 4096  # bytes written at once: a stop waits for one piece, not for a whole packet


class LinkLine:
    """Packets to and from one board; a fault is raised at the next call.

    Messages call its port ``name``. ``receive`` gets every packet that answers no query, with
    `news` held; ``aftermath`` returns the end of messages on faults; ``tend`` is called every few
    milliseconds to repeat lost packets; ``draw`` returns the host's half of a session, a new one
    each time.
    """

    def __init__(
        self,
        name: str,
        receive: Callable[[Message], None],
        aftermath: Callable[[], str],
        tend: Callable[[], None] = lambda: None,
        draw: Callable[[], int] = draw_half,
    ) -> None:
        self.name = name
        self.session: HostSession = HostSession(draw)  # of all packets; each opening has its own
        # Longest wait for an answer, and longest silence of the board in a session.
        self.answer_s: float = ANSWER_S
        self.silence_s: float = SILENCE_S
        self._draw = draw
        self.news: threading.Condition = threading.Condition()
        self.fault: BoardError | None = None
        self.overtaken: bool = False  # by a stop: without heartbeats the board stops itself
        self._receive, self._aftermath, self._tend = receive, aftermath, tend
        self._closing = threading.Event()
        # Reentrant: a signal handler may stop while its own thread is writing.
        self.writing: threading.RLock = threading.RLock()
        self._port: Port | None = None
        self._refused_before = 0
        self._deframer = Deframer()
        self._answers: dict[int, Message] = {}
        self._threads: list[threading.Thread] = []

    @property
    def opened(self) -> bool:
        return self._port is not None

    @property
    def refused(self) -> int:
        """Number of refused packets from the board, in all sessions."""
        return self._refused_before + self.session.refused

    def open(self, port: Port) -> None:
        """Start reading."""
        self._port = port
        self._closing.clear()
        self.fault, self.overtaken = None, False
        self._refused_before, self.session = self.refused, HostSession(self._draw)
        self._deframer = Deframer()
        self._answers.clear()
        self._last_written = self._last_packet = self.now_s()
        self._listen()

    def _listen(self) -> None:
        self._threads = [
            threading.Thread(target=self._read_all, name="board reader", daemon=True),
            threading.Thread(target=self._keep_alive, name="board heartbeat", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def now_s(self) -> float:
        """Return the time by the clock of all timeouts here."""
        return time.monotonic()

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition, with `news` held; return whether it holds."""
        return self.news.wait_for(condition, timeout_s)

    def close(self) -> None:
        """End both threads and close the port."""
        self._closing.set()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(ANSWER_S)
        if self._port is not None:
            with contextlib.suppress(*LINE_ERRORS):
                self._port.close()

    def begin(
        self, accept: Callable[[Message], None], stopped: threading.Event | None = None
    ) -> None:
        """Begin a session with a board, unless ``accept`` raises on its CAPABILITIES, of any
        version; ``stopped`` ends the wait (see `overtake`)."""
        deadline = self.now_s() + self.answer_s
        offer = None
        while self.now_s() < deadline:
            offer = self._ask_once(MessageKind.HELLO, stopped=stopped) or offer
            if offer is None:
                continue
            accept(offer)
            if self.session.begun or self._ask_once(MessageKind.BEGIN, stopped=stopped):
                return
        raise self._no_answer()

    def overtake(self) -> None:
        """Give a stop priority over everything else, and wake whatever waits for an answer."""
        self.overtaken = True
        with self.news:
            self.news.notify_all()

    def ask(self, question: MessageKind, payload: bytes = b"") -> Message:
        """Send a query until it is answered."""
        first = self.session.sent + 1
        deadline = self.now_s() + self.answer_s
        while self.now_s() < deadline:
            if answer := self._ask_once(question, first, payload=payload):
                return answer
        raise self._no_answer()

    def _ask_once(
        self,
        question: MessageKind,
        first: int = 0,
        stopped: threading.Event | None = None,
        payload: bytes = b"",
    ) -> Message | None:
        """Send a query; return an answer to it, or to one sent since ``first``."""
        first = first or self.session.sent + 1
        kind = ANSWERS[question]

        def answered() -> bool:
            found = self._answers.get(kind)
            # An answer of another version may name no query.
            return found is not None and (found.about >= first or found.version != VERSION)

        # The leading zero ends any half packet on the line.
        self.send(question, payload=payload, start=b"\0")
        with self.news:
            halted = stopped.is_set if stopped is not None else lambda: False
            self.wait(lambda: self.fault is not None or answered() or halted(), AGAIN_S)
            self.raise_fault()
            if halted():
                raise BoardStoppedError(f"the board at {self.name} was stopped before it answered")
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
        start: bytes = b"",
        latest_ns: int = 0,
        now_ns: Callable[[], int] = lambda: 0,
    ) -> bool:
        """Write the next packet of the session behind ``start``, unless the clock is past
        ``latest_ns`` before its first byte; return whether it was written. A stop may come between
        its pieces."""
        if not self.writing.acquire(timeout=ANSWER_S):
            raise BoardError(f"the line to {self.name} is blocked: check the cable")
        try:
            # Numbered under the lock, so that packets leave in order.
            packet = start + self.session.encode(kind, about, payload)
            assert self._port is not None
            for at in range(0, len(packet), PIECE):
                if self.overtaken and len(packet) > PIECE:
                    raise BoardError("the board was stopped: open it again before sending")
                piece = packet[at : at + PIECE]
                if at:
                    self._port.write(piece)
                elif not write_before(self._port, piece, latest_ns, now_ns):
                    return False
            self._last_written = self.now_s()
            if kind is not MessageKind.HEARTBEAT:
                self._last_packet = self._last_written
        except LINE_ERRORS as error:
            self.fail(self.lost(f"cannot be written to ({reason(error)})"))
            self.raise_fault()
        finally:
            self.writing.release()
        return True

    def stop_blindly(self) -> None:
        """Write a STOP to a line that has failed, which may still carry it."""
        if self._port is not None:
            with contextlib.suppress(*LINE_ERRORS):
                self._port.write(b"\0" + self.session.encode(MessageKind.STOP))

    def fail(self, fault: BoardError) -> None:
        """Keep the first fault for the next call."""
        with self.news:
            self.fault = self.fault or fault
            self.news.notify_all()

    def raise_fault(self) -> None:
        if self.fault is not None:
            raise self.fault

    def lost(self, what: str) -> LineLostError:
        """Return a fault that a restart may repair."""
        message = f"the board at {self.name} {what}{self._aftermath()}"
        return LineLostError(message)

    def gone(self, what: str) -> BoardError:
        """Return a fault that is final."""
        message = f"the board at {self.name} {what}{self._aftermath()}"
        return BoardError(message)

    @prioritized()
    def _read_all(self) -> None:
        silent_s, now = 0.0, self.now_s()
        while not self._closing.is_set():
            try:
                assert self._port is not None
                data = read_some(self._port)
            except LINE_ERRORS as error:
                if not self._closing.is_set():
                    self.fail(self.lost(f"has vanished ({reason(error)})"))
                return
            before, now = now, self.now_s()
            silent_s += min(now - before, LISTENED_S)
            # Before a session a board sends nothing by itself.
            if self.take(data) or not self.session.begun:
                silent_s = 0.0
            if silent_s > self.silence_s:
                self.fail(self.lost(f"has been silent for {self.silence_s:g} s"))
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

    @prioritized()
    def _keep_alive(self) -> None:
        # Nothing is due soon after a packet: a sequence is sent again after longer than that, too.
        while not self._closing.wait(
            max(HEARTBEAT_S / 4, self._last_packet + HEARTBEAT_S * 2 / 3 - self.now_s())
        ):
            if self.fault is not None or self.overtaken:
                return
            try:
                self.beat()
            except BoardError:
                return

    def beat(self) -> None:
        """Send a lost packet again, and a heartbeat if one is due."""
        self._tend()
        if self.session.begun and self.now_s() - self._last_written > HEARTBEAT_S:
            self.send(MessageKind.HEARTBEAT)
