"""Board's end of sessions: accepts packets, and counts the refused ones."""

from collections import deque
from collections.abc import Callable

from smarttouch.boards.link_protocol import (
    ALIVE_MS,
    HALF,
    LATE_MS,
    LONGEST_PACKET_MS,
    NAK,
    NOTHING,
    VERSION,
    Kind,
    Refusal,
    Rule,
)
from smarttouch.boards.link_session import Message, decode_head, draw_half, encode

MOST_HOSTS = 8  # number of hosts with separate HELLO records
_MS = 1_000_000


class BoardSession:
    """The latest session, and the challenge for the next; ``draw`` returns 32 random bits, not all
    0, new ones each time."""

    def __init__(self, draw: Callable[[], int] = draw_half) -> None:
        self.state = 0  # of the board, in each of its packets
        # Of the session, 0 before the first; packets refused as old and as of another session.
        self.number = self.old = self.foreign = 0
        self.live = False  # whether its host is there; what ends it sets this to False
        self._draw = draw
        self._challenge = draw()
        self._taken = self._said = 0
        self._alive: deque[tuple[int, int]] = deque(maxlen=2 + LATE_MS // ALIVE_MS)
        """Time in ns and number of each of the last ALIVE packets."""
        self._hellos: dict[int, tuple[int, int]] = {}  # last number and count, by the host's half

    def encode(self, kind: Kind, about: int = 0, payload: bytes = b"") -> bytes:
        """Return the board's next packet of the session."""
        self._said += 1
        return encode(kind, self.number, self._said, self._taken, about, payload, self.state)

    def encode_alive(self, payload: bytes, now_ns: int) -> bytes:
        """Return the next ALIVE; its echo dates what the host has received."""
        packet = self.encode(Kind.ALIVE, 0, payload)
        self._alive.append((now_ns, self._said))
        return packet

    def offer(self, hello: Message, capabilities: bytes) -> bytes | None:
        """Return the answer to HELLO; None if it is refused."""
        half = hello.session & HALF
        if self.live:
            self.foreign += 1
            return None
        if hello.version == VERSION:
            last, count = self._hellos.get(half, (0, 0))
            if hello.number <= last:
                self.old += 1
                return None
            if not last and len(self._hellos) == MOST_HOSTS:
                self._count_strangers()
            self._hellos[half] = hello.number, count + 1
        session = self._challenge << 32 | half
        return encode(Kind.CAPABILITIES, session, 0, 0, hello.number, capabilities, self.state)

    def would_begin(self, begin: Message) -> bool:
        """Return whether a BEGIN may open a session."""
        fits = begin.session >> 32 == self._challenge and bool(begin.session & HALF)
        return not self.live and fits and begin.version == VERSION

    def refuse_begin(self, begin: Message) -> bytes:
        """Return the answer to a BEGIN while the emergency switch is open; nothing changes."""
        payload = NAK.pack(Refusal.EMERGENCY, Rule.NONE, NOTHING, NOTHING, 0, 0)
        return encode(Kind.NAK, begin.session, 0, 0, begin.number, payload, self.state)

    def begin(self, begin: Message) -> bool:
        """Return whether a BEGIN opens a session, and open it."""
        if not self.would_begin(begin):
            return False
        half = begin.session & HALF
        self._hellos.pop(half, None)
        self._count_strangers()
        self._hellos[half] = begin.number, 0
        self._challenge = self._draw()
        self.number, self.live = begin.session, True
        self._taken, self._said = begin.number, 0
        self._alive.clear()
        return True

    def _count_strangers(self) -> None:
        self.foreign += sum(count for _, count in self._hellos.values())
        self._hellos.clear()

    def take(self, message: Message, began_ns: int) -> Refusal | None:
        """Take a packet of the session, or return why it is refused; ``began_ns`` is when its first
        byte came."""
        refusal = self._judge(message, began_ns)
        if refusal is Refusal.OLD:
            self.old += 1
        elif refusal is not None:
            self.foreign += 1
        else:
            self._taken = message.number
        return refusal

    def promises(self, head: bytes, began_ns: int, now_ns: int) -> bool:
        """Return whether an incomplete packet is a sign of life, as those of long kinds are."""
        message, early = decode_head(head), now_ns - began_ns <= LONGEST_PACKET_MS * _MS
        fresh = self._judge(message, began_ns) is None
        return message.kind in (Kind.SEQUENCE, Kind.KERNELS) and early and fresh

    def _judge(self, message: Message, began_ns: int) -> Refusal | None:
        if message.version != VERSION or not self.number or message.session != self.number:
            return Refusal.FOREIGN
        if message.number <= self._taken:
            return Refusal.OLD
        # A stop is never too late: it counts even from a host that receives nothing.
        late = message.kind != Kind.STOP and message.heard <= self._faded(began_ns)
        return Refusal.OLD if late else None

    def _faded(self, now_ns: int) -> int:
        """Return the number of the last ALIVE that is too old to confirm; -1 if none is."""
        gone = (number for sent_ns, number in self._alive if sent_ns < now_ns - LATE_MS * _MS)
        return max(gone, default=-1)
