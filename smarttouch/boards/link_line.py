"""The line to a ``link`` board: one thread hears, one keeps the board alive."""

import contextlib
import threading
import time
from collections.abc import Callable

from smarttouch.boards import link_protocol as protocol
from smarttouch.boards.link_protocol import Kind
from smarttouch.errors import BoardError, BoardStoppedError, LineLostError
from smarttouch.wire.framing import Deframer, Packet
from smarttouch.wire.port import LINE_ERRORS, Port, reason, write_before

HEARTBEAT_S = 0.03
"""Longest silence of the host: the board gives up after 0.1 s."""
SILENCE_S = 0.5
"""Silence of the board, which speaks every 20 ms, after which it counts as gone."""
LISTENED_S = 0.1
"""Most that one read counts as silence: a read ends sooner, the rest is our own absence."""
ANSWER_S = 1.0
AGAIN_S = 0.25
"""After which a question is sent again."""
PIECE = 4096
"""Bytes written at once: a stop waits for one piece, not for a whole packet."""


class LinkLine:
    """Packets to and from one board. Whatever goes wrong is raised at the next call.

    Parameters
    ----------
    name : str
        Of the port, for messages.
    hear : callable
        Told of every packet that answers no question, with `news` held.
    aftermath : callable
        Returns what to say after a fault.
    tend : callable
        Called every few milliseconds, to send again what has got lost.
    """

    def __init__(
        self,
        name: str,
        hear: Callable[[Packet], bool],
        aftermath: Callable[[], str],
        tend: Callable[[], None] = lambda: None,
    ) -> None:
        self.name = name
        self.news = threading.Condition()
        self.fault: BoardError | None = None
        self.overtaken = False
        """Set by a stop: no heartbeats from then on, so the board ends by itself if need be."""
        self._hear, self._aftermath, self._tend = hear, aftermath, tend
        self._closing = threading.Event()
        # Reentrant: who looks whether something is still to be written holds it too.
        self.writing = threading.RLock()
        self._port: Port | None = None
        self._answers: dict[int, Packet] = {}
        self._threads: list[threading.Thread] = []

    @property
    def opened(self) -> bool:
        return self._port is not None

    def open(self, port: Port) -> None:
        """Begin to listen."""
        self._port = port
        self._closing.clear()
        self.fault, self.overtaken = None, False
        self._answers.clear()
        self._last_written = time.monotonic()
        self._threads = [
            threading.Thread(target=self._read_all, name="board reader", daemon=True),
            threading.Thread(target=self._keep_alive, name="board heartbeat", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End both threads and let go of the port."""
        self._closing.set()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(ANSWER_S)
        if self._port is not None:
            with contextlib.suppress(*LINE_ERRORS):
                self._port.close()

    def overtake(self) -> None:
        """Let a stop go before everything else; who waits for an answer looks up."""
        self.overtaken = True
        with self.news:
            self.news.notify_all()

    def ask(self, question: Kind, answer: Kind, stopped: threading.Event | None = None) -> Packet:
        """Send a question until it is answered.

        Parameters
        ----------
        question, answer : Kind
        stopped : threading.Event, optional
            Ends the waiting; see `overtake`.

        Raises
        ------
        BoardStoppedError
            If the board was stopped.
        BoardError
            If nothing comes, or the line has failed.
        """
        stopped = stopped or threading.Event()
        with self.news:
            self._answers.pop(answer, None)
        deadline = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline and not stopped.is_set():
            # The zero in front ends whatever half packet stands on the line.
            self.write(b"\0" + protocol.encode(question))
            with self.news:
                self.news.wait_for(
                    lambda: self.fault is not None or answer in self._answers or stopped.is_set(),
                    AGAIN_S,
                )
                self.raise_fault()
                if answer in self._answers:
                    return self._answers.pop(answer)
        if stopped.is_set():
            raise BoardStoppedError(f"the board at {self.name} was stopped before it answered")
        raise BoardError(
            f"the board at {self.name} does not answer: check that it is on and speaks link "
            f"version {protocol.VERSION}"
        )

    def write(
        self, packet: bytes, latest_ns: int = 0, now_ns: Callable[[], int] = lambda: 0
    ) -> bool:
        """Write a packet, unless it is too late for it; return whether it went.

        A stop may come between its pieces.

        Parameters
        ----------
        packet : bytes
        latest_ns : int
            When its first byte may go at the latest, by the clock.
        now_ns : callable
            The clock; without one it is never too late.
        """
        if not self.writing.acquire(timeout=ANSWER_S):
            raise BoardError(f"the line to {self.name} is blocked: check the cable")
        try:
            assert self._port is not None
            for start in range(0, len(packet), PIECE):
                if self.overtaken and len(packet) > PIECE:
                    raise BoardError("the board was stopped: open it again before sending")
                piece = packet[start : start + PIECE]
                if start:
                    self._port.write(piece)
                elif not write_before(self._port, piece, latest_ns, now_ns):
                    return False
            self._last_written = time.monotonic()
        except LINE_ERRORS as error:
            self.fail(self.lost(f"cannot be written to ({reason(error)})"))
            self.raise_fault()
        finally:
            self.writing.release()
        return True

    def write_blindly(self, packet: bytes) -> None:
        """Write to a line that has failed: it may still carry something."""
        assert self._port is not None
        with contextlib.suppress(*LINE_ERRORS):
            self._port.write(packet)

    def fail(self, fault: BoardError) -> None:
        """Keep the first fault for the next call."""
        with self.news:
            self.fault = self.fault or fault
            self.news.notify_all()

    def raise_fault(self) -> None:
        """Raise what went wrong, if anything did."""
        if self.fault is not None:
            raise self.fault

    def lost(self, what: str) -> LineLostError:
        """Return a fault that starting anew may mend."""
        return LineLostError(f"the board at {self.name} {what}{self._aftermath()}")

    def gone(self, what: str) -> BoardError:
        """Return a fault that is final."""
        return BoardError(f"the board at {self.name} {what}{self._aftermath()}")

    def _read_all(self) -> None:
        deframer = Deframer()
        silent_s, now = 0.0, time.monotonic()
        while not self._closing.is_set():
            try:
                assert self._port is not None
                data = self._port.read(self._port.in_waiting or 1)
            except LINE_ERRORS as error:
                if not self._closing.is_set():
                    self.fail(self.lost(f"has vanished ({reason(error)})"))
                return
            before, now = now, time.monotonic()
            silent_s += min(now - before, LISTENED_S)
            for packet in deframer.feed(data):
                silent_s = 0.0
                with self.news:
                    if not self._hear(packet):
                        self._answers[packet.kind] = packet
                    self.news.notify_all()
            if silent_s > SILENCE_S:
                self.fail(self.lost(f"has been silent for {SILENCE_S:g} s"))
                return

    def _keep_alive(self) -> None:
        beat = protocol.encode(Kind.HEARTBEAT)
        while not self._closing.wait(HEARTBEAT_S / 4):
            if self.fault is not None or self.overtaken:
                return
            try:
                self._tend()
                if time.monotonic() - self._last_written > HEARTBEAT_S:
                    self.write(beat)
            except BoardError:
                return
